// SPDX-License-Identifier: Apache-2.0
// walls.c - see walls.h.
#include "walls.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "metrics.h"

enum { CLAIM_MAX_S = 2, CLOSING_MS = 100 };

TAILQ_HEAD(wall_list, wall_ref);

struct walls {
    pthread_mutex_t lock;
    pthread_cond_t wake;
    struct wall_list open, closing; /* closing: without references, to be destroyed */
    unsigned count; // open, or not yet closed
    uint64_t gain_ids;
    struct asset_cache *assets;
    struct usb *usb;
    char why[320]; /* why there is none */
    bool usb_asked, stopping, started;
    pthread_t closer;
    void (*log)(const char *line);
};

// ---- closing ---------------------------------------------------------------------------------------

static void ref_free(struct wall_ref *r)
{
    wall_destroy(r->wall);
    asset_release(r->walls->assets, r->gains);
    free(r);
}

static void *closer_main(void *arg)
{
    struct walls *w = arg;
    pthread_mutex_lock(&w->lock);
    for (;;) {
        struct wall_ref *r = TAILQ_FIRST(&w->closing);
        if (!r && w->stopping)
            break;
        if (!r) {
            pthread_cond_wait(&w->wake, &w->lock);
            continue;
        }
        TAILQ_REMOVE(&w->closing, r, link);
        pthread_mutex_unlock(&w->lock);
        ref_free(r);
        pthread_mutex_lock(&w->lock);
        w->count--;
    }
    pthread_mutex_unlock(&w->lock);
    return NULL;
}

// Under the lock.
static void drop(struct walls *w, struct wall_ref *r)
{
    if (--r->references)
        return;
    TAILQ_INSERT_TAIL(&w->closing, r, link);
    pthread_cond_signal(&w->wake);
}

void walls_release(struct wall_ref *r)
{
    if (!r)
        return;
    struct walls *w = r->walls;
    pthread_mutex_lock(&w->lock);
    drop(w, r);
    pthread_mutex_unlock(&w->lock);
}

// Under the lock: it is no longer found, and goes when the last frame for it is done.
static void retire(struct walls *w, struct wall_ref *r)
{
    TAILQ_REMOVE(&w->open, r, link);
    r->closing = true;
    drop(w, r);
}

// ---- opening ---------------------------------------------------------------------------------------

struct usb *walls_usb(struct walls *w, const char **why)
{
    struct fault f = { .code = FAULT_NONE };
    if (!w->usb_asked && usb_create(&w->usb, w->log, &f) < 0) {
        w->usb = NULL;
        snprintf(w->why, sizeof w->why, "%s", f.text);
    }
    w->usb_asked = true;
    *why = w->usb ? "" : w->why;
    return w->usb;
}

static int gains_check(const struct wall_def *d, const struct asset *gains, struct fault *f)
{
    if (!*d->calibration)
        return gains ? fault_set(f, FAULT_WALL, "calibration", "an image came, and the definition names none") : 0;
    if (!gains)
        return fault_set(f, FAULT_WALL, "calibration", "the definition names %.100s: its digest expected (an asset)",
                         d->calibration);
    if (gains->image.width == d->width && gains->image.height == d->height)
        return 0;
    return fault_set(f, FAULT_WALL, "calibration", "%.100s has %u x %u pixels; the wall's %u x %u expected", d->calibration,
                     gains->image.width, gains->image.height, d->width, d->height);
}

static struct wall_ref *find(struct walls *w, const char *name)
{
    struct wall_ref *r;
    TAILQ_FOREACH(r, &w->open, link)
    if (!strcmp(r->def->name, name))
        break;
    return r;
}

static int room_check(struct walls *w, const char *name, struct fault *f)
{
    pthread_mutex_lock(&w->lock);
    const bool there = find(w, name) != NULL;
    unsigned open = 0;
    struct wall_ref *r;
    TAILQ_FOREACH(r, &w->open, link)
    open++;
    const bool closing = w->count > open;
    pthread_mutex_unlock(&w->lock);
    // Its boards, and its name in the figures, may be wanted again.
    if (closing) {
        fault_set(f, FAULT_BUSY, "wall", "a wall is being closed, which takes a second at most; try again");
        f->retry_after_ms = CLOSING_MS;
        return -1;
    }
    if (there)
        return fault_set(f, FAULT_WALL, "wall", "a wall \"%.64s\" is open; close it first", name);
    if (open >= WALLS_MAX)
        return fault_set(f, FAULT_LIMIT, "wall", "%u walls are open; at most %d are driven", open, WALLS_MAX);
    return 0;
}

static struct wall_ref *ref_make(struct walls *w, struct wall_def *d, struct fault *f)
{
    struct wall_ref *r = calloc(1, sizeof *r);
    const char *why;
    if (!r) {
        fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a wall");
        return NULL;
    }
    r->walls = w;
    if (wall_create(&r->wall, d, walls_usb(w, &why), w->log, f) < 0) {
        free(r);
        return NULL;
    }
    r->def = wall_definition(r->wall);
    r->layout = wall_layout(r->wall);
    r->adapt.up_s = d->adapt_up_s;
    r->adapt.down_s = d->adapt_down_s;
    r->references = 1;
    return r;
}

int walls_open(struct walls *w, const char *text, size_t bytes, struct asset *gains, const void *owner,
               struct wall_ref **out, struct fault *f)
{
    struct wall_def *d;
    if (wall_def_parse(&d, text, bytes, NULL, f) < 0)
        return -1;
    struct wall_ref *r = NULL;
    if (room_check(w, d->name, f) < 0 || gains_check(d, gains, f) < 0 || !(r = ref_make(w, d, f))) {
        wall_def_free(d);
        return -1;
    }
    if (gains) // it is kept, so it is found
        r->gains = asset_find(w->assets, gains->image.digest);
    r->owner = owner;
    pthread_mutex_lock(&w->lock);
    r->gain_id = ++w->gain_ids;
    TAILQ_INSERT_TAIL(&w->open, r, link);
    w->count++;
    pthread_mutex_unlock(&w->lock);
    *out = r;
    return 0;
}

// ---- finding ---------------------------------------------------------------------------------------

static void no_wall(struct walls *w, const char *name, struct fault *f)
{
    char names[200] = "";
    size_t n = 0;
    struct wall_ref *r;
    TAILQ_FOREACH(r, &w->open, link)
    {
        int more = snprintf(names + n, sizeof names - n, "%s\"%s\"", n ? ", " : "", r->def->name);
        n = more > 0 && n + (size_t)more < sizeof names ? n + (size_t)more : n;
    }
    fault_set(f, FAULT_NO_WALL, "wall.name", "no wall \"%.64s\" is open; %s%s", name, *names ? "open: " : "none is", names);
}

struct wall_ref *walls_find(struct walls *w, const char *name, struct fault *f)
{
    pthread_mutex_lock(&w->lock);
    struct wall_ref *r = find(w, name);
    if (r)
        r->references++;
    else
        no_wall(w, name, f);
    pthread_mutex_unlock(&w->lock);
    return r;
}

int walls_close(struct walls *w, const char *name, struct fault *f)
{
    pthread_mutex_lock(&w->lock);
    struct wall_ref *r = find(w, name);
    if (r)
        retire(w, r);
    else
        no_wall(w, name, f);
    pthread_mutex_unlock(&w->lock);
    return r ? 0 : -1;
}

void walls_client_gone(struct walls *w, const void *client)
{
    pthread_mutex_lock(&w->lock);
    struct wall_ref *r, *next;
    for (r = TAILQ_FIRST(&w->open); r; r = next) {
        next = TAILQ_NEXT(r, link);
        if (r->source == client)
            r->source = NULL;
        if (r->tester == client) {
            r->tester = NULL;
            wall_pattern(r->wall, &(struct wall_pattern){ .kind = PATTERN_NONE }, NULL);
        }
        if (r->owner == client)
            retire(w, r);
    }
    pthread_mutex_unlock(&w->lock);
}

int walls_claim(struct wall_ref *r, const void *client, struct fault *f)
{
    const uint64_t now = clock_ns();
    const double keeps_s = fmin(r->def->hold_s, CLAIM_MAX_S);
    if (r->source && r->source != client && (double)(now - r->source_ns) < keeps_s * 1e9) {
        fault_set(f, FAULT_WALL_BUSY, "wall.name", "another client's frames are on wall \"%.64s\"; they are let go %.1f s after their last",
                  r->def->name, keeps_s);
        f->retry_after_ms = (uint32_t)(keeps_s * 1e3);
        return -1;
    }
    r->source = client;
    r->source_ns = now;
    return 0;
}

unsigned walls_list(struct walls *w, struct wall_ref *out[WALLS_MAX])
{
    unsigned n = 0;
    pthread_mutex_lock(&w->lock);
    struct wall_ref *r;
    TAILQ_FOREACH(r, &w->open, link)
    out[n++] = r;
    pthread_mutex_unlock(&w->lock);
    return n;
}

// A struct params is zeroed before it is set, so equal requests are equal bytes; if not, the need is worked out again.
static bool same_kind(const struct wall_need *a, const struct wall_need *b)
{
    return a->width == b->width && a->height == b->height && a->display_width == b->display_width && a->channels == b->channels &&
           a->pixel_aspect == b->pixel_aspect && a->x == b->x && a->y == b->y && !memcmp(&a->params, &b->params, sizeof a->params);
}

bool walls_need_known(struct wall_ref *r, struct wall_need *like)
{
    pthread_mutex_lock(&r->walls->lock);
    const bool known = r->need.known && same_kind(&r->need, like);
    if (known)
        memcpy(like->part, r->need.part, sizeof like->part);
    pthread_mutex_unlock(&r->walls->lock);
    return known;
}

void walls_need_note(struct wall_ref *r, const struct wall_need *need)
{
    pthread_mutex_lock(&r->walls->lock);
    r->need = *need;
    r->need.known = true;
    pthread_mutex_unlock(&r->walls->lock);
}

// ---- geometry --------------------------------------------------------------------------------------

void walls_geometry(const struct wall_ref *r, uint32_t width, uint32_t height, float pixel_aspect, struct bloom_wall *b)
{
    const struct wall_def *d = r->def;
    // The shown window of the frame, in its pixels, and how many of them a wall pixel has across and down.
    const double x = d->window[0] * width, y = d->window[1] * height;
    const double w = d->window[2] * width, h = d->window[3] * height;
    double across = w / d->width, down = h / d->height;
    if (d->fit != WALL_STRETCH) {
        // In heights of a pixel, so that circles stay round.
        const double tall = across * (double)pixel_aspect;
        const double pitch = d->fit == WALL_FILL ? fmin(tall, down) : fmax(tall, down);
        across = pitch / (double)pixel_aspect;
        down = pitch;
    }
    *b = (struct bloom_wall){
        .width = d->width, .height = d->height,
        .first_x = r->layout->x0, .first_y = r->layout->y0, .end_x = r->layout->x1, .end_y = r->layout->y1,
        .x = x + (w - across * d->width) / 2, .y = y + (h - down * d->height) / 2, .pitch_x = across, .pitch_y = down,
        .frame_width = width, .frame_height = height,
        .tone_map = d->tone_map == WALL_TONE_ACES ? DISPLAY_ACES : d->tone_map == WALL_TONE_REINHARD ? DISPLAY_REINHARD : DISPLAY_NONE,
        .saturation = d->saturation,
        .gain = r->gains ? r->gains->image.rgb : NULL, .gain_id = r->gains ? r->gain_id : 0,
    };
    memcpy(b->matrix, d->matrix, sizeof b->matrix);
}

// ---- life ------------------------------------------------------------------------------------------

int walls_create(struct walls **out, struct asset_cache *assets, void (*log)(const char *line), struct fault *f)
{
    struct walls *w = calloc(1, sizeof *w);
    if (!w)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for walls");
    pthread_mutex_init(&w->lock, NULL);
    pthread_cond_init(&w->wake, NULL);
    TAILQ_INIT(&w->open);
    TAILQ_INIT(&w->closing);
    w->assets = assets;
    w->log = log;
    int error = pthread_create(&w->closer, NULL, closer_main, w);
    w->started = !error;
    if (error) {
        walls_destroy(w);
        return fault_set(f, FAULT_INTERNAL, "", "starting a thread: %s", strerror(error));
    }
    *out = w;
    return 0;
}

void walls_destroy(struct walls *w)
{
    if (!w)
        return;
    pthread_mutex_lock(&w->lock);
    struct wall_ref *r;
    while ((r = TAILQ_FIRST(&w->open)))
        retire(w, r);
    w->stopping = true;
    pthread_cond_signal(&w->wake);
    pthread_mutex_unlock(&w->lock);
    if (w->started)
        pthread_join(w->closer, NULL);
    usb_destroy(w->usb);
    pthread_cond_destroy(&w->wake);
    pthread_mutex_destroy(&w->lock);
    free(w);
}
