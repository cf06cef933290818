/* SPDX-License-Identifier: Apache-2.0 */
/*
 * airy.h - libairy, the C client of airyd. This header is its manual.
 *
 * A connection (struct airy) is used by one thread at a time; several connections may be used by
 * several threads. Requests are pipelined: submit as many as the credits allow, wait for any or for one.
 *
 *     struct airy *a;
 *     struct airy_error e;
 *     if (airy_connect(&a, NULL, &e) < 0) ...                        // socket of the system or the user
 *     struct airy_request r = AIRY_REQUEST_INIT;
 *     r.input_fd = open("in.exr", O_RDONLY);
 *     airy_request_param(&r, "threshold", "1.5", &e);
 *     uint64_t id;
 *     if (airy_submit(a, &r, &id, &e) < 0) ...
 *     struct airy_result *res;
 *     if (airy_wait(a, id, -1, &res, &e) < 0) ...                    // e.symbol "EXR_DAMAGED" ...
 *     write(out, res->data, res->size);
 *     airy_result_free(res);
 *
 * Functions return 0 (or as stated) on success and -1 on failure with *e filled; e may be NULL.
 * The library starts no threads, raises and handles no signals, prints nothing and has no global state.
 * It never maps what could be truncated under it, so that no peer can make it SIGBUS.
 */
#ifndef AIRY_H
#define AIRY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(AIRY_BUILD) && defined(__GNUC__)
#define AIRY_API __attribute__((visibility("default")))
#else
#define AIRY_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define AIRY_VERSION "0.1.0"

struct airy;
struct airy_result_private;
struct airy_wall_reply_private;

struct airy_error {
    int code;            /* PROTOCOL.md's table (100..599) from the daemon; -errno from this side;
                            -ECANCELED after a cancel */
    char symbol[32];     /* "PARAM_RANGE"; "LOCAL" from this side; "CANCELLED" */
    char field[64];      /* what it is about; may be empty */
    char text[384];      /* one sentence for people */
    bool retryable;
    uint32_t retry_after_ms;
};

/* ---- connection ------------------------------------------------------------------------------ */

/* path NULL: $AIRY_SOCKET, else $XDG_RUNTIME_DIR/airyd.sock, else /run/airyd/airyd.sock: the
 * first that answers. Blocks for at most 30 s. */
AIRY_API int airy_connect(struct airy **out, const char *path, struct airy_error *e);
/* Takes over a connected stream socket (closed on failure, too). Blocks for at most 30 s. */
AIRY_API int airy_connect_fd(struct airy **out, int fd, struct airy_error *e);
AIRY_API void airy_close(struct airy *a); /* NULL is fine; outstanding requests are dropped */

/* When the daemon goes away (it dies, or stops), a connection by airy_connect is made anew at the path that answered, and open requests are
 * sent again under the ids that they have: nobody has to know. That is tried for limit_ms without a daemon (30000 unless set; 0: never), with
 * growing pauses; then every open request ends in an error that is `retryable`, and the next submit tries anew. A connection by
 * airy_connect_fd never comes back.
 * Sent again is what may be: EXR and raw frames, plans and assets, whose descriptors the library keeps open until the end. Not
 * sent again, and ended with a retryable error: a frame with `show`; any frame for a wall when this connection has opened one without keep, as
 * it went with the connection; an output_fd that is the input's file, where it was (data in the mapping of an output_fd cannot be seen: do
 * not do that); requests from before limit_ms was set from 0. Progress then begins again, and a deadline goes on.
 * A request during which the daemon died three times ends in a retryable error that says so. After a death those that were in flight are
 * sent one at a time, and before all others: a frame that kills daemons costs that one frame.
 * The new daemon's limits are checked again (airy_limits says them). What else it had is gone: assets (requests then fail with NO_ASSET: send
 * the image, and submit anew) and walls. airy_status and airy_wall fail when the connection goes in their midst, and wait for it before.
 * BUSY is not tried again here: wait retry_after_ms, and submit anew. */
AIRY_API void airy_set_reconnect(struct airy *a, unsigned limit_ms);
/* 1, and one more each time that the connection was made anew. */
AIRY_API uint64_t airy_serial(const struct airy *a);

struct airy_limits {
    uint64_t max_frame_bytes, max_pixels, credit_bytes;
    uint32_t max_width, max_height, max_requests;
};
AIRY_API const char *airy_server(const struct airy *a);  /* "airyd/0.1.0" */
AIRY_API const char *airy_device(const struct airy *a);  /* Vulkan's name of the device */
AIRY_API const struct airy_limits *airy_limits(const struct airy *a);

/* For an event loop: poll airy_fd() for airy_events() (POLLIN, POLLOUT), then call airy_pump(), then
 * airy_wait_any(..., 0, ...) until it returns 0. airy_pump never blocks: 0, or -1 when the connection is
 * lost for good; airy_fd() is then -1, and results that came before can still be had. Until then airy_fd() stays the same, also while the
 * connection is made anew, which the same calls do; it is no socket then, and good for polling alone. */
AIRY_API int airy_fd(const struct airy *a);
AIRY_API short airy_events(const struct airy *a);
AIRY_API int airy_pump(struct airy *a, struct airy_error *e);

/* ---- requests ---------------------------------------------------------------------------------- */

enum airy_pixel { AIRY_HALF = 1, AIRY_FLOAT = 2 };

struct airy_channel {     /* of a raw picture; planar and interleaved pictures are lists of these */
    const char *name;     /* "R" "G" "B", or "Y" alone; others are copied unchanged */
    uint64_t offset;      /* byte of pixel (0,0) in the payload */
    uint64_t row_stride;  /* bytes */
    uint32_t pixel_stride; /* bytes */
};

enum { AIRY_CHANNELS_MAX = 8, AIRY_PARAMS_MAX = 64 };

struct airy_param { char name[32]; char value[512]; };

struct airy_request {
    /* Input: exactly one of data (sent inline, copied nowhere; it must stay until the submit's
     * request ended, or airy_close: it may be sent more than once) and input_fd (memfd sealed with F_SEAL_SHRINK, or a regular file;
     * stays the caller's, may be closed after airy_submit). The payload is the `size` bytes from
     * `offset` on; size 0 with a descriptor: all from offset on. */
    const void *data;
    int input_fd;
    uint64_t offset, size;

    /* An EXR file, unless width > 0: then raw pixels. */
    const char *part, *layer, *view;     /* NULL: the beauty of every colour part */
    const char *pixels, *compression;    /* NULL: keep */
    uint32_t width, height;
    enum airy_pixel type;
    struct airy_channel channels[AIRY_CHANNELS_MAX];
    unsigned n_channels;

    /* Output: a memfd made by the daemon (default), inline, or the caller's own memfd (raw only). */
    bool inline_output;
    int output_fd;                       /* -1: none; sealed with F_SEAL_SHRINK, writable */
    uint64_t output_offset, output_size;

    struct airy_param params[AIRY_PARAMS_MAX];
    unsigned n_params;
    /* Called from within airy_submit, airy_pump and the waits; must not use the connection. */
    void (*progress)(void *ctx, uint64_t id, const char *stage, double fraction);
    void *progress_ctx;

    bool plan_only;                      /* the result says what would run; it has no data */

    /* A frame for an open wall (below); NULL: none. With show it goes on the wall, and the result has no data; without, the
     * result is the wall's linear drive: height rows of width pixels of R, G, B, float32. */
    const char *wall;
    bool show;
    uint64_t present_ns;                 /* CLOCK_MONOTONIC: shown at the first tick from then on; 0: at the next tick */
    /* Raw pixels that are a part of a frame: the frame's size, and where the part's first pixel is. 0 0: they are the frame. */
    uint32_t frame_width, frame_height;
    int32_t frame_x, frame_y;

    int priority;                        /* -10 to 10, among the requests of this user */
    uint32_t deadline_ms;                /* longest wait for its turn, then it ends with DEADLINE; 0: none */
};
#ifdef __cplusplus
static inline struct airy_request airy_request_init()
{
    struct airy_request r = {};
    r.input_fd = r.output_fd = -1;
    return r;
}
#define AIRY_REQUEST_INIT airy_request_init()
#else
#define AIRY_REQUEST_INIT { .input_fd = -1, .output_fd = -1 }
#endif

/* Adds a parameter; the daemon validates it. Fails when full or too long. */
AIRY_API int airy_request_param(struct airy_request *r, const char *name, const char *value,
                       struct airy_error *e);
/* An anonymous shared-memory file of `size` bytes, sealed against shrinking and growing: the
 * fastest way in and out. Returns the descriptor (the caller's) and its mapping in *map (the
 * caller's to munmap), or -1. */
AIRY_API int airy_memfd(uint64_t size, void **map, struct airy_error *e);

/* Sends a request; *id is what to wait for. The strings and descriptors in *r are no longer needed when
 * it returns. Blocks while the connection has no credit or no request left (until earlier requests
 * end). While the connection is made anew, it is sent when that is done. Inline data that the socket does not take at once is sent by airy_pump and the waits. */
AIRY_API int airy_submit(struct airy *a, const struct airy_request *r, uint64_t *id, struct airy_error *e);
/* An image that requests name by digest: lens dirt (parameter dirt=DIGEST), a kernel (psf=image:DIGEST). */
struct airy_asset {
    char digest[40]; /* 32 hex digits */
    uint32_t width, height;
};
/* Sends an EXR file to be kept: exactly one of data (`size` bytes) and input_fd (as a request's; all of it). Blocks until
 * the daemon has it; requests that end meanwhile are had by the waits as always. The daemon may give it up when it is short of
 * room: a request then fails with NO_ASSET, and it is to be sent again. Sending what is kept costs little. */
AIRY_API int airy_asset(struct airy *a, int input_fd, const void *data, uint64_t size, struct airy_asset *out,
                        struct airy_error *e);
/* Asks to stop: the request then ends with symbol "CANCELLED", or as it would have, and is still to be
 * waited for. No harm when it has ended already. What no daemon has at the moment ends so at once. */
AIRY_API int airy_cancel(struct airy *a, uint64_t id, struct airy_error *e);

/* ---- results ----------------------------------------------------------------------------------- */

struct airy_target {
    const char *name, *plan, *rule;
    int32_t min_x, min_y;
    uint32_t width, height, levels, tiles, tiles_bright;
    bool untouched;
    double error_bound, max_bright;
    double energy_input, energy_bright, energy_bloomed, energy_lost;
    uint64_t nan, positive_inf, negative_inf, negative, saturated;
    bool any_nonfinite;
    int32_t first_x, first_y;
    const char *first_channel;
    const char *skipped;  /* what was not done, and why */
    const char *storage;  /* between the passes: "float" or "half" */
    double exposure;      /* stops in use */
    double predicted_ms;  /* device time by the daemon's own measurements */
    double energy_clamped, energy_suppressed; /* taken away by clamp and by firefly */
};

struct airy_region { int32_t x, y; uint32_t width, height; }; /* pixels of the display window, from its corner */

struct airy_times { double queue, load, decode, bloom, encode, total; }; /* ms */

struct airy_result {
    uint64_t id;
    const void *data;    /* the output, mapped read-only or received; NULL when output_fd or plan_only was given */
    uint64_t size;
    int fd;              /* the output's memfd, owned by the result; -1 when inline */
    const struct airy_target *targets;
    unsigned n_targets;
    struct airy_times ms;
    const char *device;
    uint32_t chunks, chunks_copied;
    const char *const *notes;
    unsigned n_notes;
    double exposure;
    struct airy_result_private *priv;
    bool has_need;           /* with a wall: */
    struct airy_region need; /* of the frame, what the wall's panels' light comes from, the glow's reach included */
    /* Of an EXR file: the string attribute "airy" that the output has (plan_only: would have); "": none. The same request on the
     * same bytes has the same stamp. */
    const char *stamp;
};

/* Waits for one request (or any, id 0; airy_wait_any also tells which failed). Each request is reported
 * once. timeout_ms -1: for ever, 0: only look. 1: done, *out is the caller's to free; 0: time-out; -1: the
 * request failed (or the connection), *e says how. */
AIRY_API int airy_wait(struct airy *a, uint64_t id, int timeout_ms, struct airy_result **out,
              struct airy_error *e);
/* The same for whichever request ends first; *id tells which (also on -1; 0: the connection, or
 * there is nothing to wait for). */
AIRY_API int airy_wait_any(struct airy *a, int timeout_ms, uint64_t *id, struct airy_result **out,
                  struct airy_error *e);
AIRY_API void airy_result_free(struct airy_result *r); /* NULL is fine */

/* ---- status ------------------------------------------------------------------------------------ */

enum { AIRY_STATUS_USERS_MAX = 256, AIRY_STATUS_STAGES_MAX = 8, AIRY_STATUS_BUCKETS_MAX = 24 };

struct airy_status_user { /* of one uid */
    uint32_t uid, connections, requests, queued, running, fds;
    uint64_t bytes; /* its inline payloads, and what its frames at work and unread results take */
    double device_ms;
};
struct airy_status_stage { /* requests done since the start, by time */
    char name[16];
    uint64_t counts[AIRY_STATUS_BUCKETS_MAX + 1]; /* the last of n_buckets + 1: longer than bucket_ms' last */
    double sum_ms;
};
struct airy_status_memory { /* bytes, by declared size; a daemon that does not tell: zeros */
    uint64_t ceiling, reserved, payloads, loads, work, work_peak, payloads_max, loads_max, work_max;
};

struct airy_status {
    char server[64], device[256], device_kind[8], driver[256];
    double uptime_s;
    uint32_t clients, queued, running;
    uint64_t done, failed, cancelled, pixels, bytes_in, bytes_out, rss_bytes;
    struct airy_times mean_ms;
    bool draining;
    uint32_t n_users;
    struct airy_status_user user[AIRY_STATUS_USERS_MAX];
    struct airy_status_memory memory;
    uint32_t n_buckets, n_stages;
    double bucket_ms[AIRY_STATUS_BUCKETS_MAX];
    struct airy_status_stage stage[AIRY_STATUS_STAGES_MAX];
    uint64_t loop_turns, refused_busy;
    double loop_worst_ms;
};
/* Answered at any load, beside whatever is in flight. A time-out is a failure (-ETIMEDOUT). */
AIRY_API int airy_status(struct airy *a, struct airy_status *out, int timeout_ms, struct airy_error *e);

/* ---- walls ------------------------------------------------------------------------------------- */

enum airy_wall_action {
    AIRY_WALL_LIST,    /* all walls, and the controllers that are plugged in; name: that wall alone */
    AIRY_WALL_OPEN,    /* a definition, airy-wall(5); the wall goes when this connection does, unless keep */
    AIRY_WALL_CLOSE,   /* black, then away */
    AIRY_WALL_PATTERN, /* a test pattern instead of frames; "" ends it */
    AIRY_WALL_PREVIEW, /* what was sent last */
};

struct airy_wall_request { /* strings: the caller's, not needed after the call; NULL is empty */
    enum airy_wall_action action;
    const char *name;        /* not of OPEN: the definition names the wall */
    const char *definition;  /* OPEN: text */
    const char *calibration; /* OPEN: airy_asset's digest of the image that the definition names */
    bool keep;               /* OPEN */
    const char *pattern;     /* PATTERN: order panels red green blue white ramp checker led black */
    const char *board;       /* PATTERN led: the board's name, */
    uint32_t led;            /* and the LED's number on it */
    double level;            /* PATTERN: linear, 0..1; 0: 0.25 */
};

struct airy_percentiles { double p50, p99, max; }; /* ms */

struct airy_wall_board {
    const char *name, *kind, *serial;
    const char *state;      /* "ready" "absent" "opening" "failed" */
    const char *problem, *path;
    uint64_t sent, dropped; /* frames wholly transferred; replaced by a newer one before that */
    uint64_t missed;        /* due while the board was not there */
    uint64_t stalls, timeouts, errors, losses;
    uint64_t rendered, received; /* by the board's own counters; 0: it has none */
    struct airy_percentiles latency_ms; /* bytes ready -> last transfer complete */
    double amps, amps_wanted; /* estimate of what is sent; before the limit */
};

struct airy_wall_supply {
    const char *name;
    double amps, amps_wanted, amps_limit; /* limit 0: none */
};

struct airy_wall_state {
    const char *name;
    uint32_t width, height, leds;
    double rate;
    const char *source;       /* "none" "live" "held" "fading" "black" "pattern" */
    double fps;               /* ticks of the last second */
    double frames_per_second; /* new pictures of the last second */
    uint64_t ticks, ticks_missed;
    struct airy_percentiles late_ms; /* of a tick against the absolute clock */
    struct airy_percentiles skew_ms; /* between the boards' last transfers of a tick */
    uint64_t frames, shown, dropped; /* pictures that came; shown; replaced by a newer one before their tick */
    double exposure;          /* stops in use */
    bool realtime;            /* the pacer runs with a real-time priority */
    const struct airy_wall_board *boards;
    unsigned n_boards;
    const struct airy_wall_supply *supplies;
    unsigned n_supplies;
};

struct airy_controller {      /* plugged in, of a kind that can be driven */
    const char *kind, *serial, *path;
    const char *wall;         /* that uses it; empty: none */
    const char *problem;      /* empty: none */
    bool reading;             /* its serial is being read: ask again */
};

struct airy_wall_reply {      /* owns all that it points to */
    const struct airy_wall_state *walls; /* OPEN, PATTERN, PREVIEW and a LIST by name: one */
    unsigned n_walls;
    const struct airy_controller *controllers;
    unsigned n_controllers;
    const char *usb;          /* why there is no USB; empty: there is */
    const uint8_t *preview;   /* PREVIEW: sRGB, walls[0].width * height * 3 bytes; else NULL */
    struct airy_wall_reply_private *priv;
};

/* Asks, and waits for the answer beside whatever is in flight; requests that end meanwhile are had by the waits as always. It costs
 * no credit. *out is the caller's to free. timeout_ms -1: for ever. A time-out is a failure (-ETIMEDOUT): what was asked may
 * still be done. A daemon without walls: -ENOTSUP. While
 * another wall is being closed (BUSY, a second at most) it asks again by itself. */
AIRY_API int airy_wall(struct airy *a, const struct airy_wall_request *q, int timeout_ms, struct airy_wall_reply **out,
                       struct airy_error *e);
AIRY_API void airy_wall_reply_free(struct airy_wall_reply *r); /* NULL is fine */

#ifdef __cplusplus
}
#endif
#endif
