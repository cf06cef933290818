// SPDX-License-Identifier: Apache-2.0
// scheduler.c - the queues; see scheduler.h. Everything here is bookkeeping under the lock.
#include "scheduler_private.h"

#include <assert.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

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

static void unlink_job(struct job_queue *q, struct job *j)
{
    assert(j->linked);
    TAILQ_REMOVE(q, j, link);
    j->linked = false;
}

// ---- slots -----------------------------------------------------------------------------------------

static bool same_geometry(const struct sched_slot *slot, unsigned count, const struct bloom_geometry *g)
{
    if (!slot->prepared || slot->count != count)
        return false;
    for (unsigned i = 0; i < count; i++)
        if (!bloom_geometry_same(&g[i], &slot->geometry[i]))
            return false;
    return true;
}

// A free slot, best one that fits as it is: then the device thread need not be asked. True when it does.
static bool slot_take(struct sched *s, struct job *j)
{
    struct bloom_geometry g[BLOOM_TARGETS_MAX];
    unsigned count = job_geometry(j, g);
    struct sched_slot *found = NULL;
    bool fits = false;
    for (unsigned i = 0; i < s->slots && !fits; i++) {
        struct sched_slot *slot = &s->slot[i];
        if (slot->job)
            continue;
        fits = same_geometry(slot, count, g);
        // An empty one before one that serves another size.
        if (fits || !found || (found->prepared && !slot->prepared))
            found = slot;
    }
    assert(found); // no more are admitted than there are slots
    found->job = j;
    j->slot = found;
    if (!fits) {
        found->prepared = false;
        found->count = count;
        memcpy(found->geometry, g, count * sizeof g[0]);
    }
    return fits;
}

// Ends the job's time between OPEN and ENCODE.
static void slot_leave(struct sched *s, struct job *j)
{
    if (j->slot)
        j->slot->job = NULL;
    j->slot = NULL;
    s->admitted--;
    pthread_cond_broadcast(&s->pool_wake);
}

// ---- stages ----------------------------------------------------------------------------------------

static bool in_pipeline(enum job_stage stage) { return stage >= JOB_OPEN && stage <= JOB_ENCODE; }

static bool ending(const struct job *j) { return j->fault.code != FAULT_NONE || j->cancel; }

static void enter(struct sched *s, struct job *j, enum job_stage stage)
{
    if (in_pipeline((enum job_stage)j->stage) && !in_pipeline(stage))
        slot_leave(s, j);
    j->stage = stage;
    j->stage_ns = clock_ns();
    j->next_task = 0;
    if (j->wants_progress)
        event(s);
    if (stage == JOB_DONE) {
        s->running--;
        link_job(&s->done, j);
        event(s);
        return;
    }
    j->tasks = job_tasks(j);
    link_job(&s->stage[stage], j);
    if (job_stage_on_device(stage))
        pthread_cond_signal(&s->device_wake);
    else
        pthread_cond_broadcast(&s->pool_wake);
}

static enum job_stage next_stage(struct sched *s, struct job *j)
{
    switch ((enum job_stage)j->stage) {
    case JOB_OPEN:
        if (j->kind != JOB_BLOOMS)
            return j->kind == JOB_PLANS ? JOB_PLAN : JOB_FINISH;
        if (!slot_take(s, j))
            return JOB_PREPARE;
        job_bind(j, j->slot->in, j->slot->out);
        return JOB_DECODE;
    case JOB_PLAN: return JOB_FINISH;
    case JOB_PREPARE:
        job_bind(j, j->slot->in, j->slot->out);
        return JOB_DECODE;
    case JOB_DECODE: return JOB_BLOOM;
    case JOB_BLOOM: return JOB_BEGIN;
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

// The stage's last task is done, or the job is to end and none of its tasks runs.
static void advance(struct sched *s, struct job *j)
{
    for (;;) {
        note_time(j);
        enum job_stage next = ending(j) && j->stage != JOB_FINISH ? JOB_FINISH : next_stage(s, j);
        enter(s, j, next);
        // A stage may have no task at all: every chunk is copied as it is.
        if (next == JOB_DONE || j->tasks)
            return;
        unlink_job(&s->stage[next], j);
    }
}

// No more tasks of this stage are claimed.
static void withdraw(struct sched *s, struct job *j)
{
    if (j->linked)
        unlink_job(&s->stage[j->stage], j);
    j->next_task = j->tasks;
}

static struct job *claim_from(struct sched *s, enum job_stage stage, unsigned *task)
{
    struct job *j = TAILQ_FIRST(&s->stage[stage]);
    if (!j)
        return NULL;
    // Waiting for a thread is not the stage's time.
    if (j->next_task == 0)
        j->stage_ns = clock_ns();
    *task = j->next_task++;
    j->running++;
    if (j->next_task == j->tasks)
        unlink_job(&s->stage[stage], j);
    if (in_pipeline(stage))
        s->claimed++;
    return j;
}

// The turn goes on behind whoever was served: first the user, then the user's connection.
static struct job *fair_pop(struct sched *s)
{
    struct sched_user *u;
    TAILQ_FOREACH(u, &s->users, link)
    {
        struct sched_flow *flow;
        TAILQ_FOREACH(flow, &u->flows, of_user)
        {
            struct job *j = TAILQ_FIRST(&flow->waiting);
            if (!j)
                continue;
            unlink_job(&flow->waiting, j);
            TAILQ_REMOVE(&u->flows, flow, of_user);
            TAILQ_INSERT_TAIL(&u->flows, flow, of_user);
            TAILQ_REMOVE(&s->users, u, link);
            TAILQ_INSERT_TAIL(&s->users, u, link);
            return j;
        }
    }
    return NULL;
}

static void admit(struct sched *s, struct job *j)
{
    s->waiting--;
    s->running++;
    s->admitted++;
    j->admitted_ns = clock_ns();
    j->ms.queue = (double)(j->admitted_ns - j->accepted_ns) / 1e6;
    if (s->device_dead)
        fault_set(&j->fault, FAULT_DEVICE_LOST, "", "the Vulkan device was lost and could not be opened again");
    j->stage = JOB_OPEN;
    if (ending(j))
        enter(s, j, JOB_FINISH);
    else
        enter(s, j, JOB_OPEN);
}

struct job *sched_claim(struct sched *s, unsigned *task)
{
    static const enum job_stage latest_first[] = { JOB_ENCODE, JOB_BEGIN, JOB_DECODE, JOB_OPEN };
    struct job *j = claim_from(s, JOB_FINISH, task);
    if (j || s->hold)
        return j;
    for (size_t i = 0; i < sizeof latest_first / sizeof latest_first[0]; i++)
        if ((j = claim_from(s, latest_first[i], task)))
            return j;
    if (s->admitted >= s->slots || !s->waiting || !(j = fair_pop(s)))
        return NULL;
    admit(s, j);
    j = claim_from(s, JOB_FINISH, task);
    return j ? j : claim_from(s, JOB_OPEN, task);
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
    if (in_pipeline((enum job_stage)j->stage) && !job_stage_on_device((enum job_stage)j->stage) &&
        --s->claimed == 0)
        pthread_cond_broadcast(&s->quiet);
    j->running--;
    if (rc < 0)
        note_fault(j, task, f);
    if (ending(j))
        withdraw(s, j);
    if (!j->running && j->next_task == j->tasks)
        advance(s, j);
}

struct job *sched_device_next(struct sched *s)
{
    static const enum job_stage in_order[] = { JOB_PLAN, JOB_PREPARE, JOB_BLOOM };
    enum job_stage stage = JOB_BLOOM;
    struct job *j = NULL;
    for (size_t i = 0; i < sizeof in_order / sizeof in_order[0] && !j; i++)
        j = TAILQ_FIRST(&s->stage[stage = in_order[i]]);
    if (!j)
        return NULL;
    unlink_job(&s->stage[stage], j);
    j->next_task = j->tasks;
    j->running++;
    return j;
}

// The planes of every slot are gone with their device. Called with no task of the pipeline running.
void sched_rewind_all(struct sched *s, const struct fault *f)
{
    for (unsigned i = 0; i < s->slots; i++) {
        struct job *j = s->slot[i].job;
        s->slot[i].job = NULL;
        s->slot[i].prepared = false;
        if (!j)
            continue;
        withdraw(s, j);
        j->slot = NULL;
        if (j->retried || s->device_dead)
            note_fault(j, 0, f);
        if (ending(j)) {
            enter(s, j, JOB_FINISH);
            continue;
        }
        j->retried = true;
        job_rewind(j);
        enter(s, j, JOB_OPEN);
    }
}

// ---- from the socket thread --------------------------------------------------------------------------

int sched_flow_open(struct sched *s, struct sched_flow *flow, uid_t uid)
{
    *flow = (struct sched_flow){ 0 };
    TAILQ_INIT(&flow->waiting);
    pthread_mutex_lock(&s->lock);
    struct sched_user *u;
    TAILQ_FOREACH(u, &s->users, link)
    if (u->uid == uid)
        break;
    if (!u && (u = calloc(1, sizeof *u))) {
        u->uid = uid;
        TAILQ_INIT(&u->flows);
        TAILQ_INSERT_TAIL(&s->users, u, link);
    }
    if (u) {
        u->flows_open++;
        flow->user = u;
        TAILQ_INSERT_TAIL(&u->flows, flow, of_user);
    }
    pthread_mutex_unlock(&s->lock);
    return u ? 0 : -ENOMEM;
}

void sched_flow_close(struct sched *s, struct sched_flow *flow)
{
    struct sched_user *u = flow->user;
    if (!u)
        return;
    pthread_mutex_lock(&s->lock);
    assert(TAILQ_EMPTY(&flow->waiting));
    TAILQ_REMOVE(&u->flows, flow, of_user);
    if (--u->flows_open == 0) {
        TAILQ_REMOVE(&s->users, u, link);
        free(u);
    }
    flow->user = NULL;
    pthread_mutex_unlock(&s->lock);
}

void sched_submit(struct sched *s, struct sched_flow *flow, struct job *j)
{
    pthread_mutex_lock(&s->lock);
    j->accepted_ns = clock_ns();
    j->flow = flow;
    j->stage = JOB_WAITING;
    link_job(&flow->waiting, j);
    s->waiting++;
    pthread_cond_signal(&s->pool_wake);
    pthread_mutex_unlock(&s->lock);
}

void sched_cancel(struct sched *s, struct job *j)
{
    pthread_mutex_lock(&s->lock);
    enum job_stage stage = (enum job_stage)j->stage;
    bool was = atomic_exchange(&j->cancel, true);
    if (was || stage >= JOB_FINISH) {
        // already on its way out
    } else if (stage == JOB_WAITING) {
        // Freeing it is the pool's: it may hold a file whose close blocks.
        unlink_job(&j->flow->waiting, j);
        s->waiting--;
        s->running++;
        enter(s, j, JOB_FINISH);
    } else {
        withdraw(s, j);
        if (!j->running)
            advance(s, j);
    }
    j->flow = NULL;
    pthread_mutex_unlock(&s->lock);
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
    struct sched_counts c = { s->waiting, s->running, s->device_dead };
    pthread_mutex_unlock(&s->lock);
    return c;
}

const struct bloom_device_info *sched_device(struct sched *s) { return &s->device_info; }

// The threads are stopped first: the device may be asked by one thread at a time.
unsigned sched_validation_messages(struct sched *s)
{
    sched_threads_stop(s);
    return s->validation_messages + (s->bloom ? bloom_validation_messages(s->bloom) : 0);
}

// ---- life ------------------------------------------------------------------------------------------

int sched_create(struct sched **out, const struct sched_config *config, struct fault *f)
{
    struct sched *s = calloc(1, sizeof *s);
    if (!s)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the scheduler");
    pthread_mutex_init(&s->lock, NULL);
    pthread_cond_init(&s->pool_wake, NULL);
    pthread_cond_init(&s->device_wake, NULL);
    pthread_cond_init(&s->quiet, NULL);
    TAILQ_INIT(&s->users);
    TAILQ_INIT(&s->done);
    for (unsigned i = 0; i < JOB_STAGES; i++)
        TAILQ_INIT(&s->stage[i]);
    s->slots = config->slots;
    s->device = config->device;
    s->warm_idle = config->warm_idle;
    s->device.slots = config->slots;
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

void sched_destroy(struct sched *s)
{
    if (!s)
        return;
    sched_threads_stop(s);
    for (unsigned i = 0; i < JOB_STAGES; i++)
        queue_drop(&s->stage[i]);
    queue_drop(&s->done);
    bloom_destroy(s->bloom);
    if (s->event_fd >= 0)
        close(s->event_fd);
    pthread_cond_destroy(&s->quiet);
    pthread_cond_destroy(&s->device_wake);
    pthread_cond_destroy(&s->pool_wake);
    pthread_mutex_destroy(&s->lock);
    free(s);
}
