// SPDX-License-Identifier: Apache-2.0
// wall_def_tree.c - the YAML of a wall definition as a tree with places, and the list of mistakes.
//
// Invariant: what YAML can do beyond maps, lists and text (anchors, aliases, tags, several documents, deep nesting) is a mistake
// and not in the tree: an alias would let a few bytes stand for gigabytes. The tree's size is bounded by the text's,
// which the caller has capped.
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <yaml.h>

#include "wall_def_internal.h"

/* ---- mistakes --------------------------------------------------------------------------------------------------- */

/* Keeps the list sorted by place; when it is full, what comes last in the text goes. */
static unsigned insert(struct wall_mistake *list, unsigned count, unsigned room, const struct wall_mistake *m)
{
    unsigned i = count;
    while (i > 0 && (list[i - 1].line > m->line || (list[i - 1].line == m->line && list[i - 1].column > m->column)))
        i--;
    if (i == room)
        return count;
    const unsigned kept = count < room ? count : room - 1;
    memmove(&list[i + 1], &list[i], (kept - i) * sizeof(*list));
    list[i] = *m;
    return kept + 1;
}

static size_t path_print(const struct wall_node *n, char *out, size_t size)
{
    if (!n || !n->parent)
        return 0;
    size_t used = path_print(n->parent, out, size);
    if (used >= size)
        return used;
    int wrote = n->key ? snprintf(out + used, size - used, "%s%.40s", used ? "." : "", n->key)
                       : snprintf(out + used, size - used, "[%u]", n->index);
    return used + (size_t)wrote;
}

__attribute__((format(printf, 3, 0)))
static void mistake_make(struct wall_mistake *out, const struct wall_node *at, const char *format, va_list args)
{
    char path[96] = "", text[256];
    path_print(at, path, sizeof(path));
    vsnprintf(text, sizeof(text), format, args);
    snprintf(out->text, sizeof(out->text), "%s%s%.*s", path, *path ? ": " : "", 150, text);
    // A key can hold any bytes that YAML takes for text.
    for (char *s = out->text; *s; s++)
        if ((unsigned char)*s < ' ' || (unsigned char)*s > '~')
            *s = '?';
    // Where nothing stands, the parser's place is behind the line.
    const bool nothing = at && at->key && at->kind == NODE_TEXT && !*at->text && !at->quoted;
    out->line = !at ? 1 : nothing ? at->key_line : at->line;
    out->column = !at ? 1 : nothing ? at->key_column : at->column;
}

void wall_mistake(struct wall_reader *r, const struct wall_node *at, const char *format, ...)
{
    struct wall_mistake m;
    va_list args;
    va_start(args, format);
    mistake_make(&m, at, format, args);
    va_end(args);
    r->m->more = r->m->more || r->m->count == WALL_FAULTS_MAX;
    r->m->count = insert(r->m->at, r->m->count, WALL_FAULTS_MAX, &m);
}

void wall_note(struct wall_reader *r, const struct wall_node *at, const char *format, ...)
{
    struct wall_mistake m;
    va_list args;
    va_start(args, format);
    mistake_make(&m, at, format, args);
    va_end(args);
    r->m->notes = insert(r->m->note, r->m->notes, WALL_NOTES_MAX, &m);
}

struct wall_found wall_found(const struct wall_node *n)
{
    struct wall_found f;
    if (n->kind != NODE_TEXT)
        snprintf(f.s, sizeof(f.s), "a %s of %u", n->kind == NODE_LIST ? "list" : "map", n->count);
    else if (!*n->text)
        snprintf(f.s, sizeof(f.s), "nothing");
    else
        snprintf(f.s, sizeof(f.s), "\"%.40s%s\"", n->text, strlen(n->text) > 40 ? "..." : "");
    return f;
}

/* ---- the tree ----------------------------------------------------------------------------------------------------- */

struct builder {
    struct wall_reader *r;
    yaml_parser_t parser;
    struct wall_node *root;
    struct wall_node *open[WALL_DEPTH_MAX]; /* maps and lists that are being read */
    struct wall_node *key[WALL_DEPTH_MAX];  /* of a map: the key that waits for its value */
    unsigned depth, documents;
    bool stop;
    bool broken; /* no whole tree: what is missing in it is not the file's mistake */
};

static struct wall_node *node_new(struct builder *b, enum wall_node_kind kind, const yaml_mark_t *mark, const char *text,
                                  size_t length)
{
    struct wall_node *n = calloc(1, sizeof(*n) + length + 1);
    if (!n) {
        b->r->no_memory = b->stop = true;
        return NULL;
    }
    n->kind = kind;
    n->line = (unsigned)mark->line + 1;
    n->column = (unsigned)mark->column + 1;
    if (length)
        memcpy(n->text, text, length);
    n->made_before = b->r->nodes;
    b->r->nodes = n;
    return n;
}

static void add_child(struct wall_node *parent, struct wall_node *n, const struct wall_node *key)
{
    n->parent = parent;
    n->index = parent->count++;
    n->key = key ? key->text : NULL;
    n->key_line = key ? key->line : n->line;
    n->key_column = key ? key->column : n->column;
    if (parent->last)
        parent->last->next = n;
    else
        parent->first = n;
    parent->last = n;
}

/* Hangs the node where the parser is. A key waits for its value. */
static void place(struct builder *b, struct wall_node *n)
{
    if (!b->depth) {
        b->root = n;
        return;
    }
    struct wall_node *parent = b->open[b->depth - 1];
    struct wall_node **key = &b->key[b->depth - 1];
    if (parent->kind == NODE_LIST) {
        add_child(parent, n, NULL);
    } else if (!*key) {
        n->parent = parent;
        *key = n;
    } else {
        add_child(parent, n, *key);
        *key = NULL;
    }
}

static void complain_at(struct builder *b, const yaml_mark_t *mark, const char *text)
{
    const struct wall_node at = { .line = (unsigned)mark->line + 1, .column = (unsigned)mark->column + 1 };
    wall_mistake(b->r, &at, "%s", text);
}

static void on_scalar(struct builder *b, const yaml_event_t *e)
{
    const char *text = (const char *)e->data.scalar.value;
    const size_t length = e->data.scalar.length;
    bool clean = memchr(text, '\0', length) == NULL;
    if (!clean) {
        complain_at(b, &e->start_mark, "a NUL character; expected printable text");
        b->broken = true;
    }
    struct wall_node *n = node_new(b, NODE_TEXT, &e->start_mark, text, clean ? length : 0);
    if (!n)
        return;
    n->quoted = e->data.scalar.style != YAML_PLAIN_SCALAR_STYLE;
    place(b, n);
}

static void on_open(struct builder *b, const yaml_event_t *e, enum wall_node_kind kind)
{
    const bool is_key = b->depth && b->open[b->depth - 1]->kind == NODE_MAP && !b->key[b->depth - 1];
    if (is_key) {
        complain_at(b, &e->start_mark, "a key that is a map or a list; expected a word and a colon");
        b->broken = b->stop = true;
        return;
    }
    if (b->depth == WALL_DEPTH_MAX) {
        complain_at(b, &e->start_mark, "maps and lists more than 8 deep; a wall needs 5");
        b->broken = b->stop = true;
        return;
    }
    struct wall_node *n = node_new(b, kind, &e->start_mark, NULL, 0);
    if (!n)
        return;
    place(b, n);
    b->open[b->depth] = n;
    b->key[b->depth++] = NULL;
}

static void refuse(struct builder *b, const yaml_event_t *e, const yaml_char_t *anchor, const yaml_char_t *tag)
{
    char text[160];
    if (anchor) {
        snprintf(text, sizeof(text), "an anchor, \"&%.40s\"; anchors are not read: say the value in each place", anchor);
        complain_at(b, &e->start_mark, text);
    }
    if (tag) {
        snprintf(text, sizeof(text), "a tag, \"%.40s\"; tags are not read: leave it out", tag);
        complain_at(b, &e->start_mark, text);
    }
}

static void on_event(struct builder *b, const yaml_event_t *e)
{
    char text[120];
    switch (e->type) {
    case YAML_DOCUMENT_START_EVENT:
        if (++b->documents == 2) {
            complain_at(b, &e->start_mark, "a second document (\"---\"); one file is one wall");
            b->broken = b->stop = true;
        }
        break;
    case YAML_ALIAS_EVENT:
        snprintf(text, sizeof(text), "an alias, \"*%.40s\"; aliases are not read: say the value", e->data.alias.anchor);
        complain_at(b, &e->start_mark, text);
        b->broken = b->stop = true;
        break;
    case YAML_SCALAR_EVENT:
        refuse(b, e, e->data.scalar.anchor, e->data.scalar.tag);
        on_scalar(b, e);
        break;
    case YAML_SEQUENCE_START_EVENT:
        refuse(b, e, e->data.sequence_start.anchor, e->data.sequence_start.tag);
        on_open(b, e, NODE_LIST);
        break;
    case YAML_MAPPING_START_EVENT:
        refuse(b, e, e->data.mapping_start.anchor, e->data.mapping_start.tag);
        on_open(b, e, NODE_MAP);
        break;
    case YAML_SEQUENCE_END_EVENT:
    case YAML_MAPPING_END_EVENT:
        b->depth--;
        break;
    case YAML_STREAM_END_EVENT:
        b->stop = true;
        break;
    default:
        break;
    }
}

/* The library's words are about YAML; what people do wrong is nearly always one of these. */
static void complain_yaml(struct builder *b)
{
    const yaml_parser_t *p = &b->parser;
    if (p->error == YAML_MEMORY_ERROR) {
        b->r->no_memory = true;
        return;
    }
    const char *problem = p->problem ? p->problem : "it cannot be read";
    const char *hint = "";
    if (strstr(problem, "start any token"))
        hint = " (a tab, or one of @ ` % at a word's start? indent with blanks, or put the word in quotes)";
    else if (strstr(problem, "mapping values are not allowed"))
        hint = " (a colon too many, or the line before is not complete)";
    else if (strstr(problem, "did not find expected"))
        hint = " (is the indentation that of the lines around it, is each bracket closed?)";
    else if (strstr(problem, "could not find expected ':'"))
        hint = " (a colon and a blank are missing after the key)";
    char text[256];
    if (p->error == YAML_READER_ERROR)
        snprintf(text, sizeof(text), "at byte %zu: %s; expected UTF-8 text", p->problem_offset, problem);
    else
        snprintf(text, sizeof(text), "not YAML: %s%s", problem, hint);
    complain_at(b, &p->problem_mark, text);
}

struct wall_node *wall_tree_read(struct wall_reader *r, const char *text, size_t bytes)
{
    struct builder b = { .r = r };
    if (!yaml_parser_initialize(&b.parser)) {
        r->no_memory = true;
        return NULL;
    }
    yaml_parser_set_encoding(&b.parser, YAML_UTF8_ENCODING);
    yaml_parser_set_input_string(&b.parser, (const unsigned char *)text, bytes);
    while (!b.stop) {
        yaml_event_t e;
        if (!yaml_parser_parse(&b.parser, &e)) {
            complain_yaml(&b);
            b.broken = true;
            break;
        }
        on_event(&b, &e);
        yaml_event_delete(&e);
    }
    yaml_parser_delete(&b.parser);
    if (!r->no_memory && !r->m->count && !b.root)
        wall_mistake(r, NULL, "the definition is empty; expected \"wall: NAME\" and what it is made of");
    return r->no_memory || b.broken ? NULL : b.root;
}

void wall_tree_free(struct wall_reader *r)
{
    for (struct wall_node *n = r->nodes, *before; n; n = before) {
        before = n->made_before;
        free(n);
    }
    r->nodes = NULL;
}
