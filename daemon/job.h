/* SPDX-License-Identifier: Apache-2.0 */
/*
 * job.h - one frame in flight, and the work of each of its stages.
 *
 *     UPLOAD    socket thread   inline bytes come in
 *     WAITING   sched's queues  the fair ones
 *     OPEN      pool            the bytes are read or mapped, the headers parsed, the targets chosen; an upload that
 *                               is to be kept is decoded, and ends here
 *     PLAN      device thread   of a request that wants only the plan, which ends here; of a wall's, when it is not known
 *                               yet which part of such a frame the wall shows
 *     PREPARE   device thread   planes of the right size (skipped when a slot has them already)
 *     DECODE    pool, n tasks
 *     BLOOM     device thread
 *     BEGIN     pool            the encoder's start; a raw result's memory (a wall's frame ends with BLOOM: it is shown, or
 *                               its drive is the result)
 *     ENCODE    pool, n tasks
 *     FINISH    pool            the file is put together, everything but the reply's material freed;
 *                               also where a job that failed or was cancelled comes to be freed
 *     DONE      socket thread   replied to, destroyed
 *
 * A job has one owner at a time and moves by sched's queues, under sched's lock. The tasks of a stage are
 * shared out; a stage's functions touch only what is theirs, so that the tasks of one stage may run at
 * once. The only field that is written from elsewhere is `cancel`.
 *
 * A target is what has planes: scenes, which are bloomed and reported, and what is only read for their glow.
 */
#ifndef AIRYD_JOB_H
#define AIRYD_JOB_H

#include <stdatomic.h>
#include <sys/queue.h>

#include "asset.h"
#include "block.h"
#include "bloom.h"
#include "exr.h"
#include "metrics.h"
#include "params.h"
#include "payload.h"
#include "raw.h"
#include "walls.h"

enum job_stage {
    JOB_UPLOAD,
    JOB_WAITING,
    JOB_OPEN,
    JOB_PLAN,
    JOB_PREPARE,
    JOB_DECODE,
    JOB_BLOOM,
    JOB_BEGIN,
    JOB_ENCODE,
    JOB_FINISH,
    JOB_DONE,
    JOB_STAGES
};

enum job_kind { JOB_BLOOMS, JOB_PLANS, JOB_KEEPS };
enum job_output { JOB_OUTPUT_INLINE, JOB_OUTPUT_MEMFD, JOB_OUTPUT_BUFFER, JOB_OUTPUT_NONE, JOB_OUTPUT_WALL };

enum { JOB_NOTES_MAX = 8, JOB_NOTE_MAX = 160, JOB_STAMP_MAX = PARAMS_LINE_MAX + 192 };

struct job_limits {
    uint64_t max_frame_bytes; /* a payload, either way */
    struct exr_limits exr;    /* raw pictures are held to the same sizes */
};

struct job_env { /* what all jobs share; constant */
    struct job_limits limits;
    struct block_pool *blocks;
    struct asset_cache *assets;
    struct walls *walls;
};

struct job_target { /* what the reply says of a scene */
    char name[256];
    int32_t min_x, min_y;
    uint32_t width, height;
    unsigned channels;
    struct bloom_reply bloom;
    double energy_input;
    uint64_t nan, positive_inf, negative_inf, negative, first_nonfinite;
};

struct job_wall { /* of a frame for a wall */
    uint64_t present_ns;             /* CLOCK_MONOTONIC; 0: at the next tick */
    /* The frame that the target is a part of, and where: the request's for raw pictures, else the target itself. */
    uint32_t frame_width, frame_height;
    int32_t x, y;
    uint32_t whole_width, whole_height, crop_x, crop_y; /* of a raw picture: as it came, and what is left out of it */
    struct bloom_wall geometry;      /* as if the frame were the target; from OPEN on */
    int32_t corner[2];               /* of the frame in the display window */
    bool placed;                     /* the target is cut to need */
    bool has_need;
    int32_t need[4];                 /* x0, y0, x1, y1 of the frame */
    struct block *drive;
};

struct sched_flow;
struct sched_user;
struct sched_slot;
struct client;
struct client_host;

struct job {
    /* The client's; constant from the submit on. */
    struct client *client; /* NULL: gone */
    struct client_host *host;
    uint64_t input_held; /* bytes that count against the host's */
    uint64_t id;
    TAILQ_ENTRY(job) of_client;
    enum job_kind kind;
    struct params params;
    struct asset *dirt, *kernel; /* references; NULL: none */
    bool walled;                 /* a frame for a wall */
    struct wall_ref *wall;       /* a reference, until FINISH; NULL: no wall's frame */
    struct job_wall of_wall;
    bool raw;
    struct raw_layout layout;
    char part[256], layer[256], view[256];
    struct exr_options exr_options;
    char extra_name[PARAMS_LAYERS_MAX][32]; /* of exr_options */
    enum job_output output_kind;
    struct payload input, output;
    uint64_t received, credit_bytes, upload_ns; /* inline: so far; held; last progress */
    bool wants_progress, overrun; /* overrun: more came than was announced */
    int progress_sent; /* the last stage told, -1: none */
    int priority;         /* -10 .. 10, among its user's */
    uint32_t deadline_ms; /* 0: none; from the submit on, for what waits */

    /* sched's, under its lock. */
    struct sched_user *user;       /* whom it counts for; NULL: nobody yet */
    unsigned fds_held;
    uint64_t load_held, work_held; /* of sched's room */
    uint64_t work_known;           /* what it will need of work; 0: not known before it is opened */
    double units, charged_ms;      /* how large it is said to be, and what its turn was reckoned at */
    uint64_t deadline_ns;
    bool parked;                   /* opened, and waits for room */
    bool passes;                   /* goes before others that are at work */
    bool keeping;                  /* the one that keeps an image now */
    const struct job_env *env;
    TAILQ_ENTRY(job) link;
    bool linked; /* in a queue by `link` */
    TAILQ_ENTRY(job) of_order; /* a wall's: of those not yet bloomed */
    bool ordered;
    struct sched_flow *flow;
    struct sched_slot *slot;
    unsigned tasks, next_task, running;
    unsigned fault_task;
    bool retried;
    struct fault fault; /* code FAULT_NONE: none so far */
    uint64_t accepted_ns, admitted_ns, stage_ns;
    _Atomic int stage; /* enum job_stage; read by the socket thread for PROGRESS */
    _Atomic bool cancel;

    /* The work. */
    struct exr *exr;
    char stamp[JOB_STAMP_MAX];
    struct frame_scan raw_scan[RAW_ROLES]; /* raw only, of each target; tile_luma NULL: none */
    struct planes raw_in[RAW_ROLES], raw_out;
    unsigned n_targets;
    bool untouched[BLOOM_TARGETS_MAX];
    _Atomic uint64_t raw_saturated;

    /* The reply's material. */
    bool finished; /* a result; else `fault` says why not, else it was cancelled */
    unsigned n_scenes;
    struct job_target scene[BLOOM_TARGETS_MAX];
    struct bloom_image kept; /* of an upload; its pixels are the cache's: not to be looked at */
    struct exr_counts counts;
    unsigned n_notes;
    char note[JOB_NOTES_MAX][JOB_NOTE_MAX];
    struct stage_times ms;
    uint64_t input_bytes;
};
TAILQ_HEAD(job_queue, job);

struct job *job_create(const struct job_env *env); /* NULL: no memory */
void job_destroy(struct job *j);                   /* owner: socket thread; NULL is fine */

bool job_stage_on_device(enum job_stage s);
/* Tasks of the stage that the job is in. Cheap. */
unsigned job_tasks(const struct job *j);
/* Runs one. 0, or -1 and *f. */
int job_task(struct job *j, unsigned task, struct exr_worker *w, struct fault *f);

/* After OPEN: must PLAN come before the planes are known? */
bool job_wants_plan(const struct job *j);
/* After OPEN: what planes are needed. Returns their number. */
unsigned job_geometry(const struct job *j, struct bloom_geometry g[BLOOM_TARGETS_MAX]);
/* After OPEN: bytes that it takes beside its planes until it is done, its result's included. Never less than what it will take. */
uint64_t job_work_bytes(const struct job *j);
/* After OPEN: the attribute that the output file has; "" when it has none. The job's. */
const char *job_stamp(const struct job *j);
/* After OPEN: what the engine will keep for it beside its planes, at most; threads: the engine's. */
void job_keep_bytes(const struct job *j, unsigned threads, uint64_t bytes[BLOOM_KEEPS]);
/* Hands the planes of the job's slot to the decoder and encoder. */
void job_bind(struct job *j, const struct planes *in, const struct planes *out);
/* PLAN and BLOOM, all scenes. */
int job_plan(struct job *j, struct bloom *b, struct fault *f);
int job_bloom(struct job *j, struct bloom *b, struct bloom_slot *s, struct fault *f);
/* job_wall.c. What is asked for fits a wall: 0, or -1 and *f. */
int job_wall_check(const struct job *j, struct fault *f);
/* In OPEN, with targets: where the frame lies on the wall; cut to what the wall needs when that is known from a frame like it. */
int job_wall_open(struct job *j, struct fault *f);
/* In PLAN: cut to what it needs. */
int job_wall_plan(struct job *j, struct bloom *b, struct fault *f);
/* In BLOOM: the request's wall, with room for the drive in *w; then the picture goes to its wall, or into the result. */
int job_wall_begin(struct job *j, struct bloom_wall *w, struct bloom_adapt *adapt, struct fault *f);
void job_wall_end(struct job *j, const struct bloom_adapt *adapt, const struct bloom_reply *reply);
/* In FINISH: the result's payload. */
int job_wall_finish(struct job *j, struct fault *f);
void job_wall_release(struct job *j); /* all but the result */
void job_wall_rewind(struct job *j);

/* Back to before OPEN, the input's bytes kept: its planes are lost with their device. */
void job_rewind(struct job *j);
/* ... and without what was read of a descriptor: it holds no memory of its size until it is opened again. */
void job_unload(struct job *j);

#endif
