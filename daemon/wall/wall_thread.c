// SPDX-License-Identifier: Apache-2.0
// wall_thread.c - the pacer's thread: sleeps until the next tick or the next delayed board, asks wall_pacer what to show,
// makes the bytes and hands them to the boards. Invariant: nothing here allocates, waits for a board, or holds `lock` while it computes.
//
// Real time: FIFO priority 10 where it is allowed (above all that is not real time, below what the kernel itself needs), else
// nice -10, else as it comes. The timer's slack of 50 us that other threads have goes in any case.
#include <errno.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "wall_internal.h"

/* So long at most until the thread sees that it is to stop. */
static const uint64_t nap_ns = 50000000;

uint64_t wall_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

static void sleep_until(struct wall *w, uint64_t wake_ns)
{
    for (uint64_t now = wall_now_ns(); now < wake_ns && !atomic_load(&w->stop); now = wall_now_ns()) {
        const uint64_t until = wake_ns - now > nap_ns ? now + nap_ns : wake_ns;
        const struct timespec t = { .tv_sec = (time_t)(until / 1000000000), .tv_nsec = (long)(until % 1000000000) };
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
    }
}

static const char *become_prompt(bool *realtime)
{
    const struct sched_param p = { .sched_priority = 10 };
    prctl(PR_SET_TIMERSLACK, 1);
    *realtime = pthread_setschedparam(pthread_self(), SCHED_FIFO, &p) == 0;
    if (*realtime)
        return "real-time priority";
    // On Linux this is of the thread, not of the process.
    return setpriority(PRIO_PROCESS, (id_t)syscall(SYS_gettid), -10) == 0 ? "nice -10 (no right to real-time priority)"
                                                                          : "usual priority (no right to a higher one)";
}

/* ---- sending ----------------------------------------------------------------------------------------------- */

static struct wall_set *set_of(struct wall *w, uint64_t run) { return &w->set[run % w->sets]; }

static void send_next(struct wall *w, unsigned board, uint64_t now_ns)
{
    struct wall_out *o = &w->out[board];
    const struct wall_set *s = set_of(w, o->next++);
    o->planned_ns = s->time_ns + o->delay_ns;
    o->sent_ns = now_ns;
    if (o->usb)
        usb_board_send(o->usb, s->bytes[board], now_ns);
}

static void send_due(struct wall *w)
{
    const uint64_t now_ns = wall_now_ns();
    for (unsigned b = 0; b < w->def->n_boards; b++)
        while (w->out[b].next < w->run && set_of(w, w->out[b].next)->time_ns + w->out[b].delay_ns <= now_ns)
            send_next(w, b, now_ns);
}

/* The set that the next tick writes into may still wait for a board when ticks came late: it goes now. */
static void send_overdue(struct wall *w)
{
    for (unsigned b = 0; b < w->def->n_boards; b++)
        while (w->out[b].next + w->sets <= w->run)
            send_next(w, b, wall_now_ns());
}

static uint64_t next_wake_ns(struct wall *w)
{
    uint64_t wake_ns = pacer_time_ns(&w->pacer, w->pacer.next);
    for (unsigned b = 0; b < w->def->n_boards; b++) {
        if (w->out[b].next == w->run)
            continue;
        const uint64_t due_ns = set_of(w, w->out[b].next)->time_ns + w->out[b].delay_ns;
        wake_ns = due_ns < wake_ns ? due_ns : wake_ns;
    }
    return wake_ns;
}

/* How far apart the boards' last transfers came back, each against its own planned time; boards that have not yet sent their last
 * frame are left out. < 0: fewer than two. */
static double measure_skew_ms(struct wall *w)
{
    int64_t first = INT64_MAX, last = INT64_MIN;
    unsigned n = 0;
    for (unsigned b = 0; b < w->def->n_boards; b++) {
        struct usb_stats s;
        const struct wall_out *o = &w->out[b];
        if (!o->usb)
            continue;
        usb_board_stats(o->usb, &s, NULL);
        if (s.state != USB_READY || !o->sent_ns || s.last_done_ns < o->sent_ns)
            continue;
        const int64_t lag = (int64_t)(s.last_done_ns - o->planned_ns);
        first = lag < first ? lag : first;
        last = lag > last ? lag : last;
        n++;
    }
    return n < 2 ? -1 : (double)(last - first) * 1e-6;
}

/* ---- a tick -------------------------------------------------------------------------------------------------- */

struct task { struct pacer_tick tick; struct wall_pattern pattern; uint64_t pattern_ns, pattern_number; };

static bool take_task(struct wall *w, uint64_t now_ns, struct task *t)
{
    pthread_mutex_lock(&w->lock);
    const bool any = pacer_run(&w->pacer, now_ns, &t->tick);
    t->pattern = w->pattern;
    t->pattern_ns = w->pattern_ns;
    t->pattern_number = w->pattern_number;
    pthread_mutex_unlock(&w->lock);
    return any;
}

static const float *drive_of(struct wall *w, const struct task *t)
{
    if (t->tick.source != WALL_PATTERN)
        return t->tick.slot < 0 ? NULL : w->slot[t->tick.slot];
    if (t->pattern.kind == PATTERN_ORDER || w->pattern_drawn != t->pattern_number) {
        const double seconds = t->tick.time_ns > t->pattern_ns ? (double)(t->tick.time_ns - t->pattern_ns) * 1e-9 : 0;
        if (wall_pattern_draw(w->pattern_drive, w->def, w->layout, &t->pattern, seconds, NULL))
            return NULL; // wall_pattern has tried it: cannot be
        w->pattern_drawn = t->pattern_number;
    }
    return w->pattern_drive;
}

static void keep_preview(struct wall *w, const struct wall_set *s)
{
    if (pthread_mutex_trylock(&w->preview_lock))
        return; // someone reads the one before: the next tick's is soon there
    for (unsigned b = 0; b < w->def->n_boards; b++)
        memcpy(w->preview.bytes[b], s->bytes[b], w->out[b].size);
    pthread_mutex_unlock(&w->preview_lock);
}

static void publish(struct wall *w, const struct pacer_tick *t, uint64_t now_ns)
{
    const struct pacer *p = &w->pacer;
    pthread_mutex_lock(&w->lock);
    meter_add(&w->late, (double)(now_ns - t->time_ns) * 1e-6);
    if (w->skew_ms >= 0)
        meter_add(&w->skew, w->skew_ms);
    meter_second_add(&w->second, now_ns, p->pictures);
    for (unsigned b = 0; b < w->def->n_boards; b++)
        w->board_power[b] = wall_colour_board(w->colour, b);
    for (unsigned s = 0; s < w->def->n_supplies; s++)
        w->supply_power[s] = wall_colour_supply(w->colour, s);
    w->published.source = t->source;
    w->published.exposure = t->exposure;
    w->published.ticks = p->ticks;
    w->published.ticks_missed = p->ticks_missed;
    w->published.pictures = p->pictures;
    w->published.shown = p->shown;
    w->published.dropped = p->dropped;
    pthread_mutex_unlock(&w->lock);
}

static void run_tick(struct wall *w)
{
    const uint64_t now_ns = wall_now_ns();
    struct task t;
    if (!take_task(w, now_ns, &t))
        return;
    send_overdue(w);
    struct wall_set *s = set_of(w, w->run);
    wall_colour_frame(w->colour, drive_of(w, &t), t.tick.fade, t.tick.tick, s->bytes);
    s->time_ns = t.tick.time_ns;
    w->skew_ms = measure_skew_ms(w);
    w->run++;
    send_due(w);
    keep_preview(w, s);
    publish(w, &t.tick, now_ns);
}

static void *pacer_main(void *arg)
{
    struct wall *w = arg;
    bool realtime;
    const char *priority = become_prompt(&realtime);
    pthread_mutex_lock(&w->lock);
    w->published.realtime = realtime;
    pthread_mutex_unlock(&w->lock);
    if (w->log) {
        char line[WALL_NAME_MAX + 160];
        snprintf(line, sizeof(line), "wall %s: %u boards, %u LEDs, %g frames a second, %s", w->def->name, w->def->n_boards,
                 w->layout->lit, w->def->rate, priority);
        w->log(line);
    }
    while (!atomic_load(&w->stop)) {
        sleep_until(w, next_wake_ns(w));
        if (atomic_load(&w->stop))
            break;
        send_due(w);
        run_tick(w);
    }
    return NULL;
}

int wall_thread_start(struct wall *w, struct fault *f)
{
    const int err = pthread_create(&w->thread, NULL, pacer_main, w);
    if (err)
        return fault_set(f, FAULT_INTERNAL, "wall", "no thread for wall %s: %s", w->def->name, strerror(err));
    w->running = true;
    return 0;
}

void wall_thread_stop(struct wall *w)
{
    if (!w->running)
        return;
    atomic_store(&w->stop, true);
    pthread_join(w->thread, NULL);
    w->running = false;
}
