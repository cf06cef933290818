// SPDX-License-Identifier: Apache-2.0
//
// usb_kit.c - see usb_kit.h: the usbfs half. Each board has a node, an ioctl handler and a queue of URBs; one thread
// completes URBs when they are due, the library's one worker thread serves the ioctls and must never block.
//
// A usbfs node is writable when a URB can be reaped, and libusb waits for that. A plain file always is, so the node is a
// FIFO: full while nothing has completed, drained when something has. Where a plain file has to do (kit_plug_unheard),
// poll() here rests before it says so.
#include <umockdev.h>

#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "usb_kit_model.h"

enum { BOARDS_MAX = 192, ADDRESSES = 100, CONTROL_US = 200, BULK_US = 1500 };

struct kit_urb {
    struct kit_urb *next;
    UMockdevIoctlData *data;      // of the client's struct usbdevfs_urb
    UMockdevIoctlClient *client;  // only compared
    uint64_t due_ns;
    int status;
    unsigned actual, length;
    bool bulk;
    uint8_t *bytes; // bulk: a copy
};

struct usb_kit {
    UMockdevTestbed *bed;
    char *root;
    pthread_t completer;
    pthread_mutex_t lock;
    pthread_cond_t wake;
    bool stop, dirty;
    struct kit_board *board[BOARDS_MAX];
    _Atomic unsigned boards;
    unsigned addresses;
};

// In the C library's place, for libusb, too. Without the rest its event thread would never leave the emulation's lock for long
// enough that another gets it.
__attribute__((visibility("default"))) int poll(struct pollfd *fds, nfds_t count, int timeout)
{
    const int r = (int)syscall(SYS_poll, fds, count, timeout);
    struct stat s;
    for (nfds_t i = 0; r > 0 && i < count; i++)
        if (fds[i].revents & POLLOUT && fstat(fds[i].fd, &s) == 0 && S_ISREG(s.st_mode)) {
            usleep(500);
            break;
        }
    return r;
}

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void cond_init(pthread_cond_t *c)
{
    pthread_condattr_t a;
    pthread_condattr_init(&a);
    pthread_condattr_setclock(&a, CLOCK_MONOTONIC);
    pthread_cond_init(c, &a);
    pthread_condattr_destroy(&a);
}

static int wait_until(pthread_cond_t *c, pthread_mutex_t *m, uint64_t ns)
{
    const struct timespec t = { .tv_sec = (time_t)(ns / 1000000000u), .tv_nsec = (long)(ns % 1000000000u) };
    return pthread_cond_timedwait(c, m, &t);
}

static size_t from_hex(const char *hex, uint8_t *out)
{
    size_t n = 0;
    for (unsigned byte; sscanf(hex + 2 * n, "%2x", &byte) == 1; n++)
        out[n] = (uint8_t)byte;
    return n;
}

// ---- URBs -------------------------------------------------------------------------------------------------------

static void set_ready(struct kit_board *b, bool ready)
{
    uint8_t bytes[4096] = { 0 };
    if (b->fifo < 0)
        return;
    if (ready)
        while (read(b->fifo, bytes, sizeof(bytes)) > 0)
            continue;
    else
        while (write(b->fifo, bytes, sizeof(bytes)) > 0)
            continue;
}

static void append(struct kit_urb **list, struct kit_urb *u)
{
    while (*list)
        list = &(*list)->next;
    u->next = NULL;
    *list = u;
}

static void urb_free(struct kit_urb *u)
{
    g_object_unref(u->data);
    free(u->bytes);
    free(u);
}

static void finish(struct kit_board *b, struct kit_urb **at, int status)
{
    struct kit_urb *u = *at;
    *at = u->next;
    u->status = status;
    if (u->bulk && status == 0)
        kit_bulk(b, u->bytes, u->length);
    if (status)
        u->actual = 0;
    append(&b->done, u);
    set_ready(b, true);
    pthread_cond_broadcast(&b->change);
}

// With the board's lock. When the next is due, or never.
static uint64_t complete_due(struct kit_board *b, uint64_t now)
{
    uint64_t next = UINT64_MAX;
    for (struct kit_urb **p = &b->flying; *p;) {
        struct kit_urb *u = *p;
        if (u->bulk ? b->hold : b->mute)
            p = &u->next;
        else if (u->due_ns > now) {
            next = u->due_ns < next ? u->due_ns : next;
            p = &u->next;
        } else {
            finish(b, p, u->status);
        }
    }
    return next;
}

static void wake(struct usb_kit *k)
{
    pthread_mutex_lock(&k->lock);
    k->dirty = true;
    pthread_cond_signal(&k->wake);
    pthread_mutex_unlock(&k->lock);
}

static void *completer_main(void *arg)
{
    struct usb_kit *k = arg;
    pthread_mutex_lock(&k->lock);
    while (!k->stop) {
        k->dirty = false;
        pthread_mutex_unlock(&k->lock);
        // Faults are lifted without a signal: look again soon.
        uint64_t next = now_ns() + 5000000;
        for (unsigned i = 0; i < atomic_load(&k->boards); i++) {
            struct kit_board *b = k->board[i];
            pthread_mutex_lock(&b->lock);
            const uint64_t due = complete_due(b, now_ns());
            pthread_mutex_unlock(&b->lock);
            next = due < next ? due : next;
        }
        pthread_mutex_lock(&k->lock);
        if (!k->dirty && !k->stop)
            wait_until(&k->wake, &k->lock, next);
    }
    pthread_mutex_unlock(&k->lock);
    return NULL;
}

static void begin_control(struct kit_board *b, struct kit_urb *u, uint8_t *data)
{
    const size_t body = u->length - 8;
    const int n = kit_control(b, data, data + 8, body, data + 8, body);
    u->status = n < 0 ? n : 0;
    u->actual = n < 0 ? 0 : (unsigned)n;
    u->due_ns = now_ns() + CONTROL_US * 1000ull;
}

static void begin_bulk(struct kit_board *b, struct kit_urb *u, const uint8_t *data)
{
    const uint64_t now = now_ns(), start = b->busy_until_ns > now ? b->busy_until_ns : now;
    u->bulk = true;
    u->actual = u->length;
    u->due_ns = b->busy_until_ns = start + b->delay_us * 1000ull;
    u->bytes = malloc(u->length ? u->length : 1);
    memcpy(u->bytes, data, u->length);
    if (b->stall_next > 0 || b->halted) {
        b->stall_next -= b->stall_next > 0;
        b->halted = true;
        u->status = -EPIPE;
    }
}

static int submit(struct kit_board *b, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    if (b->enomem_next > 0) {
        b->enomem_next--;
        return ENOMEM;
    }
    UMockdevIoctlData *data = umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_urb), NULL);
    if (!data)
        return EFAULT;
    struct usbdevfs_urb *urb = (void *)data->data;
    const unsigned length = (unsigned)urb->buffer_length;
    UMockdevIoctlData *buffer =
        umockdev_ioctl_data_resolve(data, G_STRUCT_OFFSET(struct usbdevfs_urb, buffer), length, NULL);
    const bool control = urb->type == USBDEVFS_URB_TYPE_CONTROL;
    const bool bulk = urb->type == USBDEVFS_URB_TYPE_BULK && urb->endpoint == 1;
    if (!buffer || (!control && !bulk) || (control && length < 8)) {
        g_clear_object(&buffer);
        g_object_unref(data);
        return EINVAL;
    }
    struct kit_urb *u = calloc(1, sizeof(*u));
    *u = (struct kit_urb){ .data = data, .client = client, .length = length };
    if (control)
        begin_control(b, u, buffer->data);
    else
        begin_bulk(b, u, buffer->data);
    g_object_unref(buffer);
    append(&b->flying, u);
    return 0;
}

static int reap(struct kit_board *b, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    struct kit_urb **p = &b->done;
    while (*p && (*p)->client != client)
        p = &(*p)->next;
    struct kit_urb *u = *p;
    if (!u) {
        set_ready(b, b->done);
        return b->gone ? ENODEV : EAGAIN;
    }
    *p = u->next;
    struct usbdevfs_urb *urb = (void *)u->data->data;
    urb->status = u->status;
    urb->actual_length = (int)u->actual;
    UMockdevIoctlData *to = umockdev_ioctl_data_resolve(arg, 0, sizeof(void *), NULL);
    umockdev_ioctl_data_set_ptr(to, 0, u->data);
    g_object_unref(to);
    urb_free(u);
    set_ready(b, b->done);
    return 0;
}

static int discard(struct kit_board *b, UMockdevIoctlClient *client, UMockdevIoctlData *arg)
{
    gulong address;
    memcpy(&address, arg->data, sizeof(address));
    for (struct kit_urb **p = &b->flying; *p; p = &(*p)->next)
        if ((*p)->client == client && (*p)->data->client_addr == address) {
            b->cancels++;
            finish(b, p, -ENOENT);
            return 0;
        }
    return EINVAL;
}

// 0 or an errno; with the board's lock.
static int serve(struct kit_board *b, UMockdevIoctlClient *client, unsigned long request, UMockdevIoctlData *arg)
{
    if (strcmp(umockdev_ioctl_client_get_devnode(client), b->node) != 0) // of an earlier plugging-in
        return ENODEV;
    if (b->gone && request != USBDEVFS_REAPURBNDELAY && request != USBDEVFS_REAPURB && request != USBDEVFS_DISCARDURB)
        return ENODEV;
    switch (request) {
    case USBDEVFS_GET_CAPABILITIES: {
        UMockdevIoctlData *caps = umockdev_ioctl_data_resolve(arg, 0, 4, NULL);
        const guint32 all = USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_NO_PACKET_SIZE_LIM |
                            USBDEVFS_CAP_REAP_AFTER_DISCONNECT | USBDEVFS_CAP_ZERO_PACKET | USBDEVFS_CAP_BULK_CONTINUATION;
        memcpy(caps->data, &all, sizeof(all));
        g_object_unref(caps);
        return 0;
    }
    case USBDEVFS_CLAIMINTERFACE:
    case USBDEVFS_DISCONNECT_CLAIM:
        b->claims++;
        return 0;
    case USBDEVFS_RELEASEINTERFACE:
        b->releases++;
        return 0;
    case USBDEVFS_CLEAR_HALT:
        b->clears++;
        b->halted = false;
        return 0;
    case USBDEVFS_RESET:
    case USBDEVFS_SETCONFIGURATION:
    case USBDEVFS_SETINTERFACE:
        return 0;
    case USBDEVFS_CONNECTINFO: {
        UMockdevIoctlData *info = umockdev_ioctl_data_resolve(arg, 0, sizeof(struct usbdevfs_connectinfo), NULL);
        *(struct usbdevfs_connectinfo *)(void *)info->data = (struct usbdevfs_connectinfo){ .devnum = b->address };
        g_object_unref(info);
        return 0;
    }
    case USBDEVFS_IOCTL: // no kernel driver to detach or to attach again
    case USBDEVFS_GETDRIVER:
        return ENODATA;
    case USBDEVFS_SUBMITURB:
        return submit(b, client, arg);
    case USBDEVFS_REAPURB:
    case USBDEVFS_REAPURBNDELAY:
        return reap(b, client, arg);
    case USBDEVFS_DISCARDURB:
        return discard(b, client, arg);
    default:
        return ENOTTY;
    }
}

static gboolean on_ioctl(UMockdevIoctlBase *handler, UMockdevIoctlClient *client, struct kit_board *b)
{
    (void)handler;
    pthread_mutex_lock(&b->lock);
    const unsigned long request = umockdev_ioctl_client_get_request(client);
    const int error = serve(b, client, request, umockdev_ioctl_client_get_arg(client));
    pthread_cond_broadcast(&b->change);
    pthread_mutex_unlock(&b->lock);
    umockdev_ioctl_client_complete(client, error ? -1 : 0, error);
    if (request == USBDEVFS_SUBMITURB)
        wake(b->kit);
    return TRUE;
}

static void see(struct kit_board *b)
{
    pthread_mutex_lock(&b->lock);
    pthread_mutex_unlock(&b->lock);
}

void kit_see_all(struct usb_kit *k)
{
    for (unsigned i = 0; i < k->boards; i++)
        see(k->board[i]);
}

unsigned kit_open_fds(struct kit_board *b)
{
    unsigned n = 0;
    char path[64], to[1024];
    see(b);
    for (unsigned fd = 0; fd < 1024; fd++) {
        snprintf(path, sizeof(path), "/proc/self/fd/%u", fd);
        const ssize_t length = readlink(path, to, sizeof(to) - 1);
        to[length > 0 ? length : 0] = '\0';
        n += strstr(to, b->node) != NULL;
    }
    return n - (b->fifo >= 0);
}

// ---- plugging -----------------------------------------------------------------------------------------------------

static int make_fifo(const char *path)
{
    const int fifo = mkfifo(path, 0666) ? -1 : open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC);
    if (fifo < 0)
        abort();
    fcntl(fifo, F_SETPIPE_SZ, 4096);
    return fifo;
}

// Who opens a node by its name reads the descriptors from it, from the start: that takes a file, at the price that libusb
// polls without a pause.
static int make_file(const struct kit_board *b, const char *path)
{
    char hex[256];
    uint8_t bytes[128];
    kit_descriptors(b, hex, sizeof(hex));
    if (!g_file_set_contents(path, (const char *)bytes, (gssize)from_hex(hex, bytes), NULL))
        abort();
    return -1;
}

static void close_fifo(struct kit_board *b)
{
    if (b->fifo >= 0)
        close(b->fifo);
    b->fifo = -1;
}

static void make_node(struct kit_board *b, bool heard)
{
    char path[1024];
    snprintf(path, sizeof(path), "%s/dev/bus/usb/%03u", b->kit->root, b->bus);
    g_mkdir_with_parents(path, 0755);
    snprintf(path, sizeof(path), "%s%s", b->kit->root, b->node);
    const int fifo = heard ? make_fifo(path) : make_file(b, path);
    pthread_mutex_lock(&b->lock);
    close_fifo(b);
    b->fifo = fifo;
    b->gone = b->halted = false;
    while (b->done) { // of who held the earlier node
        struct kit_urb *u = b->done;
        b->done = u->next;
        urb_free(u);
    }
    b->busy_until_ns = 0;
    b->committed = b->lit = b->named = false;
    set_ready(b, false);
    pthread_mutex_unlock(&b->lock);
}

static void new_address(struct kit_board *b)
{
    const unsigned n = b->kit->addresses++;
    b->bus = 1;
    b->address = 1 + n;
    if (b->address > 255)
        abort(); // a libusb device's address is a byte
    pthread_mutex_lock(&b->lock);
    snprintf(b->node, sizeof(b->node), "/dev/bus/usb/%03u/%03u", b->bus, b->address);
    pthread_mutex_unlock(&b->lock);
    snprintf(b->syspath, sizeof(b->syspath), "/sys/devices/usb1/1-%u", b->port);
}

static void prepare(struct kit_board *b, bool heard)
{
    GError *error = NULL;
    new_address(b);
    if (!umockdev_testbed_attach_ioctl(b->kit->bed, b->node, b->handler, &error)) {
        fprintf(stderr, "usb_kit: %s: %s\n", b->node, error->message);
        abort();
    }
    make_node(b, heard);
}

static void plug(struct kit_board *b)
{
    GError *error = NULL;
    char text[1024], hex[256];
    prepare(b, true);
    kit_descriptors(b, hex, sizeof(hex));
    snprintf(text, sizeof(text),
             "P: /devices/usb1/1-%u\nE: SUBSYSTEM=usb\nE: DRIVER=usb\nE: BUSNUM=%03u\nE: DEVNUM=%03u\nE: DEVNAME=%s\n"
             "E: DEVTYPE=usb_device\nA: bConfigurationValue=1\\n\nA: busnum=%u\\n\nA: devnum=%u\\n\nA: speed=%s\\n\n"
             "H: descriptors=%s\n",
             b->port, b->bus, b->address, b->node, b->bus, b->address, b->gud ? "480" : "12", hex);
    if (!umockdev_testbed_add_from_string(b->kit->bed, text, &error)) {
        fprintf(stderr, "usb_kit: %s: %s\n", b->node, error->message);
        abort();
    }
    b->plugged = true;
}

void kit_plug(struct kit_board *b)
{
    if (!b->plugged)
        plug(b);
}

static void write_file(const char *dir, const char *name, const void *data, size_t length)
{
    char path[1024];
    snprintf(path, sizeof(path), "%s/%s", dir, name);
    if (!g_file_set_contents(path, data, (gssize)length, NULL))
        abort();
}

// The same files that the test bed would make, without its message to those who listen.
void kit_plug_unheard(struct kit_board *b)
{
    char dir[512], path[1024], to[64], hex[256], text[128];
    uint8_t bytes[128];
    if (b->plugged)
        return;
    prepare(b, false);
    snprintf(dir, sizeof(dir), "%s%s", b->kit->root, b->syspath);
    g_mkdir_with_parents(dir, 0755);
    kit_descriptors(b, hex, sizeof(hex));
    write_file(dir, "descriptors", bytes, from_hex(hex, bytes));
    snprintf(text, sizeof(text), "%u\n", b->bus);
    write_file(dir, "busnum", text, strlen(text));
    snprintf(text, sizeof(text), "%u\n", b->address);
    write_file(dir, "devnum", text, strlen(text));
    snprintf(text, sizeof(text), "%s\n", b->gud ? "480" : "12");
    write_file(dir, "speed", text, strlen(text));
    write_file(dir, "bConfigurationValue", "1\n", 2);
    snprintf(text, sizeof(text), "DEVTYPE=usb_device\nBUSNUM=%03u\nDEVNUM=%03u\nDEVNAME=%s\n", b->bus, b->address,
             b->node + strlen("/dev/"));
    write_file(dir, "uevent", text, strlen(text));
    snprintf(path, sizeof(path), "%s/sys/bus/usb/devices", b->kit->root);
    g_mkdir_with_parents(path, 0755);
    snprintf(path, sizeof(path), "%s/subsystem", dir);
    if (symlink("../../../bus/usb", path))
        abort();
    snprintf(path, sizeof(path), "%s/sys/bus/usb/devices/1-%u", b->kit->root, b->port);
    snprintf(to, sizeof(to), "../../../devices/usb1/1-%u", b->port);
    if (symlink(to, path))
        abort();
    b->plugged = b->unheard = true;
}

static void remove_unheard(struct kit_board *b)
{
    char path[1024], away[1100];
    snprintf(path, sizeof(path), "%s/sys/bus/usb/devices/1-%u", b->kit->root, b->port);
    unlink(path);
    snprintf(path, sizeof(path), "%s%s", b->kit->root, b->syspath);
    snprintf(away, sizeof(away), "%s.gone%u", path, b->address);
    if (rename(path, away))
        abort();
    b->unheard = false;
}

void kit_vanish(struct kit_board *b)
{
    pthread_mutex_lock(&b->lock);
    b->gone = true;
    while (b->flying)
        finish(b, &b->flying, -ESHUTDOWN);
    pthread_mutex_unlock(&b->lock);
}

void kit_unplug(struct kit_board *b)
{
    if (!b->plugged)
        return;
    kit_vanish(b);
    if (b->unheard) {
        remove_unheard(b);
    } else {
        umockdev_testbed_uevent(b->kit->bed, b->syspath, "remove");
        usleep(20000); // whoever hears of it may still look at the device's attributes
        umockdev_testbed_remove_device(b->kit->bed, b->syspath);
    }
    // The node's handler and our end of it stay until the next plugging-in: whoever has it open still gets ENODEV, not a broken
    // line, and is not told for ever that something waits there. (libusb would ask again and again, and whoever wants to
    // close the board would wait for the emulation's lock.)
    b->plugged = false;
}

void kit_unplug_all(struct usb_kit *k)
{
    for (unsigned i = 0; i < k->boards; i++)
        kit_unplug(k->board[i]);
}

// ---- boards and kit -----------------------------------------------------------------------------------------------

static struct kit_board *board_new(struct usb_kit *k, const char *serial)
{
    struct kit_board *b = calloc(1, sizeof(*b));
    const unsigned n = atomic_load(&k->boards);
    if (!b || n >= BOARDS_MAX)
        abort();
    b->kit = k;
    b->fifo = -1;
    b->port = n + 1;
    b->delay_us = BULK_US;
    pthread_mutex_init(&b->lock, NULL);
    cond_init(&b->change);
    snprintf(b->serial, sizeof(b->serial), "%s", serial);
    UMockdevIoctlBase *handler = umockdev_ioctl_base_new();
    g_object_connect(handler, "signal-after::handle-ioctl", on_ioctl, b, NULL);
    b->handler = handler;
    k->board[n] = b;
    atomic_store(&k->boards, n + 1);
    return b;
}

struct kit_board *kit_fadecandy(struct usb_kit *k, const char *serial)
{
    struct kit_board *b = board_new(k, serial);
    b->vendor = 0x1d50;
    b->product = 0x607a;
    return b;
}

struct kit_board *kit_gud(struct usb_kit *k, const char *serial, uint32_t width, uint32_t height)
{
    struct kit_board *b = board_new(k, serial);
    b->gud = true;
    b->vendor = 0x1d50;
    b->product = 0x614d;
    b->width = width;
    b->height = height;
    b->pixel_bytes = 3;
    b->reply = calloc(KIT_REQUESTS, sizeof(*b->reply));
    b->picture = calloc((size_t)width * height, 4);
    if (!b->reply || !b->picture)
        abort();
    kit_gud_defaults(b);
    return b;
}

struct usb_kit *kit_create(void)
{
    const char *preload = getenv("LD_PRELOAD");
    if (!preload || !strstr(preload, "umockdev-preload"))
        return NULL;
    struct usb_kit *k = calloc(1, sizeof(*k));
    if (!k)
        return NULL;
    k->bed = umockdev_testbed_new();
    k->root = umockdev_testbed_get_root_dir(k->bed);
    pthread_mutex_init(&k->lock, NULL);
    cond_init(&k->wake);
    if (pthread_create(&k->completer, NULL, completer_main, k))
        abort();
    return k;
}

void kit_destroy(struct usb_kit *k)
{
    if (!k)
        return;
    kit_unplug_all(k);
    pthread_mutex_lock(&k->lock);
    k->stop = true;
    pthread_cond_signal(&k->wake);
    pthread_mutex_unlock(&k->lock);
    pthread_join(k->completer, NULL);
    for (unsigned i = 0; i < k->boards; i++)
        g_object_unref(k->board[i]->handler);
    g_object_unref(k->bed); // ends the thread that serves the ioctls
    for (unsigned i = 0; i < k->boards; i++) {
        struct kit_board *b = k->board[i];
        while (b->done) {
            struct kit_urb *u = b->done;
            b->done = u->next;
            urb_free(u);
        }
        close_fifo(b);
        free(b->reply);
        free(b->picture);
        pthread_cond_destroy(&b->change);
        pthread_mutex_destroy(&b->lock);
        free(b);
    }
    g_free(k->root);
    pthread_cond_destroy(&k->wake);
    pthread_mutex_destroy(&k->lock);
    free(k);
}

bool kit_wait(struct kit_board *b, bool (*is)(const struct kit_board *b, uint64_t n), uint64_t n, unsigned ms)
{
    const uint64_t end = now_ns() + ms * 1000000ull;
    pthread_mutex_lock(&b->lock);
    bool done;
    while (!(done = is(b, n)) && now_ns() < end)
        wait_until(&b->change, &b->lock, end);
    pthread_mutex_unlock(&b->lock);
    return done;
}

static bool has_frames(const struct kit_board *b, uint64_t n) { return b->frames >= n; }

bool kit_wait_frames(struct kit_board *b, uint64_t frames, unsigned ms) { return kit_wait(b, has_frames, frames, ms); }

uint64_t kit_count(struct kit_board *b, const uint64_t *of)
{
    pthread_mutex_lock(&b->lock);
    const uint64_t n = *of;
    pthread_mutex_unlock(&b->lock);
    return n;
}

uint64_t kit_frames(struct kit_board *b) { return kit_count(b, &b->frames); }
