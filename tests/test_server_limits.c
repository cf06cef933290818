// SPDX-License-Identifier: Apache-2.0
// test_server_limits.c - what one user may have, and what a daemon ever has: limits per user, the ceiling, STATUS, cancels at random, and the
// numbers that tell of it. Against real daemons; other users are this process under another id, as far as the socket can tell.
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "daemon_fixture.h"

enum { OTHER_UID = 65534 };

// ---- what is asked ------------------------------------------------------------------------------------

struct ask {
    Airy__Bloom bloom;
    Airy__Payload input;
    Airy__RawLayout raw;
    Airy__RawChannel channel[3], *channels[3];
};

// Interleaved floats, R G B.
static void ask_raw(struct ask *a, uint32_t side)
{
    static char *const names[] = { "R", "G", "B" };
    memset(a, 0, sizeof *a);
    airy__bloom__init(&a->bloom);
    airy__payload__init(&a->input);
    airy__raw_layout__init(&a->raw);
    a->input.kind = AIRY__PAYLOAD__KIND__INLINE;
    a->input.size = (uint64_t)side * side * 12;
    a->raw.width = a->raw.height = side;
    a->raw.type = AIRY__PIXEL_TYPE__PIXEL_FLOAT;
    for (unsigned i = 0; i < 3; i++) {
        a->channels[i] = &a->channel[i];
        airy__raw_channel__init(&a->channel[i]);
        a->channel[i].name = names[i];
        a->channel[i].offset = 4 * i;
        a->channel[i].row_stride = side * 12;
        a->channel[i].pixel_stride = 12;
    }
    a->raw.channels = a->channels;
    a->raw.n_channels = 3;
    a->bloom.input = &a->input;
    a->bloom.format_case = AIRY__BLOOM__FORMAT_RAW;
    a->bloom.raw = &a->raw;
}

static void *zeros(size_t bytes)
{
    void *p = calloc(1, bytes);
    assert_non_null(p);
    return p;
}

static const Airy__Error *refused(struct peer *p, uint64_t id, unsigned code, const char *says)
{
    const Airy__Error *e = peer_expect_error(p, id, code, NULL);
    if (!strstr(e->text, says))
        fail_msg("\"%s\" does not say \"%s\"", e->text, says);
    if (code == FAULT_BUSY)
        assert_true(e->retryable && e->retry_after_ms > 0 && e->queue_position > 0);
    return e;
}

// ---- limits per user ----------------------------------------------------------------------------------

static void test_connections(void **state)
{
    (void)state;
    struct daemon d;
    struct peer p[3], late;
    daemon_start(&d, (const char *const[]){ "--user-connections", "3", NULL });
    for (int i = 0; i < 3; i++)
        peer_hello(&p[i], &d);
    for (int i = 0; i < 40; i++) { // told each time, and not one of them stays
        peer_open(&late, &d);
        refused(&late, 0, FAULT_BUSY, "connections of this user: 4 of 3");
        peer_expect_closed(&late);
        peer_close(&late);
    }
    const Airy__StatusReply *s = peer_status(&p[0]);
    assert_int_equal(s->n_users, 1);
    assert_int_equal(s->users[0]->connections, 3);
    assert_int_equal(s->users[0]->uid, getuid());
    assert_true(s->refused_busy >= 40);
    peer_close(&p[2]);
    for (int i = 0; i < 500 && peer_status(&p[0])->users[0]->connections > 2; i++)
        usleep(10000);
    peer_hello(&late, &d); // its place is free
    peer_close(&late);
    peer_close(&p[0]);
    peer_close(&p[1]);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_requests(void **state)
{
    (void)state;
    struct daemon d;
    struct peer a, b;
    struct ask q;
    struct conn_message m;
    daemon_start(&d, (const char *const[]){ "--user-requests", "3", NULL });
    peer_hello(&a, &d);
    peer_hello(&b, &d);
    ask_raw(&q, 16);
    for (uint64_t id = 1; id <= 3; id++) // half-open: their bytes do not come
        peer_bloom(id % 2 ? &a : &b, id, &q.bloom, NULL, 0);
    peer_status(&a);
    peer_status(&b);
    peer_bloom(&b, 4, &q.bloom, NULL, 0);
    refused(&b, 4, FAULT_BUSY, "requests in flight of this user: 3 of 3");
    assert_int_equal(peer_status(&b)->users[0]->requests, 3);
    // A client that goes takes its requests with it: reconnecting gains nothing, waiting does.
    peer_close(&a);
    for (int i = 0; i < 500 && peer_status(&b)->users[0]->requests > 1; i++)
        usleep(10000);
    void *bytes = zeros(q.input.size);
    peer_bloom(&b, 5, &q.bloom, NULL, 0);
    peer_data(&b, 5, bytes, q.input.size);
    peer_expect(&b, &m, WIRE_DATA, 5);
    peer_expect(&b, &m, WIRE_RESULT, 5);
    free(bytes);
    peer_close(&b);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_bytes(void **state)
{
    (void)state;
    struct daemon d;
    struct peer a, b;
    struct ask q, small;
    daemon_start(&d, (const char *const[]){ "--user-bytes", "1M", NULL });
    peer_hello(&a, &d);
    peer_hello(&b, &d);
    ask_raw(&q, 300);
    peer_bloom(&a, 1, &q.bloom, NULL, 0); // 1 080 000 bytes: never
    refused(&a, 1, FAULT_LIMIT, "payload bytes of a user: 1080000; at most 1048576");
    ask_raw(&q, 200);
    peer_bloom(&a, 2, &q.bloom, NULL, 0); // 480 000, and once more, on two connections
    peer_status(&a);
    peer_bloom(&b, 3, &q.bloom, NULL, 0);
    peer_status(&b);
    peer_bloom(&b, 4, &q.bloom, NULL, 0);
    refused(&b, 4, FAULT_BUSY, "payload bytes in flight of this user: 1440000 of 1048576");
    ask_raw(&small, 16);
    peer_bloom(&b, 5, &small.bloom, NULL, 0);
    const Airy__StatusReply *s = peer_status(&b);
    assert_int_equal(s->users[0]->bytes, 2 * 480000 + 16 * 16 * 12);
    assert_int_equal(s->memory->payloads, 2 * 480000 + 16 * 16 * 12);
    struct conn_message m;
    peer_cancel(&b, 3);
    peer_expect(&b, &m, WIRE_CANCELLED, 3);
    assert_int_equal(peer_status(&b)->users[0]->bytes, 480000 + 16 * 16 * 12);
    peer_close(&a);
    peer_close(&b);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// The kernel notes who connects: this thread's effective id then.
static void hello_as(struct peer *p, const struct daemon *d, uid_t uid)
{
    assert_int_equal(seteuid(uid), 0);
    peer_open(p, d);
    assert_int_equal(seteuid(0), 0);
    Airy__Hello h = AIRY__HELLO__INIT;
    struct conn_message m;
    h.version_min = h.version_max = 1;
    assert_int_equal(body_send(p->conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(p);
    peer_expect(p, &m, WIRE_WELCOME, 0);
}

static const Airy__UserState *user_of(const Airy__StatusReply *s, uid_t uid)
{
    for (size_t i = 0; i < s->n_users; i++)
        if (s->users[i]->uid == uid)
            return s->users[i];
    return NULL;
}

// One user at the limits costs the other nothing.
static void test_users_apart(void **state)
{
    (void)state;
    if (geteuid() != 0) {
        print_message("SKIPPED: connecting as another user takes root\n");
        skip();
    }
    struct daemon d;
    struct peer greedy, other, more;
    struct ask q;
    struct conn_message m;
    daemon_start(&d, (const char *const[]){ "--user-requests", "4", "--user-bytes", "64K", "--user-connections", "1", NULL });
    chmod(d.dir, 0755);
    chmod(d.path, 0666);
    for (int i = 0; i < 500; i++) { // until daemon_start's probe has gone
        peer_open(&greedy, &d);
        struct conn_message none;
        if (peer_next(&greedy, &none, 20) == 0)
            break;
        peer_close(&greedy);
        assert_true(i < 499);
    }
    Airy__Hello h = AIRY__HELLO__INIT;
    h.version_min = h.version_max = 1;
    assert_int_equal(body_send(greedy.conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(&greedy);
    peer_expect(&greedy, &m, WIRE_WELCOME, 0);
    ask_raw(&q, 36); // 15 552 bytes
    for (uint64_t id = 1; id <= 4; id++)
        peer_bloom(&greedy, id, &q.bloom, NULL, 0);
    peer_bloom(&greedy, 5, &q.bloom, NULL, 0);
    refused(&greedy, 5, FAULT_BUSY, "requests in flight of this user: 4 of 4");
    hello_as(&other, &d, OTHER_UID);
    peer_bloom(&other, 1, &q.bloom, NULL, 0);
    void *bytes = zeros(q.input.size);
    peer_data(&other, 1, bytes, q.input.size);
    peer_expect(&other, &m, WIRE_DATA, 1);
    peer_expect(&other, &m, WIRE_RESULT, 1);
    assert_int_equal(seteuid(OTHER_UID), 0);
    peer_open(&more, &d);
    assert_int_equal(seteuid(0), 0);
    refused(&more, 0, FAULT_BUSY, "connections of this user: 2 of 1");
    peer_close(&more);
    const Airy__StatusReply *s = peer_status(&other);
    assert_int_equal(s->n_users, 2);
    assert_int_equal(user_of(s, 0)->requests, 4);
    assert_int_equal(user_of(s, OTHER_UID)->requests, 0);
    free(bytes);
    peer_close(&greedy);
    peer_close(&other);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// ---- the ceiling -----------------------------------------------------------------------------------------

static void submit(struct airy *a, const struct picture *p, bool exr, struct airy_request *r, uint64_t *id)
{
    struct airy_error e;
    size_t bytes = picture_bytes(p);
    uint8_t *file = exr ? picture_exr(p, &bytes) : NULL;
    r->input_fd = make_memfd(exr ? (const void *)file : p->pixels, bytes, F_SEAL_SHRINK);
    r->data = NULL;
    if (!exr)
        picture_request(p, r);
    if (airy_submit(a, r, id, &e) < 0)
        fail_msg("submit: %s %s", e.symbol, e.text);
    close(r->input_fd);
    free(file);
}

// More than there is room for at once: all of it waits for its turn and is done, below the ceiling at all times; what can never
// fit is told so.
static void test_ceiling(void **state)
{
    (void)state;
    enum { FRAMES = 24 };
    struct daemon d;
    struct airy *a;
    struct airy_error e;
    struct airy_status s;
    struct airy_result *result;
    uint64_t id[FRAMES + 2];
    daemon_start(&d, (const char *const[]){ "--memory-bytes", "900M", "--max-frame-bytes", "64M", "--asset-bytes", "1M", "--slots", "6", NULL });
    a = daemon_join(&d);
    static const uint32_t sides[] = { 1200, 400, 900, 1100, 600, 1000 };
    for (unsigned i = 0; i < FRAMES; i++) {
        struct picture p = picture_make(sides[i % 6], sides[i % 6], 300, i);
        struct airy_request r = AIRY_REQUEST_INIT;
        submit(a, &p, i & 1, &r, &id[i]);
        picture_free(&p);
    }
    struct picture huge = picture_make(2600, 2600, 300, 77);
    struct airy_request r = AIRY_REQUEST_INIT;
    assert_int_equal(airy_status(a, &s, 20000, &e), 0);
    submit(a, &huge, false, &r, &id[FRAMES]);
    struct airy_request r2 = AIRY_REQUEST_INIT;
    submit(a, &huge, true, &r2, &id[FRAMES + 1]);
    picture_free(&huge);
    uint64_t rss = 0;
    for (unsigned i = 0; i < FRAMES + 2; i++) {
        int rc = airy_wait(a, id[i], 60000, &result, &e);
        if (i >= FRAMES) {
            assert_int_equal(rc, -1);
            assert_string_equal(e.symbol, "LIMIT");
            assert_non_null(strstr(e.text, "at most"));
            continue;
        }
        if (rc != 1)
            fail_msg("frame %u: %d %s %s", i, rc, e.symbol, e.text);
        airy_result_free(result);
        assert_int_equal(airy_status(a, &s, 20000, &e), 0);
        assert_true(s.memory.work <= s.memory.work_max && s.memory.loads <= s.memory.loads_max);
        rss = s.rss_bytes > rss ? s.rss_bytes : rss;
    }
    assert_int_equal(airy_status(a, &s, 20000, &e), 0);
    print_message("at work at most %.1f of %.1f MB, resident at most %.1f of %.1f MB\n", 1e-6 * (double)s.memory.work_peak,
                  1e-6 * (double)s.memory.work_max, 1e-6 * (double)rss, 1e-6 * (double)s.memory.ceiling);
    assert_true(s.memory.work_peak > s.memory.work_max / 2 && s.memory.work_peak <= s.memory.work_max);
    assert_int_equal(s.memory.loads + s.memory.payloads, 0);
    assert_int_equal(s.user[0].bytes, 0);
    if (!daemon_sanitized())
        assert_true(rss <= s.memory.ceiling);
    airy_close(a);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// ---- STATUS, cancels --------------------------------------------------------------------------------------

// However much there is to do, a turn of the socket thread answers every STATUS that is there: many of them, sent at once, are all
// answered within two turns.
static void test_status_turns(void **state)
{
    (void)state;
    enum { FRAMES = 12, ASKED = 40 };
    struct daemon d;
    struct peer p;
    struct airy *a;
    struct airy_error e;
    struct airy_result *result;
    struct conn_message m;
    struct body_arena arena = { 0 };
    uint64_t id[FRAMES];
    daemon_start(&d, NULL);
    a = daemon_join(&d);
    peer_hello(&p, &d);
    struct picture big = picture_make(1400, 1000, 500, 6);
    for (int i = 0; i < FRAMES; i++) {
        struct airy_request r = AIRY_REQUEST_INIT;
        submit(a, &big, i & 1, &r, &id[i]);
    }
    unsigned busy = 0;
    double worst = 0;
    for (int round = 0; round < 10; round++) {
        uint8_t h[ASKED * WIRE_HEADER_BYTES];
        for (unsigned i = 0; i < ASKED; i++)
            wire_encode(h + i * WIRE_HEADER_BYTES, &(struct wire_header){ .type = WIRE_STATUS, .id = i + 1 });
        assert_int_equal(send(conn_fd(p.conn), h, sizeof h, MSG_NOSIGNAL), sizeof h);
        uint64_t first = 0, last = 0;
        for (unsigned i = 0; i < ASKED; i++) {
            struct fault f;
            peer_expect(&p, &m, WIRE_STATUS_REPLY, i + 1);
            const Airy__StatusReply *s = body_unpack(&airy__status_reply__descriptor, m.body, m.header.body_bytes, &arena, &f);
            assert_non_null(s);
            first = i ? first : s->loop_turns;
            last = s->loop_turns;
            busy += s->running > 0;
            worst = s->loop_worst_ms;
        }
        assert_true(last - first <= 2);
        usleep(20000);
    }
    print_message("the longest turn took %.2f ms; the daemon was at work for %u of %u answers\n", worst, busy, 10 * ASKED);
    assert_true(busy >= ASKED);
    for (int i = 0; i < FRAMES; i++) {
        if (airy_wait(a, id[i], 60000, &result, &e) != 1)
            fail_msg("%s", e.text);
        airy_result_free(result);
    }
    body_arena_finish(&arena);
    picture_free(&big);
    airy_close(a);
    peer_close(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static uint32_t lcg(uint32_t *s) { return (*s = *s * 1664525u + 1013904223u) >> 8; }

// Uploads in pieces and cancels at any moment, some twice, some before, some after: of each request one end, and no second.
static void test_random_cancels(void **state)
{
    (void)state;
    enum { REQUESTS = 400, OPEN_MAX = 24, SIDE = 40, BYTES = SIDE * SIDE * 12 };
    uint32_t seed = 20251122;
    struct daemon d;
    struct peer p;
    struct ask q;
    struct conn_message m;
    static unsigned ends[REQUESTS + 1], sent[REQUESTS + 1], by[3];
    memset(ends, 0, sizeof ends);
    memset(sent, 0, sizeof sent);
    memset(by, 0, sizeof by);
    uint8_t *bytes = zeros(BYTES);
    const float lamp = 100;
    memcpy(bytes + 7 * 12, &lamp, 4);
    daemon_start(&d, (const char *const[]){ "--slots", "2", NULL });
    peer_hello(&p, &d);
    unsigned asked = 0, open = 0;
    while (asked < REQUESTS || open) {
        if (asked < REQUESTS && open < OPEN_MAX) {
            ask_raw(&q, SIDE);
            q.bloom.priority = (int32_t)(lcg(&seed) % 21) - 10;
            peer_bloom(&p, ++asked, &q.bloom, NULL, 0);
            open++;
        }
        for (unsigned id = asked > 40 ? asked - 40 : 1; id <= asked; id++) {
            const uint32_t dice = lcg(&seed) % 16;
            if (!ends[id] && sent[id] < BYTES && dice < 8) {
                unsigned n = dice < 4 ? BYTES - sent[id] : lcg(&seed) % (BYTES - sent[id]) + 1;
                peer_data(&p, id, bytes + sent[id], n);
                sent[id] += n;
            } else if (dice == 15 || (asked == REQUESTS && sent[id] < BYTES)) {
                peer_cancel(&p, id);
                if (lcg(&seed) & 1)
                    peer_cancel(&p, id);
            }
        }
        while (peer_next(&p, &m, open == OPEN_MAX || asked == REQUESTS ? 20 : 0) > 0) {
            const int end = m.header.type == WIRE_RESULT ? 0 : m.header.type == WIRE_CANCELLED ? 1 : m.header.type == WIRE_ERROR ? 2 : -1;
            if (end < 0)
                continue;
            by[end]++;
            assert_in_range(m.header.id, 1, asked);
            if (++ends[m.header.id] > 1)
                fail_msg("request %u ended twice (seed 20251122)", (unsigned)m.header.id);
            open--;
        }
    }
    print_message("%u results, %u cancelled, %u errors\n", by[0], by[1], by[2]);
    assert_int_equal(by[0] + by[1], REQUESTS);
    assert_true(by[0] > 20 && by[1] > 20);
    const Airy__StatusReply *s = peer_status(&p);
    assert_int_equal(s->done, by[0]);
    assert_int_equal(s->cancelled, by[1]);
    assert_int_equal(s->queued + s->running + s->users[0]->requests, 0);
    assert_int_equal(s->users[0]->bytes + s->memory->payloads + s->memory->loads, 0);
    free(bytes);
    peer_close(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_priority_and_deadline(void **state)
{
    (void)state;
    struct daemon d;
    struct peer p;
    struct ask q;
    struct conn_message m;
    daemon_start(&d, (const char *const[]){ "--slots", "1", NULL });
    peer_hello(&p, &d);
    ask_raw(&q, 16);
    q.bloom.priority = 11;
    peer_bloom(&p, 1, &q.bloom, NULL, 0);
    peer_expect_error(&p, 1, FAULT_PARAM_RANGE, "priority");
    ask_raw(&q, 1500);
    uint8_t *bytes = zeros(q.input.size);
    const float lamp = 100;
    memcpy(bytes, &lamp, 4);
    int fd = make_memfd(bytes, q.input.size, F_SEAL_SHRINK);
    q.input.kind = AIRY__PAYLOAD__KIND__MEMFD;
    Airy__Output output = AIRY__OUTPUT__INIT;
    output.kind = AIRY__OUTPUT__KIND__MEMFD;
    q.bloom.output = &output;
    for (uint64_t id = 2; id <= 6; id++) {
        q.bloom.deadline_ms = id == 6 ? 1 : 0; // behind four frames of some 100 ms
        peer_bloom(&p, id, &q.bloom, &fd, 1);
    }
    unsigned results = 0, late = 0;
    while (results + late < 5) {
        assert_int_equal(peer_next(&p, &m, 60000), 1);
        results += m.header.type == WIRE_RESULT;
        if (m.header.type == WIRE_RESULT)
            close(m.fds[0]);
        if (m.header.type != WIRE_ERROR)
            continue;
        struct fault f;
        struct body_arena arena = { 0 };
        const Airy__Error *e = body_unpack(&airy__error__descriptor, m.body, m.header.body_bytes, &arena, &f);
        assert_int_equal(m.header.id, 6);
        assert_string_equal(e->symbol, "DEADLINE");
        assert_true(e->retryable);
        assert_true(results < 4); // it did not wait for the end of the queue
        late++;
        body_arena_finish(&arena);
    }
    assert_int_equal(late, 1);
    close(fd);
    free(bytes);
    peer_close(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// ---- the numbers ------------------------------------------------------------------------------------------

static char *run_airy(const struct daemon *d, const char *words)
{
    const char *airy = getenv("AIRY");
    char command[400];
    snprintf(command, sizeof command, "%s %s --socket %s", airy ? airy : "build/airy", words, d->path);
    FILE *pipe = popen(command, "r");
    assert_non_null(pipe);
    char *text = zeros(1 << 20);
    size_t n = fread(text, 1, (1 << 20) - 1, pipe);
    text[n] = 0;
    if (pclose(pipe) != 0)
        fail_msg("%s failed: %s", command, text);
    return text;
}

struct family {
    char name[80], type[16];
    unsigned samples;
};

static bool is_name(const char *s, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!((s[i] >= 'a' && s[i] <= 'z') || (s[i] >= 'A' && s[i] <= 'Z') || s[i] == '_' || s[i] == ':' || (i && s[i] >= '0' && s[i] <= '9')))
            return false;
    return n > 0;
}

// name{label="value",...} number: returns the number; the labels must be quoted and their names be names.
static double sample(const char *line, char name[80])
{
    size_t n = strcspn(line, "{ ");
    assert_true(n < 80 && is_name(line, n));
    memcpy(name, line, n);
    name[n] = 0;
    const char *at = line + n;
    while (*at == '{' || *at == ',') {
        at++;
        size_t label = strcspn(at, "=");
        assert_true(is_name(at, label));
        at += label;
        assert_true(at[0] == '=' && at[1] == '"');
        for (at += 2; *at && *at != '"'; at++)
            at += *at == '\\' && at[1];
        assert_int_equal(*at, '"');
        at++;
    }
    if (*at == '}')
        at++;
    assert_int_equal(*at, ' ');
    char *end;
    double value = strtod(at + 1, &end);
    assert_true(end != at + 1 && *end == 0);
    return value;
}

// As promtool's check: a family's HELP and TYPE before its samples, together and once; counters' names; whole histograms.
static void check_prometheus(char *text)
{
    struct family f[64];
    unsigned n = 0;
    double bucket = -1, inf = -1;
    unsigned histograms = 0;
    char *save = NULL;
    for (char *line = strtok_r(text, "\n", &save); line; line = strtok_r(NULL, "\n", &save)) {
        char name[80], type[16];
        if (!strncmp(line, "# HELP ", 7))
            continue;
        if (sscanf(line, "# TYPE %79s %15s", name, type) == 2) {
            for (unsigned i = 0; i < n; i++)
                if (!strcmp(f[i].name, name))
                    fail_msg("%s comes twice", name);
            assert_true(n < 64 && (!strcmp(type, "counter") || !strcmp(type, "gauge") || !strcmp(type, "histogram")));
            strcpy(f[n].name, name);
            strcpy(f[n].type, type);
            f[n++].samples = 0;
            size_t len = strlen(name);
            assert_int_equal(!strcmp(type, "counter"), len > 6 && !strcmp(name + len - 6, "_total"));
            continue;
        }
        double value = sample(line, name);
        assert_true(n > 0 && !strncmp(name, f[n - 1].name, strlen(f[n - 1].name)));
        f[n - 1].samples++;
        const char *rest = name + strlen(f[n - 1].name);
        if (strcmp(f[n - 1].type, "histogram")) {
            assert_string_equal(rest, "");
        } else if (!strcmp(rest, "_bucket")) {
            assert_true(value >= bucket); // cumulative
            bucket = value;
            if (strstr(line, "le=\"+Inf\""))
                inf = value;
        } else if (!strcmp(rest, "_count")) {
            assert_true(inf >= 0 && value == inf);
            bucket = inf = -1;
            histograms++;
        } else {
            assert_string_equal(rest, "_sum");
        }
    }
    assert_int_equal(histograms, 6);
    assert_true(n > 20);
    for (unsigned i = 0; i < n; i++)
        if (!f[i].samples)
            fail_msg("%s has no sample", f[i].name);
}

static void test_numbers(void **state)
{
    (void)state;
    struct daemon d;
    struct airy_error e;
    struct airy_result *result;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(64, 64, 300, 1);
    for (int i = 0; i < 5; i++) {
        struct airy_request r = AIRY_REQUEST_INIT;
        uint64_t id;
        submit(a, &p, i & 1, &r, &id);
        if (airy_wait(a, id, 60000, &result, &e) != 1)
            fail_msg("%s", e.text);
        airy_result_free(result);
    }
    static struct airy_status s;
    assert_int_equal(airy_status(a, &s, 10000, &e), 0);
    assert_int_equal(s.n_stages, 6);
    for (unsigned i = 0; i < 6; i++) {
        uint64_t all = 0;
        for (unsigned k = 0; k <= s.n_buckets; k++)
            all += s.stage[i].counts[k];
        assert_int_equal(all, 5);
    }
    assert_true(s.user[0].device_ms > 0 && s.user[0].fds >= 1);
    char *text = run_airy(&d, "status --prometheus");
    char *done = strstr(text, "airyd_requests_total{end=\"done\"} 5\n");
    assert_non_null(done);
    assert_non_null(strstr(text, "airyd_stage_seconds_bucket{stage=\"bloom\",le=\"+Inf\"} 5\n"));
    check_prometheus(text);
    free(text);
    text = run_airy(&d, "top --once");
    assert_non_null(strstr(text, "half are within"));
    assert_null(strchr(text, '\033'));
    free(text);
    text = run_airy(&d, "top --once --json");
    assert_non_null(strstr(text, "\"users\":[{\"uid\":"));
    assert_true(strchr(text, '\n') == text + strlen(text) - 1);
    free(text);
    picture_free(&p);
    airy_close(a);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_connections),    cmocka_unit_test(test_requests),
        cmocka_unit_test(test_bytes),          cmocka_unit_test(test_users_apart),
        cmocka_unit_test(test_ceiling),        cmocka_unit_test(test_status_turns),
        cmocka_unit_test(test_random_cancels), cmocka_unit_test(test_priority_and_deadline),
        cmocka_unit_test(test_numbers),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
