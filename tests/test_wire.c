// SPDX-License-Identifier: Apache-2.0
//
// test_wire.c - headers, bodies, the golden vectors, and PROTOCOL.md's tables and dumps against the
// code. Runs in the top folder of the tree, or in the one that AIRY_TREE names.
#include <dirent.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "body.h"
#include "params.h"
#include "wire.h"

static char *read_whole(const char *path)
{
    const char *tree = getenv("AIRY_TREE");
    char full[4096];
    snprintf(full, sizeof(full), "%s/%s", tree ? tree : ".", path);
    FILE *f = fopen(full, "rb");
    if (!f)
        fail_msg("cannot open %s (run in the top folder, or set AIRY_TREE)", full);
    size_t size = 1 << 20, n;
    char *text = malloc(size);
    assert_non_null(text);
    n = fread(text, 1, size - 1, f);
    assert_true(n < size - 1);
    text[n] = 0;
    fclose(f);
    return text;
}

// Bytes of hex digits up to `end`, blanks ignored; stops a line at '|'.
static size_t parse_hex(const char *text, const char *end, uint8_t *out, size_t max)
{
    size_t digits = 0;
    for (; text < end; text++) {
        if (*text == '|') {
            while (text + 1 < end && text[1] != '\n')
                text++;
            continue;
        }
        const char *hex = "0123456789abcdef", *p = *text ? strchr(hex, *text) : NULL;
        if (!p) {
            assert_non_null(strchr(" \n", *text));
            continue;
        }
        assert_true(digits / 2 < max);
        unsigned v = (unsigned)(p - hex);
        out[digits / 2] = (uint8_t)(digits % 2 ? out[digits / 2] | v : v << 4);
        digits++;
    }
    assert_int_equal(digits % 2, 0);
    return digits / 2;
}

// ---- headers -------------------------------------------------------------------------------------

static void header_bytes_are_as_documented(void **state)
{
    (void)state;
    static const uint8_t expected[WIRE_HEADER_BYTES] = { 'A',  'I',  'R',  'Y', 1, 3, 2, 0,
                                                         0x04, 0x03, 0x00, 0,   0, 0, 0, 0,
                                                         8,    7,    6,    5,   4, 3, 2, 1 };
    uint8_t bytes[WIRE_HEADER_BYTES];
    struct wire_header h = {
        .type = WIRE_BLOOM, .n_fds = 2, .body_bytes = 0x304, .id = UINT64_C(0x0102030405060708)
    };
    wire_encode(bytes, &h);
    assert_memory_equal(bytes, expected, sizeof(bytes));
    struct wire_header back;
    struct fault f;
    assert_int_equal(wire_decode(&back, bytes, WIRE_CLIENT, &f), 0);
    assert_int_equal(back.type, h.type);
    assert_int_equal(back.n_fds, 2);
    assert_int_equal(back.flags, 0);
    assert_int_equal(back.body_bytes, 0x304);
    assert_true(back.id == h.id);
}

struct type_rule {
    enum wire_type type;
    char who;
    unsigned fds;
};
static const struct type_rule rules[] = {
#define X(number, name, who, fds) { number, who, fds },
    WIRE_TYPES(X)
#undef X
};

static void each_type_has_its_sender_length_and_fds(void **state)
{
    (void)state;
    for (unsigned i = 0; i < sizeof(rules) / sizeof(rules[0]); i++)
        for (unsigned end = 0; end < 2; end++) {
            const struct type_rule *r = &rules[i];
            enum wire_end sender = end ? WIRE_CLIENT : WIRE_DAEMON;
            uint32_t max = r->type == WIRE_DATA ? WIRE_DATA_BYTES_MAX : WIRE_CONTROL_BYTES_MAX;
            bool may = r->who == 'B' || r->who == (char)sender;
            uint8_t bytes[WIRE_HEADER_BYTES];
            struct wire_header h,
                header = { .type = r->type, .n_fds = (uint8_t)r->fds, .body_bytes = max };
            struct fault f;
            wire_encode(bytes, &header);
            assert_int_equal(wire_decode(&h, bytes, sender, &f), may ? 0 : -1);
            if (!may) {
                assert_int_equal(f.code, FAULT_UNEXPECTED);
                continue;
            }
            header.body_bytes = max + 1;
            wire_encode(bytes, &header);
            assert_int_equal(wire_decode(&h, bytes, sender, &f), -1);
            assert_int_equal(f.code, FAULT_TOO_LONG);
            header.body_bytes = max;
            header.n_fds++;
            wire_encode(bytes, &header);
            assert_int_equal(wire_decode(&h, bytes, sender, &f), -1);
            assert_int_equal(f.code, FAULT_BAD_FDS);
            assert_string_equal(f.field, "header.n_fds");
        }
}

static uint64_t next_random(uint64_t *s)
{
    *s ^= *s << 13;
    *s ^= *s >> 7;
    *s ^= *s << 17;
    return *s;
}

// Whatever is accepted encodes back to the same bytes, and is within every limit.
static void fuzzed_headers_are_refused_or_exact(void **state)
{
    (void)state;
    uint64_t seed = UINT64_C(0x9e3779b97f4a7c15), s = seed;
    unsigned accepted = 0, refused = 0;
    for (unsigned i = 0; i < 2000000; i++) {
        uint8_t bytes[WIRE_HEADER_BYTES], again[WIRE_HEADER_BYTES];
        wire_encode(bytes, &(struct wire_header){ .type = 1 + next_random(&s) % (sizeof(rules) / sizeof(rules[0])),
                                                  .body_bytes = (uint32_t)(next_random(&s) % 70000),
                                                  .id = next_random(&s) });
        for (unsigned k = next_random(&s) % 4; k; k--)
            bytes[next_random(&s) % WIRE_HEADER_BYTES] = (uint8_t)next_random(&s);
        if (i % 16 == 0)
            for (unsigned k = 0; k < WIRE_HEADER_BYTES; k++)
                bytes[k] = (uint8_t)next_random(&s);
        struct wire_header h;
        struct fault f = { .code = FAULT_NONE };
        if (wire_decode(&h, bytes, i % 2 ? WIRE_CLIENT : WIRE_DAEMON, &f) < 0) {
            refused++;
            if (f.code < FAULT_BAD_MAGIC || f.code > FAULT_BAD_FDS || !f.text[0])
                fail_msg("seed %" PRIx64 " step %u: code %d, text '%s'", seed, i, f.code, f.text);
            continue;
        }
        accepted++;
        wire_encode(again, &h);
        if (memcmp(bytes, again, sizeof(bytes)) || h.n_fds > WIRE_FDS_MAX ||
            h.body_bytes > WIRE_DATA_BYTES_MAX)
            fail_msg("seed %" PRIx64 " step %u: not exact", seed, i);
    }
    assert_true(accepted > 100000 && refused > 100000);
}

// ---- bodies ----------------------------------------------------------------------------------------

static void hostile_bodies_stay_within_the_arena(void **state)
{
    (void)state;
    struct body_arena arena = { 0 };
    struct fault f;
    // Field 1 of Bloom, length 0: a Param in two bytes, 32768 times.
    uint8_t *bomb = malloc(WIRE_CONTROL_BYTES_MAX);
    assert_non_null(bomb);
    for (unsigned i = 0; i < WIRE_CONTROL_BYTES_MAX; i += 2)
        memcpy(bomb + i, "\x0a\x00", 2);
    assert_null(body_unpack(&airy__bloom__descriptor, bomb, WIRE_CONTROL_BYTES_MAX, &arena, &f));
    assert_int_equal(f.code, FAULT_BAD_BODY);
    assert_non_null(strstr(f.text, "KiB"));
    // The arena is as good as new.
    Airy__Bloom *b = body_unpack(&airy__bloom__descriptor, bomb, 20, &arena, &f);
    assert_non_null(b);
    assert_int_equal(b->n_params, 10);
    assert_string_equal(b->params[9]->name, "");
    free(bomb);
    body_arena_finish(&arena);
}

static void an_arena_is_reused(void **state)
{
    (void)state;
    struct body_arena arena = { 0 };
    struct fault f;
    uint8_t body[4000] = { 0x1a, 0x9d, 0x1f }; // Hello.client, 3997 bytes
    memset(body + 3, 'x', sizeof(body) - 3);
    struct body_arena before = { 0 };
    for (unsigned i = 0; i < 1000; i++) {
        Airy__Hello *h = body_unpack(&airy__hello__descriptor, body, sizeof(body), &arena, &f);
        assert_non_null(h);
        assert_int_equal(strlen(h->client), 3997);
        if (i == 0)
            before = arena;
    }
    assert_memory_equal(&before, &arena, sizeof(arena));
    void *p = body_arena_alloc(&arena, 100000);
    assert_non_null(p);
    assert_null(body_arena_alloc(&arena, 600 * 1024));
    assert_null(body_arena_alloc(&arena, SIZE_MAX));
    body_arena_finish(&arena);
}

static void fuzzed_bodies_never_break_the_decoder(void **state)
{
    (void)state;
    static const ProtobufCMessageDescriptor *const types[] = {
        &airy__hello__descriptor,    &airy__welcome__descriptor,      &airy__bloom__descriptor,
        &airy__result__descriptor,   &airy__error__descriptor,        &airy__credit__descriptor,
        &airy__progress__descriptor, &airy__status_reply__descriptor, &airy__asset__descriptor,
        &airy__asset_kept__descriptor, &airy__wall__descriptor,       &airy__wall_reply__descriptor,
    };
    char *seed_text = read_whole("proto/vectors/result_memfd.hex");
    uint8_t good[4096];
    size_t good_bytes = parse_hex(seed_text, seed_text + strlen(seed_text), good, sizeof(good));
    free(seed_text);
    struct body_arena arena = { 0 };
    uint64_t s = UINT64_C(0x2545f4914f6cdd1d);
    unsigned ok = 0, bad = 0;
    for (unsigned i = 0; i < 200000; i++) {
        uint8_t body[512];
        size_t n = good_bytes - WIRE_HEADER_BYTES < sizeof(body) ? good_bytes - WIRE_HEADER_BYTES
                                                                 : sizeof(body);
        memcpy(body, good + WIRE_HEADER_BYTES, n);
        for (unsigned k = 1 + next_random(&s) % 6; k; k--)
            body[next_random(&s) % n] = (uint8_t)next_random(&s);
        n = next_random(&s) % (n + 1);
        // A copy of exactly that size, so that a read past the end is seen.
        uint8_t *exact = malloc(n ? n : 1);
        memcpy(exact, body, n);
        struct fault f = { .code = FAULT_NONE };
        if (body_unpack(types[i % (sizeof(types) / sizeof(types[0]))], exact, n, &arena, &f)) {
            ok++;
        } else {
            bad++;
            assert_int_equal(f.code, FAULT_BAD_BODY);
        }
        free(exact);
    }
    assert_true(ok > 1000 && bad > 1000);
    body_arena_finish(&arena);
}

// ---- vectors ---------------------------------------------------------------------------------------

// The text between `key` and the next quote; the files are ours and simple.
static bool json_word(const char *json, const char *key, char *out, size_t size)
{
    const char *p = strstr(json, key);
    if (!p)
        return false;
    p += strlen(key);
    snprintf(out, size, "%.*s", (int)strcspn(p, "\","), p);
    return true;
}

static const ProtobufCMessageDescriptor *body_descriptor(enum wire_type t)
{
    switch (t) {
    case WIRE_HELLO:
        return &airy__hello__descriptor;
    case WIRE_WELCOME:
        return &airy__welcome__descriptor;
    case WIRE_BLOOM:
        return &airy__bloom__descriptor;
    case WIRE_RESULT:
        return &airy__result__descriptor;
    case WIRE_ERROR:
        return &airy__error__descriptor;
    case WIRE_STATUS_REPLY:
        return &airy__status_reply__descriptor;
    case WIRE_CREDIT:
        return &airy__credit__descriptor;
    case WIRE_PROGRESS:
        return &airy__progress__descriptor;
    case WIRE_ASSET:
        return &airy__asset__descriptor;
    case WIRE_ASSET_KEPT:
        return &airy__asset_kept__descriptor;
    case WIRE_WALL:
        return &airy__wall__descriptor;
    case WIRE_WALL_REPLY:
        return &airy__wall_reply__descriptor;
    default:
        return NULL;
    }
}

static void check_bad(const char *name, const char *expected, const uint8_t *bytes, size_t n,
                      enum wire_end from)
{
    struct wire_header h;
    struct fault f = { .code = FAULT_NONE };
    struct body_arena arena = { 0 };
    if (wire_decode(&h, bytes, from, &f) == 0) {
        assert_non_null(body_descriptor(h.type));
        assert_int_equal(h.body_bytes, n - WIRE_HEADER_BYTES);
        assert_null(
            body_unpack(body_descriptor(h.type), bytes + WIRE_HEADER_BYTES, h.body_bytes, &arena, &f));
    }
    if (strcmp(fault_symbol(f.code), expected))
        fail_msg("%s: %s (%s), expected %s", name, fault_symbol(f.code), f.text, expected);
    body_arena_finish(&arena);
}

static void check_good(const char *name, const char *json, const uint8_t *bytes, size_t n,
                       enum wire_end from, unsigned *seen)
{
    struct wire_header h;
    struct fault f;
    char word[64], expected[64];
    if (wire_decode(&h, bytes, from, &f) < 0)
        fail_msg("%s: %s", name, f.text);
    *seen |= 1u << h.type;
    uint8_t again[4096];
    wire_encode(again, &h);
    assert_memory_equal(again, bytes, WIRE_HEADER_BYTES);
    assert_int_equal(h.body_bytes, n - WIRE_HEADER_BYTES);
    assert_true(json_word(json, "\"type\": \"", word, sizeof(word)));
    assert_string_equal(word, wire_type_name(h.type));
    assert_true(json_word(json, "\"id\": \"", word, sizeof(word)));
    snprintf(expected, sizeof(expected), "%" PRIu64, h.id);
    assert_string_equal(word, expected);
    assert_true(json_word(json, "\"n_fds\": ", word, sizeof(word)));
    snprintf(expected, sizeof(expected), "%u", h.n_fds);
    assert_string_equal(word, expected);
    const ProtobufCMessageDescriptor *d = body_descriptor(h.type);
    if (!d)
        return;
    struct body_arena arena = { 0 };
    ProtobufCMessage *m = body_unpack(d, bytes + WIRE_HEADER_BYTES, h.body_bytes, &arena, &f);
    if (!m)
        fail_msg("%s: %s", name, f.text);
    assert_int_equal(m->n_unknown_fields, 0);
    assert_int_equal(protobuf_c_message_get_packed_size(m), h.body_bytes);
    protobuf_c_message_pack(m, again);
    assert_memory_equal(again, bytes + WIRE_HEADER_BYTES, h.body_bytes);
    body_arena_finish(&arena);
}

static void vectors_decode_and_encode_back(void **state)
{
    (void)state;
    const char *tree = getenv("AIRY_TREE");
    char path[4096];
    snprintf(path, sizeof(path), "%s/proto/vectors", tree ? tree : ".");
    DIR *folder = opendir(path);
    if (!folder)
        fail_msg("cannot open %s", path);
    unsigned seen = 0, good = 0, bad = 0;
    for (struct dirent *entry; (entry = readdir(folder));) {
        char name[256], from[16], symbol[32], hex_path[600], hex_in_json[8192];
        if (sscanf(entry->d_name, "%200[a-z_].json", name) != 1 || !strstr(entry->d_name, ".json"))
            continue;
        snprintf(hex_path, sizeof(hex_path), "proto/vectors/%s.json", name);
        char *json = read_whole(hex_path);
        snprintf(hex_path, sizeof(hex_path), "proto/vectors/%s.hex", name);
        char *hex = read_whole(hex_path);
        uint8_t bytes[4096], same[4096];
        size_t n = parse_hex(hex, hex + strlen(hex), bytes, sizeof(bytes));
        assert_true(n >= WIRE_HEADER_BYTES);
        assert_true(json_word(json, "\"hex\": \"", hex_in_json, sizeof(hex_in_json)));
        assert_int_equal(parse_hex(hex_in_json, hex_in_json + strlen(hex_in_json), same, sizeof(same)),
                         n);
        assert_memory_equal(bytes, same, n);
        assert_true(json_word(json, "\"from\": \"", from, sizeof(from)));
        enum wire_end end = !strcmp(from, "client") ? WIRE_CLIENT : WIRE_DAEMON;
        if (json_word(json, "\"error\": \"", symbol, sizeof(symbol))) {
            check_bad(name, symbol, bytes, n, end);
            bad++;
        } else {
            check_good(name, json, bytes, n, end, &seen);
            good++;
        }
        free(json);
        free(hex);
    }
    closedir(folder);
    for (unsigned i = 0; i < sizeof(rules) / sizeof(rules[0]); i++)
        if (!(seen & 1u << rules[i].type))
            fail_msg("no vector has a %s", wire_type_name(rules[i].type));
    assert_true(good >= 18 && bad >= 15);
}

// ---- PROTOCOL.md -------------------------------------------------------------------------------------

// The lines that begin with "| " between the marks <!-- NAME --> and <!-- /NAME -->.
static unsigned table_rows(const char *document, const char *name, const char **begin, const char **end)
{
    char mark[64];
    snprintf(mark, sizeof(mark), "<!-- %s -->", name);
    *begin = strstr(document, mark);
    snprintf(mark, sizeof(mark), "<!-- /%s -->", name);
    *end = *begin ? strstr(*begin, mark) : NULL;
    if (!*end)
        fail_msg("PROTOCOL.md has no table between the marks of %s", name);
    unsigned n = 0;
    for (const char *p = *begin; (p = strstr(p, "\n| ")) && p < *end; p++)
        n++;
    assert_true(n >= 1);
    return n - 1; // the heading
}

static void expect_row(const char *begin, const char *end, const char *row)
{
    const char *p = strstr(begin, row);
    if (!p || p > end)
        fail_msg("PROTOCOL.md lacks the row: %s", row);
}

static void word_at(char *out, size_t size, const char *words, unsigned n)
{
    for (; n; n--)
        words += strcspn(words, " ") + 1;
    snprintf(out, size, "%.*s", (int)strcspn(words, " "), words);
}

static void the_document_has_every_type_fault_and_parameter(void **state)
{
    (void)state;
    char *document = read_whole("proto/PROTOCOL.md"), row[1024], word[64];
    const char *begin, *end;
    unsigned rows, n = 0;
    rows = table_rows(document, "types", &begin, &end);
    for (unsigned i = 0; i < sizeof(rules) / sizeof(rules[0]); i++, n++) {
        snprintf(row, sizeof(row), "\n| %d | %s | %s | %u |", rules[i].type,
                 wire_type_name(rules[i].type),
                 rules[i].who == 'C'   ? "client"
                 : rules[i].who == 'D' ? "daemon"
                                       : "both",
                 rules[i].fds);
        expect_row(begin, end, row);
    }
    assert_int_equal(rows, n);

    rows = table_rows(document, "faults", &begin, &end);
    n = 0;
#define X(code, symbol, retryable, closes, text)                                                        \
    snprintf(row, sizeof(row), "\n| %d | %s | %s | %s | %s |\n", code, #symbol, retryable ? "yes" : "", \
             closes ? "yes" : "", text);                                                                \
    expect_row(begin, end, row);                                                                        \
    n++;
    AIRY_FAULTS(X)
#undef X
    assert_int_equal(rows, n);

    rows = table_rows(document, "params", &begin, &end);
    n = 0;
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    snprintf(row, sizeof(row), "\n| %s | number | %.15g | %.15g to %.15g | %s | %s |\n", #name,         \
             (double)(def), (double)(min), (double)(max), unit, help);                                  \
    expect_row(begin, end, row);                                                                        \
    n++;
#define CHOICE(name, field, def, words, help)                                                           \
    word_at(word, sizeof(word), words, def);                                                            \
    snprintf(row, sizeof(row), "\n| %s | choice | %s | %s | | %s |\n", #name, word, words, help);       \
    expect_row(begin, end, row);                                                                        \
    n++;
#define TEXT(name, field, def, help)                                                                    \
    snprintf(row, sizeof(row), "\n| %s | text | %s | | | %s |\n", #name, def, help);                    \
    expect_row(begin, end, row);                                                                        \
    n++;
#include "params.def"
    assert_int_equal(rows, n);
    free(document);
}

static void the_documents_dumps_are_the_vectors(void **state)
{
    (void)state;
    char *document = read_whole("proto/PROTOCOL.md");
    unsigned n = 0;
    for (const char *p = document; (p = strstr(p, "\n```hex ")); n++) {
        char name[64], path[128];
        p += strlen("\n```hex ");
        size_t length = strcspn(p, "\n");
        snprintf(name, sizeof(name), "%.*s", (int)length, p);
        const char *begin = p + length, *end = strstr(begin, "```");
        assert_non_null(end);
        uint8_t dump[4096], vector[4096];
        size_t bytes = parse_hex(begin, end, dump, sizeof(dump));
        snprintf(path, sizeof(path), "proto/vectors/%s.hex", name);
        char *hex = read_whole(path);
        assert_int_equal(parse_hex(hex, hex + strlen(hex), vector, sizeof(vector)), bytes);
        assert_memory_equal(dump, vector, bytes);
        free(hex);
        p = end;
    }
    assert_true(n >= 8);
    free(document);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(header_bytes_are_as_documented),
        cmocka_unit_test(each_type_has_its_sender_length_and_fds),
        cmocka_unit_test(fuzzed_headers_are_refused_or_exact),
        cmocka_unit_test(hostile_bodies_stay_within_the_arena),
        cmocka_unit_test(an_arena_is_reused),
        cmocka_unit_test(fuzzed_bodies_never_break_the_decoder),
        cmocka_unit_test(vectors_decode_and_encode_back),
        cmocka_unit_test(the_document_has_every_type_fault_and_parameter),
        cmocka_unit_test(the_documents_dumps_are_the_vectors),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
