// SPDX-License-Identifier: Apache-2.0
//
// usb_board.c - the thread that keeps one board: looks for it, opens it, clears its halts, closes it when it is lost.
//
// Invariant: this thread alone opens and closes the board's handle, and it closes only when nothing of the board is with
// libusb. One thread a board, for each of these steps may take as long as the device likes to keep us waiting.
#include "usb_internal.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { RETRY_NS = 1000000000 };
static const char lost_words[] = "lost: it does not answer any more, or was unplugged";

// Logged when it is news; a board that is tried once a second is not reported once a second.
static void say_why(struct usb_board *b, enum usb_state state, const char *what)
{
    char why[sizeof(b->stats.why)];
    snprintf(why, sizeof(why), "%s", what);
    pthread_mutex_lock(&b->lock);
    const bool news = b->stats.state != state || strcmp(b->stats.why, why) != 0;
    b->stats.state = state;
    memcpy(b->stats.why, why, sizeof(why));
    pthread_mutex_unlock(&b->lock);
    if (news && why[0])
        usb_log(b->usb, "%s %s: %s", b->ops->name, b->config.serial, why);
}

// How an attempt ended, told to the entry.
static void note_attempt(struct usb_board *b, uint64_t arrival, bool used, bool refused)
{
    struct usb *u = b->usb;
    pthread_mutex_lock(&u->lock);
    struct usb_entry *e = usb_entry_by_arrival(u, arrival);
    if (e) {
        e->used = used;
        e->refused = refused;
        e->retry_ns = used ? 0 : usb_now_ns() + RETRY_NS;
    }
    pthread_mutex_unlock(&u->lock);
}

// ---- opening ------------------------------------------------------------------------------------------------

static int claim(struct usb_board *b, libusb_device_handle *h, struct fault *f)
{
    struct libusb_config_descriptor *c;
    libusb_set_auto_detach_kernel_driver(h, 1);
    int r = libusb_get_active_config_descriptor(libusb_get_device(h), &c);
    if (r)
        return fault_set(f, FAULT_INTERNAL, "configuration", "its configuration cannot be read: %s", libusb_strerror(r));
    r = b->ops->probe(c, &b->interface, &b->endpoint, f);
    libusb_free_config_descriptor(c);
    if (r)
        return -1;
    r = libusb_claim_interface(h, b->interface);
    if (r == LIBUSB_ERROR_BUSY)
        return fault_set(f, FAULT_BUSY, "interface", "another program uses it");
    return r ? fault_set(f, FAULT_INTERNAL, "interface", "interface %u cannot be claimed: %s", b->interface, libusb_strerror(r))
             : 0;
}

// Under no lock: before it succeeds, nobody else looks at these fields.
static int open_panel(struct usb_board *b, libusb_device_handle *h, struct fault *f)
{
    struct panel_need need;
    if (claim(b, h, f))
        return -1;
    if (b->ops->open(&b->panel, h, b->interface, b->endpoint, &b->config, &need, f)) {
        libusb_release_interface(h, b->interface);
        return -1;
    }
    if (usb_flight_make(b, &need)) {
        usb_flight_free(b);
        b->ops->close(b->panel);
        b->panel = NULL;
        libusb_release_interface(h, b->interface);
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for its frames");
    }
    return 0;
}

static void close_handle(libusb_device_handle *h, int fd)
{
    libusb_close(h);
    if (fd >= 0)
        close(fd);
}

static void take_over(struct usb_board *b, const struct usb_entry *e, libusb_device_handle *h, int fd)
{
    pthread_mutex_lock(&b->lock);
    b->handle = h;
    b->fd = fd;
    b->entry = e->arrival;
    b->bus = e->bus;
    b->address = e->address;
    b->lost = b->faulted = b->halted = b->waiting = false;
    b->full = true;
    b->faults_in_row = 0;
    b->stats.state = USB_READY;
    b->stats.why[0] = '\0';
    b->stats.opens++;
    memcpy(b->stats.path, e->path, sizeof(b->stats.path));
    pthread_mutex_unlock(&b->lock);
    usb_log(b->usb, "%s %s: ready at %s", b->ops->name, b->config.serial, e->path);
}

// A board that left while it was opened is not in the list any more, and no one will say so again.
static void check_still_there(struct usb_board *b)
{
    pthread_mutex_lock(&b->usb->lock);
    const bool there = usb_entry_by_arrival(b->usb, b->entry) != NULL;
    pthread_mutex_lock(&b->lock);
    if (!there)
        usb_flight_lost(b);
    pthread_mutex_unlock(&b->lock);
    pthread_mutex_unlock(&b->usb->lock);
}

static void try_open(struct usb_board *b, const struct usb_entry *e, struct usb_target *t)
{
    libusb_device_handle *h;
    struct fault f = { 0 };
    int fd;
    const int r = usb_target_open(b->usb, t, &h, &fd);
    if (r) {
        char why[sizeof(b->stats.why)];
        snprintf(why, sizeof(why), "cannot be opened: %s", libusb_strerror(r));
        note_attempt(b, e->arrival, false, false);
        say_why(b, r == LIBUSB_ERROR_NO_DEVICE ? USB_ABSENT : USB_FAILED, why);
        return;
    }
    if (open_panel(b, h, &f)) {
        close_handle(h, fd);
        note_attempt(b, e->arrival, false, f.code == FAULT_WALL);
        say_why(b, USB_FAILED, f.text);
        return;
    }
    take_over(b, e, h, fd);
    check_still_there(b);
}

// Takes the first that fits; false: there is none now.
static bool look_for(struct usb_board *b)
{
    struct usb *u = b->usb;
    struct usb_entry found;
    struct usb_target t = { 0 };
    pthread_mutex_lock(&u->lock);
    struct usb_entry *e = usb_entry_for(u, b, usb_now_ns());
    if (e) {
        e->used = true;
        found = *e;
        t = usb_entry_target(e);
    }
    pthread_mutex_unlock(&u->lock);
    if (!e)
        return false;
    pthread_mutex_lock(&b->lock);
    if (b->stats.state == USB_ABSENT)
        b->stats.state = USB_OPENING;
    pthread_mutex_unlock(&b->lock);
    try_open(b, &found, &t);
    usb_target_finish(&t);
    return true;
}

// FAILED lasts as long as what failed is plugged in.
static void forget_failure(struct usb_board *b)
{
    struct usb *u = b->usb;
    bool there = false;
    pthread_mutex_lock(&u->lock);
    for (const struct usb_entry *e = u->entry; e; e = e->next)
        there = there || (e->ops == b->ops && strcmp(e->serial, b->config.serial) == 0);
    pthread_mutex_lock(&b->lock);
    if (!there && b->stats.state == USB_FAILED)
        b->stats.state = USB_ABSENT;
    pthread_mutex_unlock(&b->lock);
    pthread_mutex_unlock(&u->lock);
}

// ---- open ------------------------------------------------------------------------------------------------------

// With the board's lock, which it lets go of; it has all transfers of frames back.
static void mend(struct usb_board *b)
{
    libusb_device_handle *h = b->handle;
    struct fault f = { 0 };
    pthread_mutex_unlock(&b->lock);
    const int r = libusb_clear_halt(h, b->endpoint);
    if (r)
        fault_set(&f, FAULT_INTERNAL, "endpoint", "its halt cannot be cleared: %s", libusb_strerror(r));
    else if (b->ops->mend)
        b->ops->mend(b->panel, &f);
    if (f.text[0])
        usb_log(b->usb, "%s %s: after a stall: %s", b->ops->name, b->config.serial, f.text);
    pthread_mutex_lock(&b->lock);
    b->stats.errors += r != 0 && r != LIBUSB_ERROR_NO_DEVICE;
    if (r == LIBUSB_ERROR_NO_DEVICE)
        usb_flight_lost(b);
    usb_flight_mended(b);
}

// With the board's lock, which it lets go of. Nothing is with libusb any more.
static void close_board(struct usb_board *b)
{
    libusb_device_handle *h = b->handle;
    const uint64_t arrival = b->entry;
    const bool lost = b->lost;
    const int fd = b->fd;
    b->handle = NULL;
    b->fd = -1;
    b->entry = 0;
    b->stats.state = USB_ABSENT;
    if (lost)
        snprintf(b->stats.why, sizeof(b->stats.why), "%s", lost_words);
    b->stats.path[0] = '\0';
    b->stats.missed += b->waiting;
    b->waiting = false;
    pthread_mutex_unlock(&b->lock);
    b->ops->close(b->panel);
    b->panel = NULL;
    usb_flight_free(b);
    libusb_release_interface(h, b->interface);
    close_handle(h, fd);
    note_attempt(b, arrival, false, false);
    if (lost)
        usb_log(b->usb, "%s %s: %s", b->ops->name, b->config.serial, lost_words);
    pthread_mutex_lock(&b->lock);
}

// With the board's lock; one thing that has to be done with an open board, or a wait for one.
static void keep_open(struct usb_board *b)
{
    if (b->lost || b->stop) {
        usb_flight_cancel(b);
        while (!usb_flight_over(b))
            pthread_cond_wait(&b->change, &b->lock);
        close_board(b);
    } else if (b->halted && b->flying == 0) {
        mend(b);
    } else {
        pthread_cond_wait(&b->change, &b->lock);
    }
}

static void *keeper_main(void *arg)
{
    struct usb_board *b = arg;
    pthread_mutex_lock(&b->lock);
    while (!b->stop || b->handle) {
        if (b->handle) {
            keep_open(b);
            continue;
        }
        b->nudge = false;
        pthread_mutex_unlock(&b->lock);
        forget_failure(b);
        const bool tried = look_for(b);
        pthread_mutex_lock(&b->lock);
        if (!tried && !b->nudge && !b->stop)
            usb_cond_wait_until(&b->change, &b->lock, usb_now_ns() + RETRY_NS);
    }
    pthread_mutex_unlock(&b->lock);
    return NULL;
}

int usb_board_start(struct usb_board *b, struct fault *f)
{
    if (pthread_create(&b->keeper, NULL, keeper_main, b))
        return fault_set(f, FAULT_NO_MEMORY, "", "no thread for a board");
    return 0;
}

void usb_board_stop(struct usb_board *b)
{
    pthread_mutex_lock(&b->lock);
    b->stop = true;
    pthread_cond_broadcast(&b->change);
    pthread_mutex_unlock(&b->lock);
    pthread_join(b->keeper, NULL);
}
