// SPDX-License-Identifier: Apache-2.0
// frames.c - frames.h's grammar. A file on disk is a frame of a pattern exactly when the pattern would
// write that name for its number: so reading and writing cannot disagree about padding.
#include "frames.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH_MAX = 32 };

/* ---- patterns ---------------------------------------------------------------------------------- */

/* Length of the token at s and its width; 0 when there is none. */
static size_t token_at(const char *s, unsigned *width)
{
    size_t n = strspn(s, "#@"), hashes = 0;
    if (n) {
        for (size_t i = 0; i < n; i++)
            hashes += s[i] == '#';
        *width = (unsigned)(n - hashes + (hashes == 1 ? 4 : hashes));
        return n;
    }
    bool percent = s[0] == '%';
    if (!percent && !(s[0] == '$' && s[1] == 'F'))
        return 0;
    const char *digits = s + (percent ? 1 : 2), *end = digits;
    while (isdigit((unsigned char)*end) && end < digits + 3)
        end++;
    *width = end > digits ? (unsigned)strtoul(digits, NULL, 10) : 1;
    if (percent) /* %d or %0Nd; %4d would pad with blanks */
        return *end == 'd' && (end == digits || *digits == '0') ? (size_t)(end + 1 - s) : 0;
    /* $FF and $Fname are other variables. */
    return end > digits || !(isalnum((unsigned char)*end) || *end == '_') ? (size_t)(end - s) : 0;
}

int frames_pattern_init(struct frames_pattern *p, const char *text, char *why)
{
    *p = (struct frames_pattern){ .text = strdup(text) };
    if (!p->text) {
        snprintf(why, FRAMES_WHY_MAX, "out of memory");
        return -1;
    }
    for (size_t i = 0; text[i];) {
        struct frames_token t = { .begin = i };
        size_t n = token_at(text + i, &t.width);
        if (!n) {
            i++;
            continue;
        }
        if (p->n_tokens == FRAMES_TOKENS_MAX || t.width > WIDTH_MAX) {
            snprintf(why, FRAMES_WHY_MAX,
                     "\"%.200s\": at most %d frame tokens of at most %d digits expected", text,
                     FRAMES_TOKENS_MAX, WIDTH_MAX);
            frames_pattern_finish(p);
            return -1;
        }
        t.width = t.width ? t.width : 1;
        t.end = i += n;
        p->token[p->n_tokens++] = t;
    }
    return 0;
}

void frames_pattern_finish(struct frames_pattern *p)
{
    free(p->text);
    *p = (struct frames_pattern){ 0 };
}

/* printf's %0*d of the whole part, and the decimals. */
static size_t number_write(char *out, size_t size, int64_t frame, unsigned width)
{
    bool negative = frame < 0;
    uint64_t size_of = negative ? (uint64_t)-frame : (uint64_t)frame;
    unsigned digits = width > (unsigned)negative ? width - (unsigned)negative : 1;
    size_t n = (size_t)snprintf(out, size, "%s%0*" PRIu64, negative ? "-" : "", (int)digits,
                                size_of / (uint64_t)FRAMES_ONE);
    if (size_of % (uint64_t)FRAMES_ONE == 0)
        return n;
    n += (size_t)snprintf(out + n, size - n, ".%06" PRIu64, size_of % (uint64_t)FRAMES_ONE);
    while (out[n - 1] == '0')
        out[--n] = '\0';
    return n;
}

char *frames_name(const struct frames_pattern *p, int64_t frame)
{
    size_t room = strlen(p->text) + FRAMES_TOKENS_MAX * (WIDTH_MAX + 24) + 1, used = 0, from = 0;
    char *name = malloc(room);
    if (!name)
        return NULL;
    for (unsigned i = 0; i < p->n_tokens; i++) {
        memcpy(name + used, p->text + from, p->token[i].begin - from);
        used += p->token[i].begin - from;
        used += number_write(name + used, room - used, frame, p->token[i].width);
        from = p->token[i].end;
    }
    snprintf(name + used, room - used, "%s", p->text + from);
    return name;
}

/* ---- lists --------------------------------------------------------------------------------------- */

static int by_number(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

struct numbered {
    int64_t frame;
    size_t at;
};

static int by_number_then_place(const void *a, const void *b)
{
    const struct numbered *x = a, *y = b;
    int c = by_number(&x->frame, &y->frame);
    return c ? c : (x->at > y->at) - (x->at < y->at);
}

/* Keeps the first of equal numbers, and the order. */
static int drop_doubles(struct frames_list *l)
{
    struct numbered *n = malloc((l->count + 1) * sizeof(*n));
    bool *twice = calloc(l->count + 1, sizeof(*twice));
    size_t kept = 0;
    int r = n && twice ? 0 : -1;
    for (size_t i = 0; r == 0 && i < l->count; i++)
        n[i] = (struct numbered){ l->frame[i], i };
    if (r == 0)
        qsort(n, l->count, sizeof(*n), by_number_then_place);
    for (size_t i = 1; r == 0 && i < l->count; i++)
        twice[n[i].at] = n[i].frame == n[i - 1].frame;
    for (size_t i = 0; r == 0 && i < l->count; i++)
        if (!twice[i])
            l->frame[kept++] = l->frame[i];
    if (r == 0)
        l->count = kept;
    free(n);
    free(twice);
    return r;
}

static int list_add(struct frames_list *l, int64_t frame)
{
    if ((l->count & (l->count - 1)) == 0) { /* room doubles at powers of two */
        int64_t *more = realloc(l->frame, (l->count ? 2 * l->count : 1) * sizeof(*more));
        if (!more)
            return -1;
        l->frame = more;
    }
    l->frame[l->count++] = frame;
    return 0;
}

void frames_list_finish(struct frames_list *l)
{
    free(l->frame);
    *l = (struct frames_list){ 0 };
}

/* A number with at most 9 digits and 6 decimals in the `len` bytes at s, which are it wholly. */
static bool number_from(const char *s, size_t len, int64_t *out)
{
    const char *end = s + len;
    bool negative = len && *s == '-';
    uint64_t value = 0, unit = (uint64_t)FRAMES_ONE;
    const char *digits = s += negative;
    for (; s < end && isdigit((unsigned char)*s); s++) {
        value = 10 * value + (uint64_t)(*s - '0');
        if (value > (uint64_t)(FRAMES_NUMBER_MAX / FRAMES_ONE))
            return false;
    }
    if (s == digits)
        return false;
    value *= unit;
    if (s < end && *s == '.') {
        for (digits = ++s; s < end && isdigit((unsigned char)*s) && unit > 1; s++)
            value += (unit /= 10) * (uint64_t)(*s - '0');
        if (s == digits)
            return false;
    }
    *out = negative ? -(int64_t)value : (int64_t)value;
    return s == end && value <= (uint64_t)FRAMES_NUMBER_MAX;
}

/* Bytes at s that look like a number, its decimals included. */
static size_t number_length(const char *s)
{
    static const char digit[] = "0123456789";
    size_t n = *s == '-';
    n += strspn(s + n, digit);
    size_t decimals = s[n] == '.' ? strspn(s + n + 1, digit) : 0;
    return decimals ? n + 1 + decimals : n;
}

/* The longest number at *s, which moves on. */
static bool number_read(const char **s, int64_t *out)
{
    size_t n = number_length(*s);
    if (!number_from(*s, n, out))
        return false;
    *s += n;
    return true;
}

/* "A", "A-B" or "A-BxN"; *s moves on. */
static bool range_read(const char **s, int64_t *first, int64_t *last, int64_t *step)
{
    *step = FRAMES_ONE;
    if (!number_read(s, first))
        return false;
    *last = *first;
    if (**s != '-')
        return true;
    ++*s;
    if (!number_read(s, last))
        return false;
    if (**s != 'x')
        return true;
    ++*s;
    return isdigit((unsigned char)**s) && number_read(s, step) && *step > 0;
}

int frames_parse(struct frames_list *l, const char *text, char *why)
{
    int64_t first, last, step;
    *l = (struct frames_list){ 0 };
    for (const char *s = text;; s++) {
        const char *piece = s;
        if (!range_read(&s, &first, &last, &step) || (*s && *s != ',')) {
            snprintf(why, FRAMES_WHY_MAX,
                     "frames \"%.120s\", at character %zu, \"%.40s\": ranges such as 1-100, 1-100x2, "
                     "1,5,9-12 or 1-2x0.5 expected",
                     text, (size_t)(piece - text) + 1, piece);
            goto fail;
        }
        int64_t way = last < first ? -step : step;
        for (int64_t i = first; way > 0 ? i <= last : i >= last; i += way) {
            if (l->count == FRAMES_MAX) {
                snprintf(why, FRAMES_WHY_MAX, "frames \"%.120s\": at most %d frames expected", text,
                         FRAMES_MAX);
                goto fail;
            }
            if (list_add(l, i) < 0)
                goto no_memory;
        }
        if (!*s)
            break;
    }
    if (drop_doubles(l) == 0)
        return 0;
no_memory:
    snprintf(why, FRAMES_WHY_MAX, "out of memory");
fail:
    frames_list_finish(l);
    return -1;
}

int frames_parse_offset(int64_t *offset, const char *text, char *why)
{
    const char *s = text + (*text == '+' && isdigit((unsigned char)text[1]));
    if (number_from(s, strlen(s), offset))
        return 0;
    snprintf(why, FRAMES_WHY_MAX, "offset \"%.120s\": a number such as 1000 or -12 expected", text);
    return -1;
}

int frames_shift(struct frames_list *l, int64_t offset, char *why)
{
    for (size_t i = 0; i < l->count; i++) {
        int64_t moved = l->frame[i] + offset; /* both at most 10^15 */
        if (moved < -FRAMES_NUMBER_MAX || moved > FRAMES_NUMBER_MAX) {
            snprintf(why, FRAMES_WHY_MAX, "frame %" PRId64 " with its offset: at most 9 digits expected",
                     l->frame[i] / FRAMES_ONE);
            return -1;
        }
    }
    for (size_t i = 0; i < l->count; i++)
        l->frame[i] += offset;
    return 0;
}

/* ---- what is on disk --------------------------------------------------------------------------------
 */

/* Is `name` (no folder) a frame of base? Digits after the token are the pattern's own, or decimals: each is tried. */
static bool name_matches(const struct frames_pattern *base, const char *name, int64_t *frame)
{
    size_t prefix = base->token[0].begin;
    if (strncmp(name, base->text, prefix) != 0)
        return false;
    for (size_t n = number_length(name + prefix); n > 0; n--) {
        if (!number_from(name + prefix, n, frame))
            continue;
        char *written = frames_name(base, *frame);
        bool same = written && strcmp(written, name) == 0;
        free(written);
        if (same)
            return true;
    }
    return false;
}

static int scan_folder(struct frames_list *l, const struct frames_pattern *base, const char *folder,
                       char *why)
{
    DIR *d = opendir(folder);
    struct dirent *entry;
    int64_t frame;
    if (!d) {
        snprintf(why, FRAMES_WHY_MAX, "%.300s: %s", folder, strerror(errno));
        return -1;
    }
    while ((entry = readdir(d))) {
        if (!name_matches(base, entry->d_name, &frame))
            continue;
        if (l->count == FRAMES_MAX || list_add(l, frame) < 0) {
            snprintf(why, FRAMES_WHY_MAX, "%.300s: more than %d frames", folder, FRAMES_MAX);
            closedir(d);
            return -1;
        }
    }
    closedir(d);
    qsort(l->frame, l->count, sizeof(*l->frame), by_number);
    return 0;
}

int frames_scan(struct frames_list *l, const struct frames_pattern *p, char *why)
{
    const char *slash = strrchr(p->text, '/');
    size_t folder_len = slash ? (size_t)(slash + 1 - p->text) : 0;
    struct frames_pattern base;
    *l = (struct frames_list){ 0 };
    if (p->n_tokens == 0 || p->token[0].begin < folder_len) {
        snprintf(why, FRAMES_WHY_MAX,
                 "\"%.200s\": which frames? the folder has a token, so -f is needed", p->text);
        return -1;
    }
    if (frames_pattern_init(&base, p->text + folder_len, why) < 0)
        return -1;
    char *folder = folder_len ? strndup(p->text, folder_len) : strdup(".");
    int r = -1;
    if (folder)
        r = scan_folder(l, &base, folder, why);
    else
        snprintf(why, FRAMES_WHY_MAX, "out of memory");
    free(folder);
    frames_pattern_finish(&base);
    if (r < 0)
        frames_list_finish(l);
    return r;
}
