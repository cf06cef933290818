// SPDX-License-Identifier: Apache-2.0
// scheduler.c - the queues; see scheduler.h. Everything here is bookkeeping under the lock.
#include "scheduler_private.h"

#include <assert.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

// Of a wall: one is read, one decoded, one bloomed, one waits for its turn.
enum { WALL_SLOTS = 4 };

static void event(struct sched *s)
{
    uint64_t one = 1;
    // A full counter (EAGAIN) is readable already.
    (void)!write(s->event_fd, &one, sizeof one);
}

static void link_job(struct job_queue *q, struct job *j)
{
    assert(!j->linked);
    TAILQ_INSERT_TAIL(q, j, link);
    j->linked = true;
}

// Those that pass others come first, in their order.
static void link_stage(struct job_queue *q, struct job *j)
{
    struct job *before = j->passes ? TAILQ_FIRST(q) : NULL;
    while (before && before->passes)
        before = TAILQ_NEXT(before, link);
    if (!before) {
        link_job(q, j);
        return;
    }
    assert(!j->linked);
    TAILQ_INSERT_BEFORE(before, j, link);
    j->linked = true;
}

static void unlink_job(struct job_queue *q, struct job *j)
{
    assert(j->linked);
    TAILQ_REMOVE(q, j, link);
    j->linked = false;
}

static struct sched_lane *lane_of(struct sched *s, const struct job *j)
{
    return &s->lane[j->walled ? LANE_WALLS : LANE_FRAMES];
}

// Somebody of the pool can do something for this lane.
static void wake_pool(struct sched_lane *l)
{
    if (l->name == LANE_WALLS)
        pthread_cond_signal(&l->sched->wall_wake);
    pthread_cond_broadcast(&l->sched->pool_wake);
}

static void forget_admitted(struct sched_lane *l, const struct job *j)
{
    unsigned i = 0;
    while (l->at_work[i] != j)
        i++;
    l->at_work[i] = l->at_work[--l->admitted];
}

// Ends the job's time between OPEN and ENCODE.
static void slot_leave(struct sched_lane *l, struct job *j)
{
    if (j->slot)
        j->slot->job = NULL;
    j->slot = NULL;
    forget_admitted(l, j);
    sched_room_freed(l->sched);
    wake_pool(l);
}

// ---- stages ----------------------------------------------------------------------------------------

static bool in_pipeline(enum job_stage stage) { return stage >= JOB_OPEN && stage <= JOB_ENCODE; }

static bool ending(const struct job *j) { return j->fault.code != FAULT_NONE || j->cancel; }

static void order_leave(struct sched_lane *l, struct job *j)
{
    if (!j->ordered)
        return;
    TAILQ_REMOVE(&l->order, j, of_order);
    j->ordered = false;
    pthread_cond_signal(&l->device_wake);
}

static void enter(struct sched *s, struct job *j, enum job_stage stage)
{
    struct sched_lane *l = lane_of(s, j);
    if (in_pipeline((enum job_stage)j->stage) && !in_pipeline(stage))
        slot_leave(l, j);
    if (stage > JOB_BLOOM)
        order_leave(l, j);
    j->stage = stage;
    j->stage_ns = clock_ns();
    j->next_task = 0;
    if (j->wants_progress)
        event(s);
    if (stage == JOB_DONE) {
        l->running--;
        // Of an inline result its bytes stay until the client has read them; a memfd is the client's.
        room_give(s, j, j->finished && j->output.kind == PAYLOAD_INLINE ? j->output.size : 0);
        fair_settle(s, j);
        link_job(&s->done, j);
        event(s);
        return;
    }
    j->tasks = job_tasks(j);
    link_stage(&l->stage[stage], j);
    if (job_stage_on_device(stage))
        pthread_cond_signal(&l->device_wake);
    else
        wake_pool(l);
}

static void too_large(struct sched *s, struct job *j)
{
    uint64_t bytes;
    sched_fits(s, j, &bytes);
    fault_set(&j->fault, FAULT_LIMIT, "input", "%llu bytes of memory for this frame; at most %llu are taken",
              (unsigned long long)bytes, (unsigned long long)s->limits.work_bytes);
}

// What it needs is known: planes, or first those of the right size; or, OPEN again: first room.
static enum job_stage to_planes(struct sched_lane *l, struct job *j)
{
    switch (room_take(l, j)) {
    case ROOM_READY: job_bind(j, j->slot->in, j->slot->out); return JOB_DECODE;
    case ROOM_PREPARE: return JOB_PREPARE;
    case ROOM_USER: return JOB_WAITING;
    case ROOM_NEVER: too_large(l->sched, j); return JOB_FINISH;
    default: return JOB_OPEN;
    }
}

static enum job_stage next_stage(struct sched_lane *l, struct job *j)
{
    switch ((enum job_stage)j->stage) {
    case JOB_OPEN:
        if (j->kind == JOB_KEEPS)
            return JOB_FINISH;
        return j->kind == JOB_PLANS || job_wants_plan(j) ? JOB_PLAN : to_planes(l, j);
    case JOB_PLAN: return j->kind == JOB_PLANS ? JOB_FINISH : to_planes(l, j);
    case JOB_PREPARE:
        job_bind(j, j->slot->in, j->slot->out);
        return JOB_DECODE;
    case JOB_DECODE: return JOB_BLOOM;
    case JOB_BLOOM: return j->walled ? JOB_FINISH : JOB_BEGIN;
    case JOB_BEGIN: return JOB_ENCODE;
    case JOB_ENCODE: return JOB_FINISH;
    default: return JOB_DONE;
    }
}

static void note_time(struct job *j)
{
    double ms = (double)(clock_ns() - j->stage_ns) / 1e6;
    switch ((enum job_stage)j->stage) {
    case JOB_OPEN: j->ms.decode += ms - j->ms.load; break;
    case JOB_DECODE: j->ms.decode += ms; break;
    case JOB_BEGIN:
    case JOB_ENCODE:
    case JOB_FINISH: j->ms.encode += ms; break;
    default: break;
    }
}

static void park(struct sched_lane *l, struct job *j)
{
    j->parked = true;
    link_job(&l->parked, j);
}

// Opened, and its user has too much at work for it: back into its line with nothing held.
static void send_back(struct sched_lane *l, struct job *j)
{
    struct sched *s = l->sched;
    j->stage = JOB_WAITING;
    j->passes = false;
    forget_admitted(l, j);
    l->running--;
    l->n_waiting++;
    s->deadlines += j->deadline_ns != 0;
    fair_return(j);
    job_unload(j);
    room_give(s, j, 0);
    wake_pool(l);
}

// The stage's last task is done, or the job is to end and none of its tasks runs.
static void advance(struct sched *s, struct job *j)
{
    struct sched_lane *l = lane_of(s, j);
    for (;;) {
        note_time(j);
        enum job_stage next = ending(j) && j->stage != JOB_FINISH ? JOB_FINISH : next_stage(l, j);
        if (next == JOB_OPEN) {
            park(l, j);
            return;
        }
        if (next == JOB_WAITING) {
            send_back(l, j);
            return;
        }
        enter(s, j, next);
        // A stage may have no task at all: every chunk is copied as it is.
        if (next == JOB_DONE || j->tasks)
            return;
        unlink_job(&l->stage[next], j);
    }
}

// In their order: none overtakes one that needs more.
void sched_room_freed(struct sched *s)
{
    for (unsigned i = 0; i < LANES; i++) {
        struct sched_lane *l = &s->lane[i];
        struct job *j;
        while ((j = TAILQ_FIRST(&l->parked))) {
            unlink_job(&l->parked, j);
            j->parked = false;
            j->stage_ns = clock_ns(); // waiting is not the stage's time
            advance(s, j);
            if (!j->parked)
                continue;
            TAILQ_REMOVE(&l->parked, j, link);
            TAILQ_INSERT_HEAD(&l->parked, j, link);
            break;
        }
    }
}

// No more tasks of this stage are claimed.
static void withdraw(struct sched *s, struct job *j)
{
    struct sched_lane *l = lane_of(s, j);
    if (j->linked)
        unlink_job(j->parked ? &l->parked : &l->stage[j->stage], j);
    j->parked = false;
    j->next_task = j->tasks;
}

static struct job *claim_from(struct sched_lane *l, enum job_stage stage, unsigned *task)
{
    struct job *j = TAILQ_FIRST(&l->stage[stage]);
    if (!j)
        return NULL;
    // Waiting for a thread is not the stage's time.
    if (j->next_task == 0)
        j->stage_ns = clock_ns();
    *task = j->next_task++;
    j->running++;
    if (j->next_task == j->tasks)
        unlink_job(&l->stage[stage], j);
    if (in_pipeline(stage))
        l->claimed++;
    return j;
}

static void admit(struct sched_lane *l, struct job *j)
{
    l->n_waiting--;
    l->sched->deadlines -= j->deadline_ns != 0;
    room_turn(l->sched, j);
    l->running++;
    l->at_work[l->admitted++] = j;
    j->admitted_ns = clock_ns();
    j->ms.queue = (double)(j->admitted_ns - j->accepted_ns) / 1e6;
    if (l->dead)
        fault_set(&j->fault, FAULT_DEVICE_LOST, "", "the Vulkan device was lost and could not be opened again");
    if (l->name == LANE_WALLS) {
        TAILQ_INSERT_TAIL(&l->order, j, of_order);
        j->ordered = true;
    }
    j->stage = JOB_OPEN;
    enter(l->sched, j, ending(j) ? JOB_FINISH : JOB_OPEN);
}

static struct job *wall_pop(struct sched_lane *l)
{
    struct job *j = TAILQ_FIRST(&l->waiting);
    if (j)
        unlink_job(&l->waiting, j);
    return j;
}

static bool may_pass(struct sched *s, const struct job *j) { return room_may_turn(s, j) && fair_passes(s, j); }

// While one waits for room nobody else gets a turn, or large frames would wait for ever.
static struct job *frame_pop(struct sched_lane *l, bool passing)
{
    struct sched *s = l->sched;
    if (!TAILQ_EMPTY(&l->parked))
        return NULL;
    struct job *j = fair_first(s, passing ? may_pass : room_may_turn);
    if (!j)
        return NULL;
    j->passes = passing;
    fair_take(s, j);
    return j;
}

static struct job *claim_started(struct sched_lane *l, bool passing, unsigned *task)
{
    static const enum job_stage latest_first[] = { JOB_ENCODE, JOB_BEGIN, JOB_DECODE, JOB_OPEN };
    for (size_t i = 0; i < sizeof latest_first / sizeof latest_first[0]; i++) {
        const struct job *j = TAILQ_FIRST(&l->stage[latest_first[i]]);
        if (j && (j->passes || !passing))
            return claim_from(l, latest_first[i], task);
    }
    return NULL;
}

static struct job *claim_admitted(struct sched_lane *l, struct job *j, unsigned *task)
{
    admit(l, j);
    j = claim_from(l, JOB_FINISH, task);
    return j ? j : claim_from(l, JOB_OPEN, task);
}

static struct job *claim_in(struct sched_lane *l, unsigned *task)
{
    struct job *j = claim_from(l, JOB_FINISH, task);
    if (j || l->hold)
        return j;
    if ((j = claim_started(l, true, task)))
        return j;
    // Who may pass what is at work need not wait until nothing is left to do for that.
    if (l->name == LANE_FRAMES && l->admitted < l->slots && l->n_waiting && (j = frame_pop(l, true)))
        return claim_admitted(l, j, task);
    if ((j = claim_started(l, false, task)))
        return j;
    if (l->admitted >= l->regular || !l->n_waiting || !(j = l->name == LANE_WALLS ? wall_pop(l) : frame_pop(l, false)))
        return NULL;
    return claim_admitted(l, j, task);
}

struct job *sched_claim(struct sched *s, bool walls_only, unsigned *task)
{
    struct job *j = claim_in(&s->lane[LANE_WALLS], task);
    return j || walls_only ? j : claim_in(&s->lane[LANE_FRAMES], task);
}

// Of several tasks' faults the lowest task's counts, as it would with one thread.
static void note_fault(struct job *j, unsigned task, const struct fault *f)
{
    if (j->fault.code != FAULT_NONE && j->fault_task <= task)
        return;
    j->fault = *f;
    j->fault_task = task;
    if (f->code == FAULT_NONE) // a failure without words is still one
        fault_set(&j->fault, FAULT_INTERNAL, "", "a task failed and did not say why");
}

void sched_complete(struct sched *s, struct job *j, unsigned task, int rc, const struct fault *f)
{
    struct sched_lane *l = lane_of(s, j);
    if (in_pipeline((enum job_stage)j->stage) && !job_stage_on_device((enum job_stage)j->stage) && --l->claimed == 0)
        pthread_cond_broadcast(&l->quiet);
    j->running--;
    if (rc < 0)
        note_fault(j, task, f);
    if (ending(j))
        withdraw(s, j);
    if (!j->running && j->next_task == j->tasks)
        advance(s, j);
}

// A wall's frame waits until those before it have been bloomed.
static struct job *device_first(struct sched_lane *l, enum job_stage stage)
{
    struct job *j = TAILQ_FIRST(&l->stage[stage]);
    if (stage != JOB_BLOOM || l->name == LANE_FRAMES)
        return j;
    j = TAILQ_FIRST(&l->order);
    return j && j->stage == JOB_BLOOM && j->linked ? j : NULL;
}

struct job *sched_device_next(struct sched_lane *l)
{
    static const enum job_stage in_order[] = { JOB_PLAN, JOB_PREPARE, JOB_BLOOM };
    enum job_stage stage = JOB_BLOOM;
    struct job *j = NULL;
    for (size_t i = 0; i < sizeof in_order / sizeof in_order[0] && !j; i++)
        j = device_first(l, stage = in_order[i]);
    if (!j)
        return NULL;
    unlink_job(&l->stage[stage], j);
    j->next_task = j->tasks;
    j->running++;
    return j;
}

// The planes of every slot are gone with their device. Called with no task of the pipeline running.
void sched_rewind_all(struct sched_lane *l, const struct fault *f)
{
    for (unsigned i = 0; i < l->slots; i++) {
        struct job *j = l->slot[i].job;
        l->slot[i].job = NULL;
        l->slot[i].prepared = false;
        if (!i)
            room_lost(l);
        if (!j)
            continue;
        withdraw(l->sched, j);
        j->slot = NULL;
        if (j->retried || l->dead)
            note_fault(j, 0, f);
        if (ending(j)) {
            enter(l->sched, j, JOB_FINISH);
            continue;
        }
        j->retried = true;
        job_rewind(j);
        enter(l->sched, j, JOB_OPEN);
    }
    if (l->lost) // nobody may have had a job in it
        event(l->sched);
}

// ---- from the socket thread --------------------------------------------------------------------------

void sched_submit(struct sched *s, struct sched_flow *flow, struct job *j)
{
    pthread_mutex_lock(&s->lock);
    assert(j->user == flow->user);
    j->accepted_ns = clock_ns();
    j->deadline_ns = j->deadline_ms ? j->accepted_ns + j->deadline_ms * UINT64_C(1000000) : 0;
    s->deadlines += j->deadline_ns != 0;
    j->flow = flow;
    j->stage = JOB_WAITING;
    struct sched_lane *l = lane_of(s, j);
    if (j->walled)
        link_job(&l->waiting, j);
    else
        fair_push(s, flow, j);
    l->n_waiting++;
    if (j->walled)
        pthread_cond_signal(&s->wall_wake);
    pthread_cond_signal(&s->pool_wake);
    pthread_mutex_unlock(&s->lock);
}

// It never had a turn. Freeing it is the pool's: it may hold a file whose close blocks.
static void end_waiting(struct sched *s, struct job *j)
{
    struct sched_lane *l = lane_of(s, j);
    if (j->walled) {
        unlink_job(&l->waiting, j);
    } else {
        fair_remove(j);
        j->user->running++;
        j->flow->running++;
    }
    s->deadlines -= j->deadline_ns != 0;
    l->n_waiting--;
    l->running++;
    enter(s, j, JOB_FINISH);
}

void sched_cancel(struct sched *s, struct job *j)
{
    pthread_mutex_lock(&s->lock);
    enum job_stage stage = (enum job_stage)j->stage;
    bool was = atomic_exchange(&j->cancel, true);
    if (was || stage >= JOB_FINISH) {
        // already on its way out
    } else if (stage == JOB_WAITING) {
        end_waiting(s, j);
    } else {
        withdraw(s, j);
        if (!j->running)
            advance(s, j);
    }
    fair_leave_flow(j);
    pthread_mutex_unlock(&s->lock);
}

// One queue's late jobs end; returns the earliest deadline of the others, or `next`.
static uint64_t expire_queue(struct sched *s, struct job_queue *q, uint64_t now_ns, uint64_t next)
{
    struct job *j, *after;
    for (j = TAILQ_FIRST(q); j; j = after) {
        after = TAILQ_NEXT(j, link);
        if (!j->deadline_ns)
            continue;
        if (j->deadline_ns > now_ns) {
            next = !next || j->deadline_ns < next ? j->deadline_ns : next;
            continue;
        }
        fault_set(&j->fault, FAULT_DEADLINE, "deadline_ms", "it waited for its turn for %.1f ms; at most %u were given",
                  (double)(now_ns - j->accepted_ns) / 1e6, j->deadline_ms);
        end_waiting(s, j);
    }
    return next;
}

uint64_t sched_expire(struct sched *s, uint64_t now_ns)
{
    uint64_t next = 0;
    pthread_mutex_lock(&s->lock);
    if (s->deadlines) {
        struct sched_user *u;
        struct sched_flow *flow, *after;
        next = expire_queue(s, &s->lane[LANE_WALLS].waiting, now_ns, next);
        TAILQ_FOREACH(u, &s->users, link)
        for (flow = TAILQ_FIRST(&u->flows); flow; flow = after) {
            after = TAILQ_NEXT(flow, of_user); // a flow without a job is not on the list
            next = expire_queue(s, &flow->waiting, now_ns, next);
        }
    }
    pthread_mutex_unlock(&s->lock);
    return next;
}

struct job *sched_done(struct sched *s)
{
    pthread_mutex_lock(&s->lock);
    struct job *j = TAILQ_FIRST(&s->done);
    if (j)
        unlink_job(&s->done, j);
    pthread_mutex_unlock(&s->lock);
    if (j)
        j->ms.total = (double)(clock_ns() - j->accepted_ns) / 1e6;
    return j;
}

int sched_event_fd(const struct sched *s) { return s->event_fd; }

void sched_event_clear(struct sched *s)
{
    uint64_t n;
    (void)!read(s->event_fd, &n, sizeof n); // EAGAIN: nothing was there
}

struct sched_counts sched_counts(struct sched *s)
{
    pthread_mutex_lock(&s->lock);
    struct sched_counts c = { .load_bytes = s->room.load,
                              .work_bytes = s->room.work,
                              .work_peak_bytes = s->room.work_peak };
    for (unsigned i = 0; i < LANES; i++) {
        c.device_dead |= s->lane[i].lost;
        c.waiting += s->lane[i].n_waiting;
        c.running += s->lane[i].running;
    }
    pthread_mutex_unlock(&s->lock);
    return c;
}

uint64_t sched_device_since_ns(struct sched *s)
{
    uint64_t longest = 0;
    for (unsigned i = 0; i < LANES; i++) {
        uint64_t since = pulse_since_ns(&s->lane[i].pulse);
        if (since && (!longest || since < longest))
            longest = since;
    }
    return longest;
}

const struct bloom_device_info *sched_device(struct sched *s) { return &s->device_info; }

// The threads are stopped first: the device may be asked by one thread at a time.
unsigned sched_validation_messages(struct sched *s)
{
    sched_threads_stop(s);
    unsigned messages = 0;
    for (unsigned i = 0; i < LANES; i++) {
        const struct sched_lane *l = &s->lane[i];
        messages += l->validation_messages + (l->bloom ? bloom_validation_messages(l->bloom) : 0);
    }
    return messages;
}

int sched_open_walls(struct sched *s, struct fault *f)
{
    pthread_mutex_lock(&s->lock);
    int rc = s->lane[LANE_WALLS].open || s->stopping ? 0 : sched_walls_start(s, f);
    pthread_mutex_unlock(&s->lock);
    return rc;
}

// ---- life ------------------------------------------------------------------------------------------

static void lane_init(struct sched *s, enum sched_lane_name name, unsigned slots)
{
    struct sched_lane *l = &s->lane[name];
    l->sched = s;
    l->name = name;
    l->regular = name == LANE_WALLS ? WALL_SLOTS : slots;
    l->slots = name == LANE_WALLS ? WALL_SLOTS : slots + 1;
    pthread_cond_init(&l->device_wake, NULL);
    pthread_cond_init(&l->quiet, NULL);
    TAILQ_INIT(&l->waiting);
    TAILQ_INIT(&l->parked);
    TAILQ_INIT(&l->order);
    for (unsigned i = 0; i < JOB_STAGES; i++)
        TAILQ_INIT(&l->stage[i]);
}

int sched_create(struct sched **out, const struct sched_config *config, struct fault *f)
{
    struct sched *s = calloc(1, sizeof *s);
    if (!s)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the scheduler");
    pthread_mutex_init(&s->lock, NULL);
    pthread_cond_init(&s->pool_wake, NULL);
    pthread_cond_init(&s->wall_wake, NULL);
    s->limits = config->limits;
    fair_init(s);
    TAILQ_INIT(&s->done);
    for (unsigned i = 0; i < LANES; i++)
        lane_init(s, (enum sched_lane_name)i, config->slots);
    s->device = config->device;
    s->warm_idle = config->warm_idle;
    s->log = config->log;
    s->event_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (s->event_fd < 0) {
        fault_set(f, FAULT_INTERNAL, "", "eventfd: %s", strerror(errno));
        goto fail;
    }
    if (sched_threads_start(s, config->threads, f) < 0)
        goto fail;
    *out = s;
    return 0;
fail:
    sched_destroy(s);
    return -1;
}

static void queue_drop(struct job_queue *q)
{
    struct job *j;
    while ((j = TAILQ_FIRST(q))) {
        unlink_job(q, j);
        job_destroy(j);
    }
}

static void lane_finish(struct sched_lane *l)
{
    queue_drop(&l->waiting);
    queue_drop(&l->parked);
    for (unsigned i = 0; i < JOB_STAGES; i++)
        queue_drop(&l->stage[i]);
    bloom_destroy(l->bloom);
    pthread_cond_destroy(&l->quiet);
    pthread_cond_destroy(&l->device_wake);
}

void sched_destroy(struct sched *s)
{
    if (!s)
        return;
    sched_threads_stop(s);
    for (unsigned i = 0; i < LANES; i++)
        lane_finish(&s->lane[i]);
    queue_drop(&s->done);
    users_finish(s);
    if (s->event_fd >= 0)
        close(s->event_fd);
    pthread_cond_destroy(&s->wall_wake);
    pthread_cond_destroy(&s->pool_wake);
    pthread_mutex_destroy(&s->lock);
    free(s);
}
