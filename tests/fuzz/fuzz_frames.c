// SPDX-License-Identifier: Apache-2.0
//
// fuzz_frames.c - client/frames.c: a range and a pattern, one a line.
//
// What is checked: no frame comes twice or out of the range of numbers; a list written out is read as itself; a frame's
// name has its number; what is refused has a reason that fits.
#include <inttypes.h>
#include <stdbool.h>

#include "frames.h"
#include "fuzz.h"

enum { LIST_CHECKED_MAX = 2000, DIGITS_MAX = 4, DIGITS_FAR = 9 };

// Sorting a million frames takes a second here: numbers are near each other, or so far apart that they are too many.
static bool is_quick(const char *range)
{
    for (const char *s = range; *s; s++) {
        const size_t digits = strspn(s, "0123456789");
        if (digits > DIGITS_MAX && (digits < DIGITS_FAR || strchr(range, 'x')))
            return false;
        s += digits ? digits - 1 : 0;
    }
    return true;
}

static int by_number(const void *a, const void *b)
{
    const int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static void check_list(const struct frames_list *l)
{
    must(l->count >= 1 && l->count <= FRAMES_MAX);
    int64_t *sorted = malloc(l->count * sizeof(*sorted));
    must(sorted);
    memcpy(sorted, l->frame, l->count * sizeof(*sorted));
    qsort(sorted, l->count, sizeof(*sorted), by_number);
    must(sorted[0] >= -FRAMES_NUMBER_MAX && sorted[l->count - 1] <= FRAMES_NUMBER_MAX);
    for (size_t i = 1; i < l->count; i++)
        must(sorted[i] > sorted[i - 1]);
    free(sorted);
}

// A frame's number as people write it: the whole part at least so wide, sign included, and decimals without zeros at the end.
static int write_number(char *out, size_t size, int64_t frame, int width)
{
    const uint64_t all = frame < 0 ? -(uint64_t)frame : (uint64_t)frame;
    int n = snprintf(out, size, "%s%0*" PRIu64, frame < 0 ? "-" : "", frame < 0 ? width - 1 : width, all / FRAMES_ONE);
    if (all % FRAMES_ONE) {
        n += snprintf(out + n, size - (size_t)n, ".%06" PRIu64, all % FRAMES_ONE);
        while (out[n - 1] == '0')
            out[--n] = '\0';
    }
    return n;
}

// Written out frame by frame it is the same list.
static void check_again(const struct frames_list *l)
{
    const size_t room = l->count * 24 + 1;
    char *text = malloc(room), why[FRAMES_WHY_MAX];
    struct frames_list again;
    size_t used = 0;
    must(text);
    for (size_t i = 0; i < l->count; i++) {
        if (i)
            text[used++] = ',';
        used += (size_t)write_number(text + used, room - used, l->frame[i], 1);
    }
    must(!frames_parse(&again, text, why));
    must(again.count == l->count && !memcmp(again.frame, l->frame, l->count * sizeof(*l->frame)));
    frames_list_finish(&again);
    free(text);
}

static void check_names(const char *text, int64_t frame)
{
    struct frames_pattern p;
    char why[FRAMES_WHY_MAX] = "", number[40];
    if (frames_pattern_init(&p, text, why) < 0) {
        must(*why && memchr(why, '\0', sizeof(why)));
        return;
    }
    must(p.n_tokens <= FRAMES_TOKENS_MAX);
    size_t from = 0;
    for (unsigned i = 0; i < p.n_tokens; from = p.token[i++].end)
        must(p.token[i].begin >= from && p.token[i].end > p.token[i].begin && p.token[i].end <= strlen(text) &&
             p.token[i].width >= 1);
    char *name = frames_name(&p, frame);
    must(name);
    if (p.n_tokens) {
        write_number(number, sizeof(number), frame, p.token[0].width <= 20 ? (int)p.token[0].width : 20);
        must(!strncmp(name, text, p.token[0].begin));
        must(p.token[0].width > 20 || !strncmp(name + p.token[0].begin, number, strlen(number)));
    } else {
        must(!strcmp(name, text));
    }
    free(name);
    frames_pattern_finish(&p);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    struct frames_list l;
    char why[FRAMES_WHY_MAX] = "";
    char *range = fuzz_text(&in), *pattern = strchr(range, '\n');
    int64_t frame = 0;
    if (pattern)
        *pattern++ = '\0';
    if (!is_quick(range)) {
        free(range);
        return 0;
    }
    if (frames_parse(&l, range, why) < 0) {
        must(!l.frame && *why && memchr(why, '\0', sizeof(why)));
    } else {
        check_list(&l);
        if (l.count <= LIST_CHECKED_MAX)
            check_again(&l);
        frame = l.frame[l.count / 2];
        frames_list_finish(&l);
    }
    check_names(pattern ? pattern : range, frame);
    free(range);
    return 0;
}
