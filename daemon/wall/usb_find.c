// SPDX-License-Identifier: Apache-2.0
//
// usb_find.c - what is plugged in: a list of controllers of known kinds, each with its serial.
//
// Invariant: an entry is one plugging-in of one device, named by bus and address while it is there and by its arrival
// number for good. Hot-plug callbacks only add, remove and wake; serials are read by the finder thread, for that takes
// round trips. libusb hears of arrivals from udevd alone: where none runs, a second, short-lived context scans the bus
// once a second, and what only it has seen is opened by its node (libusb_wrap_sys_device), so that all transfers stay
// with the one context whose events are handled.
#include "usb_internal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const struct panel_ops *ops_of(const struct libusb_device_descriptor *d)
{
    for (unsigned k = 0; k < WALL_BOARD_KINDS; k++)
        for (unsigned i = 0; i < 4 && panel_kinds[k]->id[i].vendor; i++)
            if (panel_kinds[k]->id[i].vendor == d->idVendor && panel_kinds[k]->id[i].product == d->idProduct)
                return panel_kinds[k];
    return NULL;
}

static void name_path(char *out, size_t size, libusb_device *dev)
{
    uint8_t port[8];
    const int n = libusb_get_port_numbers(dev, port, sizeof(port));
    int at = snprintf(out, size, "%u", libusb_get_bus_number(dev));
    for (int i = 0; i < n && at > 0 && (size_t)at < size; i++)
        at += snprintf(out + at, size - (size_t)at, "%c%u", i ? '.' : '-', port[i]);
}

static struct usb_entry *entry_at(struct usb *u, uint8_t bus, uint8_t address)
{
    struct usb_entry *e = u->entry;
    while (e && (e->bus != bus || e->address != address))
        e = e->next;
    return e;
}

struct usb_entry *usb_entry_by_arrival(struct usb *u, uint64_t arrival)
{
    struct usb_entry *e = u->entry;
    while (e && e->arrival != arrival)
        e = e->next;
    return e;
}

static bool same_key(const struct usb_entry *e, const struct panel_ops *ops, const char *serial)
{
    return e->ops == ops && e->read && e->serial[0] && strcmp(e->serial, serial) == 0;
}

struct usb_entry *usb_entry_for(struct usb *u, const struct usb_board *b, uint64_t now_ns)
{
    for (struct usb_entry *e = u->entry; e; e = e->next)
        if (same_key(e, b->ops, b->config.serial) && !e->refused && !e->used && e->retry_ns <= now_ns)
            return e;
    return NULL;
}

void usb_nudge(struct usb *u)
{
    for (struct usb_board *b = u->board; b; b = b->next) {
        pthread_mutex_lock(&b->lock);
        b->nudge = true;
        pthread_cond_broadcast(&b->change);
        pthread_mutex_unlock(&b->lock);
    }
}

static void entry_free(struct usb_entry *e)
{
    if (e->device)
        libusb_unref_device(e->device);
    free(e);
}

static void leave(struct usb *u, uint8_t bus, uint8_t address);

// A port holds one device: who was there before is gone, whether or not anyone said so.
static void clear_port(struct usb *u, const char *path)
{
    for (struct usb_entry *e = u->entry, *next; e && strchr(path, '-'); e = next) {
        next = e->next;
        if (strcmp(e->path, path) == 0)
            leave(u, e->bus, e->address);
    }
}

// Under the lock. hot: the device is one of u->context, to be opened by it.
static void arrive(struct usb *u, libusb_device *dev, const struct panel_ops *ops, uint16_t release, bool hot)
{
    const uint8_t bus = libusb_get_bus_number(dev), address = libusb_get_device_address(dev);
    struct usb_entry *e = entry_at(u, bus, address), **end = &u->entry;
    if (e) {
        if (hot && !e->device) { // seen on the bus before it was announced, perhaps too early to be opened
            e->device = libusb_ref_device(dev);
            e->read = e->read && e->serial[0];
            pthread_cond_broadcast(&u->found);
        }
        return;
    }
    e = calloc(1, sizeof(*e));
    if (!e) {
        usb_log(u, "no memory to note a new %s", ops->name);
        return;
    }
    *e = (struct usb_entry){ .arrival = ++u->arrivals, .bus = bus, .address = address, .ops = ops, .release = release };
    e->device = hot ? libusb_ref_device(dev) : NULL;
    name_path(e->path, sizeof(e->path), dev);
    clear_port(u, e->path);
    while (*end)
        end = &(*end)->next;
    *end = e;
    pthread_cond_broadcast(&u->found);
}

// Under the lock.
static void leave(struct usb *u, uint8_t bus, uint8_t address)
{
    for (struct usb_board *b = u->board; b; b = b->next) {
        pthread_mutex_lock(&b->lock);
        if (b->handle && b->bus == bus && b->address == address)
            usb_flight_lost(b);
        pthread_mutex_unlock(&b->lock);
    }
    for (struct usb_entry **p = &u->entry; *p; p = &(*p)->next)
        if ((*p)->bus == bus && (*p)->address == address) {
            struct usb_entry *e = *p;
            *p = e->next;
            entry_free(e);
            break;
        }
    pthread_cond_broadcast(&u->found);
    usb_nudge(u);
}

static int LIBUSB_CALL on_hotplug(libusb_context *context, libusb_device *dev, libusb_hotplug_event event, void *arg)
{
    struct usb *u = arg;
    struct libusb_device_descriptor d;
    const struct panel_ops *ops;
    (void)context;
    if (libusb_get_device_descriptor(dev, &d) || !(ops = ops_of(&d)))
        return 0;
    pthread_mutex_lock(&u->lock);
    if (event == LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED)
        arrive(u, dev, ops, d.bcdDevice, true);
    else
        leave(u, libusb_get_bus_number(dev), libusb_get_device_address(dev));
    pthread_mutex_unlock(&u->lock);
    return 0;
}

// ---- the bus, where hot-plug tells nothing -----------------------------------------------------------------

static bool in_list(libusb_device **list, ssize_t n, const struct usb_entry *e)
{
    for (ssize_t i = 0; i < n; i++)
        if (libusb_get_bus_number(list[i]) == e->bus && libusb_get_device_address(list[i]) == e->address)
            return true;
    return false;
}

// Under the lock.
static void take_list(struct usb *u, libusb_device **list, ssize_t n)
{
    for (struct usb_entry *e = u->entry, *next; e; e = next) {
        next = e->next;
        if (!in_list(list, n, e))
            leave(u, e->bus, e->address);
    }
    for (ssize_t i = 0; i < n; i++) {
        struct libusb_device_descriptor d;
        const struct panel_ops *ops;
        if (libusb_get_device_descriptor(list[i], &d) == 0 && (ops = ops_of(&d)))
            arrive(u, list[i], ops, d.bcdDevice, false);
    }
}

static void look_at_bus(struct usb *u)
{
    libusb_context *scan;
    libusb_device **list;
    if (libusb_init(&scan))
        return;
    const ssize_t n = libusb_get_device_list(scan, &list);
    if (n >= 0) {
        pthread_mutex_lock(&u->lock);
        take_list(u, list, n);
        pthread_mutex_unlock(&u->lock);
        libusb_free_device_list(list, 1);
    }
    libusb_exit(scan);
}

// ---- opening ----------------------------------------------------------------------------------------------

struct usb_target usb_entry_target(const struct usb_entry *e)
{
    return (struct usb_target){ .device = e->device ? libusb_ref_device(e->device) : NULL, .bus = e->bus,
                                .address = e->address };
}

void usb_target_finish(struct usb_target *t)
{
    if (t->device)
        libusb_unref_device(t->device);
    t->device = NULL;
}

int usb_target_open(struct usb *u, const struct usb_target *t, libusb_device_handle **out, int *fd)
{
    *fd = -1;
    if (t->device)
        return libusb_open(t->device, out);
    char node[64];
    snprintf(node, sizeof(node), "/dev/bus/usb/%03u/%03u", t->bus, t->address);
    *fd = open(node, O_RDWR | O_CLOEXEC);
    if (*fd < 0)
        return errno == EACCES || errno == EPERM ? LIBUSB_ERROR_ACCESS : LIBUSB_ERROR_NO_DEVICE;
    const int r = libusb_wrap_sys_device(u->context, *fd, out);
    if (r) {
        close(*fd);
        *fd = -1;
    }
    return r;
}

// Fills serial, or why. Blocks for at most two transfers of a second.
static int read_serial(struct usb *u, const struct usb_target *t, char *serial, char *why, size_t why_size)
{
    struct libusb_device_descriptor d;
    libusb_device_handle *h;
    unsigned char text[256];
    int fd;
    const int opened = usb_target_open(u, t, &h, &fd);
    if (opened) {
        snprintf(why, why_size, "cannot be opened: %s", libusb_strerror(opened));
        return opened;
    }
    int n = libusb_get_device_descriptor(libusb_get_device(h), &d);
    if (n == 0 && !d.iSerialNumber)
        snprintf(why, why_size, "has no serial number");
    else if (n == 0 && (n = libusb_get_string_descriptor_ascii(h, d.iSerialNumber, text, sizeof(text))) > 0) {
        if (n >= WALL_NAME_MAX) {
            snprintf(why, why_size, "a serial number of %d letters, expected at most %d", n, WALL_NAME_MAX - 1);
        } else {
            for (int i = 0; i < n; i++)
                serial[i] = text[i] < 0x20 || text[i] > 0x7e ? '?' : (char)text[i];
            serial[n] = '\0';
        }
    }
    if (!serial[0] && !why[0])
        snprintf(why, why_size, "its serial number cannot be read: %s", n < 0 ? libusb_strerror(n) : "empty");
    libusb_close(h);
    if (fd >= 0)
        close(fd);
    return 0;
}

// Under the lock; lets go of it while the device is asked.
static void read_entry(struct usb *u, uint64_t arrival)
{
    struct usb_entry *e = usb_entry_by_arrival(u, arrival);
    struct usb_target t = usb_entry_target(e);
    char serial[WALL_NAME_MAX] = "", why[sizeof(e->why)] = "";
    pthread_mutex_unlock(&u->lock);
    const int r = read_serial(u, &t, serial, why, sizeof(why));
    usb_target_finish(&t);
    pthread_mutex_lock(&u->lock);
    e = usb_entry_by_arrival(u, arrival);
    if (!e)
        return;
    const bool news = !e->read || strcmp(e->why, why) != 0;
    e->read = true;
    e->unopened = r != 0;
    e->retry_ns = e->unopened ? usb_now_ns() + USB_RESCAN_MS * 1000000ull : 0;
    memcpy(e->serial, serial, sizeof(serial));
    memcpy(e->why, why, sizeof(why));
    if (news && why[0])
        usb_log(u, "%s at %s: %s", e->ops->name, e->path, why);
    for (struct usb_entry *o = u->entry; o && serial[0]; o = o->next)
        if (o != e && same_key(o, e->ops, serial))
            usb_log(u, "%s %s is there twice, at %s and at %s: the first is used", e->ops->name, serial, o->path, e->path);
    pthread_cond_broadcast(&u->found);
    usb_nudge(u);
}

static uint64_t next_unread(struct usb *u, uint64_t now_ns)
{
    for (struct usb_entry *e = u->entry; e; e = e->next)
        if (!e->read || (e->unopened && e->retry_ns <= now_ns))
            return e->arrival;
    return 0;
}

static void *finder_main(void *arg)
{
    struct usb *u = arg;
    uint64_t rescan_ns = usb_now_ns();
    pthread_mutex_lock(&u->lock);
    while (!u->stop) {
        const uint64_t now = usb_now_ns(), arrival = next_unread(u, now);
        if (arrival) {
            read_entry(u, arrival);
        } else if (now >= rescan_ns) {
            rescan_ns = now + USB_RESCAN_MS * 1000000ull;
            if (u->no_udev) {
                pthread_mutex_unlock(&u->lock);
                look_at_bus(u);
                pthread_mutex_lock(&u->lock);
            }
        } else {
            usb_cond_wait_until(&u->found, &u->lock, rescan_ns);
        }
    }
    pthread_mutex_unlock(&u->lock);
    return NULL;
}

int usb_find_start(struct usb *u, struct fault *f)
{
    // The socket is there for as long as udevd runs.
    u->no_udev = !libusb_has_capability(LIBUSB_CAP_HAS_HOTPLUG) || access("/run/udev/control", F_OK) != 0;
    if (libusb_has_capability(LIBUSB_CAP_HAS_HOTPLUG)) {
        const int r = libusb_hotplug_register_callback(
            u->context, LIBUSB_HOTPLUG_EVENT_DEVICE_ARRIVED | LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT, LIBUSB_HOTPLUG_ENUMERATE,
            LIBUSB_HOTPLUG_MATCH_ANY, LIBUSB_HOTPLUG_MATCH_ANY, LIBUSB_HOTPLUG_MATCH_ANY, on_hotplug, u, &u->hotplug);
        if (r)
            return fault_set(f, FAULT_INTERNAL, "usb", "hot-plug of libusb: %s", libusb_strerror(r));
        u->has_hotplug = true;
    }
    if (u->no_udev)
        look_at_bus(u);
    if (pthread_create(&u->finder, NULL, finder_main, u))
        return fault_set(f, FAULT_NO_MEMORY, "usb", "no thread to find boards");
    u->finder_run = true;
    return 0;
}

void usb_find_stop(struct usb *u)
{
    if (u->has_hotplug)
        libusb_hotplug_deregister_callback(u->context, u->hotplug);
    u->has_hotplug = false;
    if (!u->finder_run)
        return;
    pthread_mutex_lock(&u->lock);
    u->stop = true;
    pthread_cond_broadcast(&u->found);
    pthread_mutex_unlock(&u->lock);
    pthread_join(u->finder, NULL);
    u->finder_run = false;
}

void usb_find_free(struct usb *u)
{
    while (u->entry) {
        struct usb_entry *e = u->entry;
        u->entry = e->next;
        entry_free(e);
    }
}

// ---- what operators see -------------------------------------------------------------------------------------

static void describe(const struct usb *u, const struct usb_entry *e, struct usb_found *out)
{
    *out = (struct usb_found){ .kind = e->ops->kind, .release = e->release, .in_use = e->used };
    memcpy(out->serial, e->serial, sizeof(out->serial));
    memcpy(out->path, e->path, sizeof(out->path));
    out->reading = !e->read;
    snprintf(out->why, sizeof(out->why), "%s", e->why);
    for (const struct usb_entry *o = u->entry; o; o = o->next)
        if (o != e && e->serial[0] && same_key(o, e->ops, e->serial))
            out->twice = true;
}

static int by_path(const void *a, const void *b)
{
    return strverscmp(((const struct usb_found *)a)->path, ((const struct usb_found *)b)->path);
}

unsigned usb_list(struct usb *u, struct usb_found *out, unsigned max, unsigned wait_ms)
{
    const uint64_t end = usb_now_ns() + wait_ms * 1000000ull;
    unsigned n = 0;
    pthread_mutex_lock(&u->lock);
    for (struct usb_entry *e = u->entry; e;)
        if (!e->read && usb_now_ns() < end) {
            usb_cond_wait_until(&u->found, &u->lock, end);
            e = u->entry;
        } else {
            e = e->next;
        }
    for (struct usb_entry *e = u->entry; e && n < max; e = e->next)
        describe(u, e, &out[n++]);
    pthread_mutex_unlock(&u->lock);
    qsort(out, n, sizeof(*out), by_path);
    return n;
}
