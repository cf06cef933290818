// SPDX-License-Identifier: Apache-2.0
//
// usb_vhci.c - see usb_vhci.h. The protocol is the kernel's (Documentation/usb/usbip_protocol): a header of twelve big-endian
// words, then the data; after the hand-over of the socket there is no handshake.
#include "usb_vhci.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "usb_kit_model.h"

enum { SUBMIT = 1, UNLINK, RET_SUBMIT, RET_UNLINK };
enum { W_COMMAND, W_SEQUENCE, W_DEVICE, W_IN, W_ENDPOINT, W_BODY, HEADER_WORDS = 12 }; // W_BODY: the first word that differs
enum { W_UNLINKED = W_BODY, W_STATUS = W_BODY, W_LENGTH, W_SETUP = 10 };

enum {
    SPEED_FULL = 2,
    DEVICE_ID = 1 << 16 | 1,
    ENDPOINT_OUT = 1,
    TRANSFER_MAX = 1 << 16, // libusb hands usbfs at most 16 KiB at a time
    FRAME_US = 1316,        // 1600 bytes of a full-speed bus, where 19 packets of 64 fit a millisecond
    BUSY_TRIES = 500,       // of 10 ms: a port is free a moment after it was told to be
};

struct vhci_urb {
    struct vhci_urb *next;
    uint32_t sequence, length;
    uint64_t due_ns;
    bool stalled;
    uint8_t data[];
};

struct vhci_board {
    struct kit_board kit; // its lock guards `configured_ns`, too
    unsigned port;
    int socket;           // of the thread; -1: not plugged
    pthread_t thread;
    uint64_t configured_ns, busy_until_ns;
    struct vhci_urb *flying, **last; // the thread's
};

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

// ---- the socket ---------------------------------------------------------------------------------------------------

static bool read_all(int fd, void *data, size_t length)
{
    for (size_t at = 0; at < length;) {
        const ssize_t n = read(fd, (uint8_t *)data + at, length - at);
        if (n == 0 || (n < 0 && errno != EINTR))
            return false;
        at += n > 0 ? (size_t)n : 0;
    }
    return true;
}

static bool write_all(int fd, const void *data, size_t length)
{
    for (size_t at = 0; at < length;) {
        const ssize_t n = send(fd, (const uint8_t *)data + at, length - at, MSG_NOSIGNAL);
        if (n < 0 && errno != EINTR)
            return false;
        at += n > 0 ? (size_t)n : 0;
    }
    return true;
}

// actual: bytes that were transferred; data: of an IN, so many bytes.
static bool reply(struct vhci_board *v, uint32_t command, uint32_t sequence, int status, uint32_t actual, const void *data)
{
    const uint32_t w[HEADER_WORDS] = { [W_COMMAND] = htonl(command), [W_SEQUENCE] = htonl(sequence),
                                       [W_STATUS] = htonl((uint32_t)status), [W_LENGTH] = htonl(actual) };
    return write_all(v->socket, w, sizeof w) && (!data || write_all(v->socket, data, actual));
}

// ---- requests -----------------------------------------------------------------------------------------------------

static int nibble(char c) { return c <= '9' ? c - '0' : c - 'a' + 10; }

// Device and configuration descriptor stand one after the other in the model's text.
static int descriptor(const struct kit_board *k, uint8_t type, uint8_t *out)
{
    char hex[512];
    uint8_t all[sizeof hex / 2];
    kit_descriptors(k, hex, sizeof hex);
    const size_t bytes = strlen(hex) / 2, first = 18;
    for (size_t i = 0; i < bytes; i++)
        all[i] = (uint8_t)(nibble(hex[2 * i]) << 4 | nibble(hex[2 * i + 1]));
    if (type != 1 && type != 2)
        return -EPIPE;
    const size_t n = type == 1 ? first : bytes - first;
    memcpy(out, type == 1 ? all : all + first, n);
    return (int)n;
}

// What the chapter of standard requests asks of a device; all else is the firmware's. With the lock.
static int control(struct vhci_board *v, const uint8_t s[8], const uint8_t *data, uint32_t length, uint8_t *out)
{
    struct kit_board *k = &v->kit;
    const uint32_t asked = s[6] | (uint32_t)s[7] << 8;
    int n;
    if (s[0] == 0x80 && s[1] == 6 && s[3] != 3)
        n = descriptor(k, s[3], out);
    else if ((s[0] & 0xE0) == 0x80 && s[1] == 0) { // GET_STATUS: powered by the bus, not halted
        memset(out, 0, 2);
        n = 2;
    } else if (s[0] == 0x02 && s[1] == 1 && s[4] == ENDPOINT_OUT) { // CLEAR_FEATURE(ENDPOINT_HALT)
        k->halted = false;
        k->clears++;
        n = 0;
    } else
        n = kit_control(k, s, data, length, out, KIT_REPLY_MAX);
    if (s[0] == 0 && s[1] == 9) // SET_CONFIGURATION
        v->configured_ns = now_ns();
    pthread_cond_broadcast(&k->change);
    return n > 0 && (uint32_t)n > asked ? (int)asked : n;
}

static bool serve_control(struct vhci_board *v, uint32_t sequence, bool in, const uint8_t *setup, const uint8_t *data,
                          uint32_t length)
{
    uint8_t out[KIT_REPLY_MAX];
    pthread_mutex_lock(&v->kit.lock);
    int n = control(v, setup, data, length, out);
    pthread_mutex_unlock(&v->kit.lock);
    if (n < 0)
        return reply(v, RET_SUBMIT, sequence, n, 0, NULL);
    if (!in)
        return reply(v, RET_SUBMIT, sequence, 0, length, NULL);
    n = (uint32_t)n > length ? (int)length : n;
    return reply(v, RET_SUBMIT, sequence, 0, (uint32_t)n, out);
}

// It completes when the bus has had the time for it; whether it stalls is decided now, as the endpoint would.
static bool start_bulk(struct vhci_board *v, uint32_t sequence, const uint8_t *data, uint32_t length)
{
    struct vhci_urb *u = malloc(sizeof *u + length);
    if (!u)
        return false;
    *u = (struct vhci_urb){ .sequence = sequence, .length = length };
    memcpy(u->data, data, length);
    pthread_mutex_lock(&v->kit.lock);
    if (v->kit.stall_next) {
        v->kit.stall_next--;
        v->kit.halted = true;
    }
    u->stalled = v->kit.halted;
    const uint64_t now = now_ns(), start = v->busy_until_ns > now ? v->busy_until_ns : now;
    u->due_ns = u->stalled ? now : start + v->kit.delay_us * (uint64_t)1000 * length / KIT_FRAME_BYTES;
    pthread_mutex_unlock(&v->kit.lock);
    if (!u->stalled)
        v->busy_until_ns = u->due_ns;
    *v->last = u;
    v->last = &u->next;
    return true;
}

static void take_out(struct vhci_board *v, struct vhci_urb **at)
{
    struct vhci_urb *u = *at;
    *at = u->next;
    if (v->last == &u->next)
        v->last = at;
    free(u);
}

static bool unlink_bulk(struct vhci_board *v, uint32_t sequence, uint32_t which)
{
    for (struct vhci_urb **at = &v->flying; *at; at = &(*at)->next)
        if ((*at)->sequence == which) {
            take_out(v, at);
            pthread_mutex_lock(&v->kit.lock);
            v->kit.cancels++;
            pthread_mutex_unlock(&v->kit.lock);
            return reply(v, RET_UNLINK, sequence, -ECONNRESET, 0, NULL);
        }
    return reply(v, RET_UNLINK, sequence, 0, 0, NULL); // it had completed before
}

static bool serve(struct vhci_board *v)
{
    uint32_t raw[HEADER_WORDS], w[HEADER_WORDS];
    if (!read_all(v->socket, raw, sizeof raw))
        return false;
    for (unsigned i = 0; i < HEADER_WORDS; i++)
        w[i] = ntohl(raw[i]);
    if (w[W_COMMAND] == UNLINK)
        return unlink_bulk(v, w[W_SEQUENCE], w[W_UNLINKED]);
    if (w[W_COMMAND] != SUBMIT || w[W_LENGTH] > TRANSFER_MAX) {
        fprintf(stderr, "usb_vhci: command %u with %u bytes, expected %d with at most %d\n", w[W_COMMAND], w[W_LENGTH], SUBMIT,
                TRANSFER_MAX);
        return false;
    }
    static _Thread_local uint8_t data[TRANSFER_MAX];
    const bool in = w[W_IN] != 0;
    if (!in && !read_all(v->socket, data, w[W_LENGTH]))
        return false;
    if (w[W_ENDPOINT] == 0)
        return serve_control(v, w[W_SEQUENCE], in, (const uint8_t *)&raw[W_SETUP], data, w[W_LENGTH]);
    if (w[W_ENDPOINT] != ENDPOINT_OUT || in)
        return reply(v, RET_SUBMIT, w[W_SEQUENCE], -EPIPE, 0, NULL);
    return start_bulk(v, w[W_SEQUENCE], data, w[W_LENGTH]);
}

// ---- the thread ---------------------------------------------------------------------------------------------------

static bool complete_due(struct vhci_board *v)
{
    bool fine = true;
    pthread_mutex_lock(&v->kit.lock);
    while (fine && v->flying && !v->kit.hold && v->flying->due_ns <= now_ns()) {
        struct vhci_urb *u = v->flying;
        if (!u->stalled)
            kit_bulk(&v->kit, u->data, u->length);
        fine = reply(v, RET_SUBMIT, u->sequence, u->stalled ? -EPIPE : 0, u->stalled ? 0 : u->length, NULL);
        take_out(v, &v->flying);
        pthread_cond_broadcast(&v->kit.change);
    }
    pthread_mutex_unlock(&v->kit.lock);
    return fine;
}

static void *run(void *arg)
{
    struct vhci_board *v = arg;
    for (bool fine = true; fine;) {
        // A hold that ends is seen within a millisecond.
        struct timespec wait = { .tv_nsec = 1000000 };
        const uint64_t now = now_ns();
        if (v->flying && v->flying->due_ns < now + 1000000)
            wait.tv_nsec = v->flying->due_ns > now ? (long)(v->flying->due_ns - now) : 0;
        pthread_mutex_lock(&v->kit.lock);
        if (v->kit.hold)
            wait.tv_nsec = 1000000;
        pthread_mutex_unlock(&v->kit.lock);
        struct pollfd p = { .fd = v->socket, .events = POLLIN };
        const int ready = ppoll(&p, 1, v->flying ? &wait : NULL, NULL);
        fine = (ready <= 0 || serve(v)) && complete_due(v);
    }
    while (v->flying)
        take_out(v, &v->flying);
    return NULL;
}

// ---- plug and unplug ------------------------------------------------------------------------------------------------

static int tell_hub(const char *file, const char *words)
{
    char path[64];
    snprintf(path, sizeof path, "/sys/devices/platform/vhci_hcd.0/%s", file);
    const int fd = open(path, O_WRONLY | O_CLOEXEC);
    if (fd < 0)
        return -errno;
    const ssize_t n = write(fd, words, strlen(words));
    const int error = n < 0 ? -errno : (size_t)n != strlen(words) ? -EIO : 0;
    close(fd);
    return error;
}

static int attach(unsigned port, int end)
{
    char words[64];
    snprintf(words, sizeof words, "%u %d %d %d", port, end, DEVICE_ID, SPEED_FULL);
    int r = tell_hub("attach", words);
    for (unsigned i = 0; r == -EBUSY && i < BUSY_TRIES; i++) {
        nanosleep(&(struct timespec){ .tv_nsec = 10000000 }, NULL);
        r = tell_hub("attach", words);
    }
    return r;
}

int vhci_plug(struct vhci_board *v)
{
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) < 0)
        return -errno;
    v->configured_ns = v->busy_until_ns = 0;
    v->kit.halted = false;
    int r = attach(v->port, ends[1]);
    close(ends[1]); // the kernel has its own reference
    if (r)
        goto fail;
    v->socket = ends[0];
    r = -pthread_create(&v->thread, NULL, run, v);
    if (r)
        goto fail;
    return 0;
fail:
    close(ends[0]);
    v->socket = -1;
    return r;
}

void vhci_unplug(struct vhci_board *v)
{
    if (v->socket < 0)
        return;
    char words[16];
    snprintf(words, sizeof words, "%u", v->port);
    if (tell_hub("detach", words)) // then as a cable that breaks
        shutdown(v->socket, SHUT_RDWR);
    pthread_join(v->thread, NULL);
    close(v->socket);
    v->socket = -1;
}

// ---- the board ------------------------------------------------------------------------------------------------------

struct vhci_board *vhci_create(const char *serial, unsigned port)
{
    struct vhci_board *v = calloc(1, sizeof *v);
    if (!v)
        return NULL;
    struct kit_board *k = &v->kit;
    snprintf(k->serial, sizeof k->serial, "%s", serial);
    k->vendor = 0x1d50;
    k->product = 0x607a;
    k->delay_us = FRAME_US;
    pthread_mutex_init(&k->lock, NULL);
    pthread_condattr_t a;
    pthread_condattr_init(&a);
    pthread_condattr_setclock(&a, CLOCK_MONOTONIC);
    pthread_cond_init(&k->change, &a);
    pthread_condattr_destroy(&a);
    v->port = port;
    v->socket = -1;
    v->last = &v->flying;
    return v;
}

void vhci_destroy(struct vhci_board *v)
{
    if (!v)
        return;
    vhci_unplug(v);
    pthread_cond_destroy(&v->kit.change);
    pthread_mutex_destroy(&v->kit.lock);
    free(v);
}

struct kit_board *vhci_kit(struct vhci_board *v) { return &v->kit; }

uint64_t vhci_configured_ns(struct vhci_board *v)
{
    pthread_mutex_lock(&v->kit.lock);
    const uint64_t at = v->configured_ns;
    pthread_mutex_unlock(&v->kit.lock);
    return at;
}

uint64_t vhci_frames(struct vhci_board *v)
{
    pthread_mutex_lock(&v->kit.lock);
    const uint64_t n = v->kit.frames;
    pthread_mutex_unlock(&v->kit.lock);
    return n;
}

bool vhci_wait_frames(struct vhci_board *v, uint64_t frames, unsigned ms)
{
    struct timespec end;
    clock_gettime(CLOCK_MONOTONIC, &end);
    end.tv_sec += ms / 1000;
    pthread_mutex_lock(&v->kit.lock);
    while (v->kit.frames < frames && pthread_cond_timedwait(&v->kit.change, &v->kit.lock, &end) == 0)
        ;
    const bool came = v->kit.frames >= frames;
    pthread_mutex_unlock(&v->kit.lock);
    return came;
}
