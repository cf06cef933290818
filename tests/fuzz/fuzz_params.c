// SPDX-License-Identifier: Apache-2.0
//
// fuzz_params.c - params_*.c: lines of name=text (name~number), set one after the other.
//
// What is checked: what is refused leaves the parameters as they were and says why; what passes params_check is printed
// in one line that fits, and the line, set again, passes and is printed the same.
#include "params.h"
#include "fuzz.h"

enum { LINES_MAX = 64 };

static void check_fault(const struct fault *f)
{
    must(f->code != FAULT_NONE && *f->text);
    must(!strncmp(f->field, "params.", 7));
    must(memchr(f->text, '\0', sizeof(f->text)) && memchr(f->field, '\0', sizeof(f->field)));
    for (const char *s = f->text; *s; s++)
        must(*s >= ' ' && *s <= '~');
}

static void set(struct params *p, const char *name, const char *text, bool number)
{
    struct fault f = { .code = FAULT_NONE };
    const struct params before = *p;
    const int r = number ? params_set_number(p, name, strtod(text, NULL), &f) : params_set_text(p, name, text, &f);
    if (r < 0) {
        check_fault(&f);
        must(!memcmp(p, &before, sizeof(before)));
    } else {
        must(params_has(p, name));
    }
}

// Takes one name=value of a printed line off *s, its quotes undone.
static void set_printed(struct params *p, char **s)
{
    struct fault f = { .code = FAULT_NONE };
    char *name = *s, *value = strchr(name, '='), *from, *to;
    must(value);
    *value++ = '\0';
    const bool quoted = *value == '"';
    value += quoted;
    for (from = to = value; *from && *from != (quoted ? '"' : ' '); *to++ = *from++)
        if (quoted && *from == '\\')
            from++;
    must(!quoted || *from == '"');
    from += quoted;
    *s = from + (*from == ' ');
    *to = '\0';
    if (params_set_text(p, name, value, &f) < 0)
        fprintf(stderr, "printed %s=%s: %s\n", name, value, f.text);
    must(f.code == FAULT_NONE);
}

static void check_print(const struct params *p)
{
    char line[PARAMS_LINE_MAX], copy[PARAMS_LINE_MAX], again[PARAMS_LINE_MAX];
    struct fault f = { .code = FAULT_NONE };
    struct params q;
    const int n = params_print(p, line, sizeof(line));
    must(n >= 0 && n < PARAMS_LINE_MAX && strlen(line) == (size_t)n);
    memcpy(copy, line, sizeof(copy));
    params_init(&q);
    for (char *s = copy; *s;)
        set_printed(&q, &s);
    params_look_defaults(&q);
    if (params_check(&q, &f) < 0)
        fprintf(stderr, "printed %s: %s\n", line, f.text);
    must(f.code == FAULT_NONE);
    params_print(&q, again, sizeof(again));
    if (strcmp(line, again))
        fprintf(stderr, "first %s\nthen  %s\n", line, again);
    must(!strcmp(line, again));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    struct fault f = { .code = FAULT_NONE };
    struct params p;
    char *all = fuzz_text(&in), *save = NULL;
    params_init(&p);
    unsigned lines = 0;
    for (char *line = strtok_r(all, "\n", &save); line && lines < LINES_MAX; line = strtok_r(NULL, "\n", &save), lines++) {
        char *at = strpbrk(line, "=~");
        const bool number = at && *at == '~';
        if (at)
            *at = '\0';
        set(&p, line, at ? at + 1 : "", number);
    }
    params_look_defaults(&p);
    if (params_check(&p, &f) < 0)
        check_fault(&f);
    else
        check_print(&p);
    free(all);
    return 0;
}
