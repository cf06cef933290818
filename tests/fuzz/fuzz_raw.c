// SPDX-License-Identifier: Apache-2.0
//
// fuzz_raw.c - raw.c: any layout of a raw picture, over a payload of exactly the bytes that it says.
//
// What is checked: after raw_check nothing leaves the payload (AddressSanitizer looks), and a picture that was decoded and
// encoded again is what it was, byte for byte.
#include "fuzz.h"
#include "raw.h"

enum { SIDE_MAX = 300, PIXELS_MAX = 1 << 14, PAYLOAD_MAX = 1 << 18 };

static void read_layout(struct raw_layout *l, struct fuzz_in *in, uint8_t way)
{
    static const char *const names[] = { "R", "G", "B", "Y", "Z", "glow.R", "glow.G", "glow.B", "glow.Y", "mask", "A", "" };
    l->width = fuzz_u16(in);
    l->height = fuzz_u16(in);
    l->type = (enum pixel_type)(way & 3);
    l->source = way & 4 ? "glow" : way & 8 ? "" : NULL;
    l->matte = way & 16 ? "mask" : way & 8 ? "" : NULL;
    l->depth = way & 32;
    l->count = fuzz_u8(in) % (RAW_CHANNELS_MAX + 1);
    for (unsigned i = 0; i < l->count; i++) {
        struct raw_channel *c = &l->channel[i];
        const uint8_t shape = fuzz_u8(in);
        const unsigned bytes = shape & 64 ? 8 : 2;
        strcpy(c->name, names[(shape & 15) % (sizeof(names) / sizeof(*names))]);
        c->offset = fuzz_number(in, bytes);
        c->row_stride = fuzz_number(in, bytes);
        c->pixel_stride = fuzz_number(in, shape & 64 ? 8 : 1);
    }
}

static void run(const struct raw_layout *l, const uint8_t *payload, size_t bytes)
{
    static const float luma[3] = { 0.25f, 0.5f, 0.25f };
    struct planes planes[RAW_ROLES];
    struct frame_scan scan[RAW_ROLES];
    uint8_t *out = malloc(bytes);
    must(out && l->targets >= 1 && l->targets <= RAW_ROLES && l->target[0].role == RAW_SCENE);
    memcpy(out, payload, bytes);
    for (unsigned t = 0; t < l->targets; t++) {
        must(!planes_alloc(&planes[t], l->width, l->height, l->target[t].planes, l->target[t].type));
        must(!frame_scan_init(&scan[t], l->width, l->height));
        for (unsigned i = 0; i < raw_tasks(l); i++)
            raw_decode(l, &l->target[t], payload, &planes[t], &scan[t], luma, i);
    }
    for (unsigned i = 0; i < raw_tasks(l); i++)
        must(raw_encode(l, payload, &planes[0], out, i) == 0);
    must(!memcmp(out, payload, bytes));
    for (unsigned t = 0; t < l->targets; t++) {
        frame_scan_finish(&scan[t]);
        planes_free(&planes[t]);
    }
    free(out);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    struct fault f = { .code = FAULT_NONE };
    struct raw_layout l = { 0 };
    const uint8_t way = fuzz_u8(&in);
    const uint64_t bytes = way & 128 ? fuzz_number(&in, 8) : fuzz_number(&in, 3);
    read_layout(&l, &in, way);
    if (l.width > SIDE_MAX || l.height > SIDE_MAX || (uint64_t)l.width * l.height > PIXELS_MAX)
        return 0; // the caller of raw_check refuses what is above its limits
    if (raw_check(&l, bytes, &f) < 0) {
        must(f.code != FAULT_NONE && *f.field && *f.text);
        return 0;
    }
    if (bytes > PAYLOAD_MAX)
        return 0;
    uint8_t *payload = malloc(bytes);
    must(payload);
    for (uint64_t i = 0; i < bytes; i++)
        payload[i] = in.left ? in.at[i % in.left] : (uint8_t)i;
    run(&l, payload, bytes);
    free(payload);
    return 0;
}
