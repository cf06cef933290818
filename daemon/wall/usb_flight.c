// SPDX-License-Identifier: Apache-2.0
//
// usb_flight.c - a board's frames on their way: which goes next, what became of it.
//
// Invariant: a transfer is with libusb exactly while its slot is busy (or the query is), and `flying` counts the busy
// slots; a handle is closed only when usb_flight_over. After a fault nothing is sent until all that was under way has
// come back, for two frames of one board must not mix. A frame has one of three ends: sent, dropped (a newer one is there), missed
// (the board is gone); the newest one has none yet: it is sent again.
#include "usb_internal.h"

#include <stdlib.h>
#include <string.h>

enum { CONTROL_MS = 1000, FLOOR_MS = 100, CEILING_MS = 3000, QUERY_NS = 1000000000 };
// A wire that has got no further than this in a transfer's time is stuck: a quarter of what it carries.
enum { FULL_SPEED_BYTES_MS = 300, HIGH_SPEED_BYTES_MS = 8000 };

static void LIBUSB_CALL on_frame(struct libusb_transfer *t);
static void LIBUSB_CALL on_query(struct libusb_transfer *t);

// max(100 ms, 3 frames), more for a transfer that takes longer on a sound wire, never over 3 s.
static unsigned timeout_ms(const struct usb_board *b, size_t bytes)
{
    const int speed = libusb_get_device_speed(libusb_get_device(b->handle));
    const size_t wire = bytes / (speed >= LIBUSB_SPEED_HIGH ? HIGH_SPEED_BYTES_MS : FULL_SPEED_BYTES_MS);
    const double frames = 3000.0 / b->config.rate;
    unsigned ms = frames > FLOOR_MS ? (unsigned)frames : FLOOR_MS;
    ms = wire > ms ? (unsigned)wire : ms;
    return ms > CEILING_MS ? CEILING_MS : ms;
}

static int submit_control(struct usb_board *b, struct libusb_transfer *t, uint8_t *buffer, const struct panel_step *s,
                          const uint8_t *out, libusb_transfer_cb_fn done, void *user, unsigned ms)
{
    libusb_fill_control_setup(buffer, s->request_type, s->request, s->value, s->index, (uint16_t)s->length);
    if (s->length > PANEL_CONTROL_MAX)
        return LIBUSB_ERROR_INVALID_PARAM;
    if (!(s->request_type & LIBUSB_ENDPOINT_IN))
        memcpy(buffer + LIBUSB_CONTROL_SETUP_SIZE, out + s->offset, s->length);
    libusb_fill_control_transfer(t, b->handle, buffer, done, user, ms);
    return libusb_submit_transfer(t);
}

static int submit_step(struct usb_board *b, struct usb_slot *s)
{
    const struct panel_step *step = &s->frame.step[s->step];
    const unsigned ms = timeout_ms(b, step->length);
    if (step->control)
        return submit_control(b, s->transfer, s->control, step, s->frame.data, on_frame, s, ms);
    libusb_fill_bulk_transfer(s->transfer, b->handle, b->endpoint, s->frame.data + step->offset, (int)step->length, on_frame,
                              s, ms);
    return libusb_submit_transfer(s->transfer);
}

bool usb_flight_over(const struct usb_board *b) { return b->flying == 0 && !b->query.busy; }

void usb_flight_cancel(struct usb_board *b)
{
    for (unsigned i = 0; i < USB_SLOTS; i++)
        if (b->slot[i].busy)
            libusb_cancel_transfer(b->slot[i].transfer);
    if ((b->lost || b->stop) && b->query.busy)
        libusb_cancel_transfer(b->query.transfer);
}

void usb_flight_lost(struct usb_board *b)
{
    if (b->lost)
        return;
    b->lost = true;
    b->stats.losses++;
    usb_flight_cancel(b);
    pthread_cond_broadcast(&b->change);
}

// What becomes of a frame that did not get there.
static void frame_fell(struct usb_board *b, const struct usb_slot *s)
{
    if (b->lost || b->stop)
        b->stats.missed++;
    else if (s->number == b->number && !b->waiting)
        b->waiting = true;
    else
        b->stats.dropped++;
}

static void frame_failed(struct usb_board *b, struct usb_slot *s, int error)
{
    s->busy = false;
    b->flying--;
    if (error == LIBUSB_ERROR_NO_DEVICE)
        usb_flight_lost(b);
    frame_fell(b, s);
    b->full = true;
    if (!b->faulted) {
        b->faulted = true;
        b->faults_in_row++;
        usb_flight_cancel(b);
    }
}

static void frame_done(struct usb_board *b, struct usb_slot *s)
{
    const uint64_t now = usb_now_ns();
    const uint64_t us = now > s->ready_ns ? (now - s->ready_ns) / 1000 : 0;
    s->busy = false;
    b->flying--;
    b->faults_in_row = 0;
    b->stats.sent++;
    b->stats.last_done_ns = now;
    b->latency_us[b->latencies++ % USB_LATENCIES] = us > UINT32_MAX ? UINT32_MAX : (uint32_t)us;
}

static bool may_send(const struct usb_board *b)
{
    return b->waiting && b->stats.state == USB_READY && !b->lost && !b->stop && !b->faulted && b->flying < b->ops->in_flight;
}

void usb_flight_pump(struct usb_board *b)
{
    if (!may_send(b))
        return;
    struct usb_slot *s = b->slot[0].busy ? &b->slot[1] : &b->slot[0];
    b->ops->encode(b->panel, b->newest, b->full, &s->frame);
    s->step = 0;
    s->number = b->number;
    s->ready_ns = b->newest_ready_ns;
    b->waiting = false;
    const int r = submit_step(b, s);
    if (r == 0) {
        s->busy = true;
        b->flying++;
        b->full = false;
        return;
    }
    if (r == LIBUSB_ERROR_NO_DEVICE)
        usb_flight_lost(b);
    else
        b->stats.errors++;
    // It waits for the next frame's turn, or for one under way to come back: then there may be memory again.
    frame_fell(b, s);
}

// All has come back after a fault that needs no mending by the keeper.
static void settle(struct usb_board *b)
{
    if (b->flying > 0 || !b->faulted)
        return;
    if (b->halted || b->lost || b->stop) {
        pthread_cond_broadcast(&b->change);
        return;
    }
    b->faulted = false;
    if (b->faults_in_row <= 1)
        usb_flight_pump(b);
}

void usb_flight_mended(struct usb_board *b)
{
    b->halted = false;
    settle(b);
}

static void count_fault(struct usb_board *b, const struct libusb_transfer *t)
{
    switch (t->status) {
    case LIBUSB_TRANSFER_STALL:
        b->stats.stalls++;
        b->halted = true;
        break;
    case LIBUSB_TRANSFER_TIMED_OUT:
        b->stats.timeouts++;
        break;
    case LIBUSB_TRANSFER_CANCELLED:
    case LIBUSB_TRANSFER_NO_DEVICE:
        break;
    default:
        b->stats.errors++;
    }
}

// The step's own outcome: 0, or -1 when the frame has failed.
static int step_done(struct usb_board *b, struct usb_slot *s, const struct libusb_transfer *t)
{
    const struct panel_step *step = &s->frame.step[s->step];
    struct fault f = { 0 };
    if (t->status != LIBUSB_TRANSFER_COMPLETED) {
        count_fault(b, t);
        return -1;
    }
    const bool in = step->control && (step->request_type & LIBUSB_ENDPOINT_IN);
    if (!in && (size_t)t->actual_length == step->length)
        return 0;
    if (in && b->ops->reply &&
        b->ops->reply(b->panel, step, s->control + LIBUSB_CONTROL_SETUP_SIZE, (size_t)t->actual_length, &f) == 0)
        return 0;
    b->stats.errors++;
    return -1;
}

static void LIBUSB_CALL on_frame(struct libusb_transfer *t)
{
    struct usb_slot *s = t->user_data;
    struct usb_board *b = s->board;
    pthread_mutex_lock(&b->lock);
    int error = t->status == LIBUSB_TRANSFER_NO_DEVICE ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_ERROR_IO;
    if (step_done(b, s, t)) {
        frame_failed(b, s, error);
    } else if (++s->step == s->frame.steps) {
        frame_done(b, s);
        usb_flight_pump(b);
    } else if (b->lost || b->stop || b->faulted) {
        frame_failed(b, s, 0);
    } else if ((error = submit_step(b, s)) != 0) {
        b->stats.errors += error != LIBUSB_ERROR_NO_DEVICE;
        frame_failed(b, s, error);
    }
    settle(b);
    if (b->flying == 0)
        pthread_cond_broadcast(&b->change);
    pthread_mutex_unlock(&b->lock);
}

// ---- the board's own counters ---------------------------------------------------------------------------------

static void query_next(struct usb_board *b)
{
    struct usb_query *q = &b->query;
    q->busy = false;
    if (q->at < q->steps && !b->lost && !b->stop) {
        const int r = submit_control(b, q->transfer, q->control, &q->step[q->at], NULL, on_query, b, CONTROL_MS);
        q->busy = r == 0;
        if (r == LIBUSB_ERROR_NO_DEVICE)
            usb_flight_lost(b);
    }
    if (!q->busy)
        pthread_cond_broadcast(&b->change);
}

static void LIBUSB_CALL on_query(struct libusb_transfer *t)
{
    struct usb_board *b = t->user_data;
    pthread_mutex_lock(&b->lock);
    struct usb_query *q = &b->query;
    if (t->status == LIBUSB_TRANSFER_COMPLETED)
        b->ops->answer(b->panel, q->at, q->control + LIBUSB_CONTROL_SETUP_SIZE, (size_t)t->actual_length,
                       &b->stats.rendered, &b->stats.received);
    else if (t->status == LIBUSB_TRANSFER_NO_DEVICE)
        usb_flight_lost(b);
    q->at++;
    query_next(b);
    pthread_mutex_unlock(&b->lock);
}

void usb_flight_query(struct usb_board *b, uint64_t now_ns)
{
    struct usb_query *q = &b->query;
    if (!b->ops->query || b->stats.state != USB_READY || b->lost || b->stop || q->busy || now_ns < q->next_ns)
        return;
    q->next_ns = now_ns + QUERY_NS;
    q->steps = b->ops->query(b->panel, q->step, USB_QUERIES);
    q->at = 0;
    query_next(b);
}

// ---- buffers --------------------------------------------------------------------------------------------------

int usb_flight_make(struct usb_board *b, const struct panel_need *need)
{
    bool ok = true;
    for (unsigned i = 0; i < USB_SLOTS; i++) {
        struct usb_slot *s = &b->slot[i];
        s->board = b;
        s->transfer = libusb_alloc_transfer(0);
        s->frame = (struct panel_frame){ .data = malloc(need->bytes), .room = need->bytes,
                                         .step = calloc(need->steps, sizeof(*s->frame.step)), .steps_room = need->steps };
        ok = ok && s->transfer && s->frame.data && s->frame.step;
    }
    b->query.transfer = libusb_alloc_transfer(0);
    b->query.next_ns = 0;
    return ok && b->query.transfer ? 0 : -1;
}

void usb_flight_free(struct usb_board *b)
{
    for (unsigned i = 0; i < USB_SLOTS; i++) {
        libusb_free_transfer(b->slot[i].transfer);
        free(b->slot[i].frame.data);
        free(b->slot[i].frame.step);
        b->slot[i] = (struct usb_slot){ 0 };
    }
    libusb_free_transfer(b->query.transfer);
    b->query.transfer = NULL;
}
