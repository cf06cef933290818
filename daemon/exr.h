/* SPDX-License-Identifier: Apache-2.0 */
/*
 * exr.h - EXR bytes <-> targets. Knows OpenEXR, knows no Vulkan.
 *
 * One struct exr per request. Its life:
 *     exr_open      parse headers, apply limits, choose the targets (part, layer, view)
 *     exr_bind      give each target its input planes (written here) and output planes (read here)
 *     exr_decode    tasks 0 .. exr_decode_tasks()-1, any order, any threads, each once
 *     (the bloom runs: output planes get their pixels)
 *     exr_encode_begin, exr_encode tasks likewise, exr_assemble
 * Every container detail that need not change is carried over byte for byte: header attributes (also
 * of unknown type) in their order, parts, untouched channels, chunks whose pixels did not change
 * (copied compressed). A target whose output equals its input bit for bit changes no chunk.
 *
 * Untrusted input: the caller's bytes may say anything; all limits are checked in exr_open before
 * memory is taken. Faults name what was found and what was expected.
 */
#ifndef AIRYD_EXR_H
#define AIRYD_EXR_H

#include "fault.h"
#include "frame.h"

struct exr;
struct exr_worker; /* one per codec thread: libdeflate state, pipelines, scratch; reused for ever */

struct exr_limits {
    uint32_t max_width, max_height; /* of any part's data window */
    uint64_t max_pixels;            /* of one part */
    uint64_t max_decoded_bytes;     /* all decoded parts together */
};

struct exr_select {
    const char *part;  /* NULL or "": every part that has the layer; else number or name */
    const char *layer; /* NULL or "": unprefixed R,G,B (else Y, or Y RY BY) of each view; else prefix */
    const char *view;  /* NULL or "": all views; else one name of multiView / the part's view */
    /* What the glow needs beside the layer, of the same part (or one with the same data window): NULL or "":
     * nothing. Each becomes a target that is only read. */
    const char *source; /* a layer with as many channels; it may be a part's name, whose unprefixed channels are it */
    const char *matte;  /* a channel's full name. UINT samples count as numbers: 1 is full cover */
    bool depth;         /* channel Z of the layer, or of the view, or of the part, when there is one */
};

enum exr_compression { /* the file format's numbers */
    EXR_KEEP = -1, EXR_NONE = 0, EXR_RLE, EXR_ZIPS, EXR_ZIP, EXR_PIZ, EXR_PXR24, EXR_B44, EXR_B44A,
    EXR_DWAA, EXR_DWAB
};
int exr_compression_parse(const char *word); /* "keep" "zip" ...; INT_MIN when unknown */

enum exr_pixels { EXR_PIXELS_KEEP = 0, EXR_PIXELS_HALF, EXR_PIXELS_FLOAT };

struct exr_options {
    int compression;        /* enum exr_compression */
    enum exr_pixels pixels; /* of the bloomed channels in the output */
    const char *stamp;      /* value of the added string attribute "airy"; NULL adds none */
    unsigned extras;        /* at most 7 layers that the parts of scene targets get: "airy.<name>.R" ... beside R, G, B; in
                               a layer or view "X.", "X.airy.<name>.R" */
    const char *extra_name[7]; /* the caller's, until exr_close */
};

enum exr_role { EXR_SCENE, EXR_SOURCE, EXR_MATTE, EXR_DEPTH };

struct exr_target {
    enum exr_role role;  /* EXR_SCENE is bloomed and written; the others are only read, and come after all scenes */
    int source, matte, depth; /* of a scene: indices of its other targets, -1: none; scenes may share them */
    char name[256];      /* "beauty", "part 1 (right)", "left" ...: for people */
    unsigned part;
    int32_t min_x, min_y; /* data window's corner */
    uint32_t width, height;
    unsigned channels;   /* 3, or 1 for luminance alone */
    enum pixel_type type; /* of the planes: HALF only when all its channels are HALF and none is
                             subsampled or recombined from luminance-chroma; else FLOAT */
    float luma[3];       /* relative luminance weights from chromaticities, else Rec.709; of a source: its scene's */
    float pixel_aspect;
    int32_t display_x, display_y; /* display window */
    uint32_t display_width, display_height;
    uint32_t grow;       /* set by the caller after exr_open, before exr_bind: pixels by which the data window of the
                            target's part grows on each side; equal for all scenes of a part */
    struct frame_scan scan; /* filled by decode tasks */
};

/*
 * bytes must stay as they are until exr_close. 0, or -1 and *f. Deep parts that are selected,
 * absent parts, layers and views are faults; deep parts beside the selected ones are carried over.
 */
int exr_open(struct exr **out, const void *bytes, uint64_t size, const struct exr_limits *limits,
             const struct exr_select *select, const struct exr_options *options, struct fault *f);
void exr_close(struct exr *x); /* NULL is fine */

unsigned exr_target_count(const struct exr *x);
struct exr_target *exr_target(struct exr *x, unsigned i);

/* Only the pixels x0 <= x < x1, y0 <= y < y1 of the target's window are wanted (not empty, within it), of it and of what is read for it:
 * their corner, size and scan become the part's. For who only reads: nothing can be encoded after it. Once, before exr_bind; not for
 * luminance-chroma, whose rows are made of neighbours (0: all stays as it was). 1: cropped; 0; -1 and *f. */
int exr_crop(struct exr *x, unsigned target, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1, struct fault *f);

/* With the targets' grow: bytes that the codec and the output file take at most until exr_close. */
uint64_t exr_work_bytes(const struct exr *x);

/* Whether the output can have the targets' grow: 0, or -1 and *f. exr_encode_begin asks, too; who asks before
 * it takes memory for the planes takes none in vain. */
int exr_grow_check(const struct exr *x, struct fault *f);

/* in: planes of the target's size and type, zero beyond the width; out: 1 + extras of them (NULL where the target
 * is only read), same geometry plus grow on each side, read by the encode tasks. Their type may be FLOAT where in is HALF
 * (saturation is then counted here). Both stay
 * as they are from the bloom to the last encode task: luminance-chroma compares them. */
void exr_bind(struct exr *x, unsigned target, const struct planes *in, const struct planes *out);

unsigned exr_decode_tasks(const struct exr *x);
int exr_decode(struct exr *x, unsigned task, struct exr_worker *w, struct fault *f);

/* untouched[i]: target i's output is its input; its output plane 0 is not looked at (extra layers are). Of targets
 * that are only read, it says nothing. */
int exr_encode_begin(struct exr *x, const bool *untouched, struct fault *f);
unsigned exr_encode_tasks(const struct exr *x);
int exr_encode(struct exr *x, unsigned task, struct exr_worker *w, struct fault *f);

/* The whole output file: size known after all encode tasks; write is called with consecutive pieces
 * (return 0 or -errno to stop). */
uint64_t exr_assembled_bytes(const struct exr *x);
int exr_assemble(struct exr *x, int (*write)(void *ctx, const void *data, size_t len), void *ctx,
                 struct fault *f);

struct exr_counts {
    uint32_t chunks, chunks_copied;
    uint64_t saturated; /* samples held at +-65504 in a HALF output */
};
struct exr_counts exr_counts(const struct exr *x);
unsigned exr_note_count(const struct exr *x); /* "preview dropped", ... */
const char *exr_note(const struct exr *x, unsigned i);

/* Memory of chunks that is kept for the next file, of the whole process (512 MiB). Before the first file. */
void exr_cache_limit(uint64_t bytes);

int exr_worker_create(struct exr_worker **out); /* 0 or -errno */
void exr_worker_destroy(struct exr_worker *w);

#endif
