// SPDX-License-Identifier: Apache-2.0
// wire.c - the header, byte by byte, so that neither alignment nor the machine's order matters.
#include "wire.h"

#include <inttypes.h>

static void put_u32(uint8_t *out, uint32_t v)
{
    for (unsigned i = 0; i < 4; i++)
        out[i] = (uint8_t)(v >> 8 * i);
}

static uint32_t get_u32(const uint8_t *in)
{
    return in[0] | (uint32_t)in[1] << 8 | (uint32_t)in[2] << 16 | (uint32_t)in[3] << 24;
}

struct type_row {
    const char *name;
    char who;
    uint8_t fds_max;
};

static const struct type_row *type_row(unsigned type)
{
    static const struct type_row rows[] = {
#define X(number, name, who, fds) [number] = { #name, who, fds },
        WIRE_TYPES(X)
#undef X
    };
    if (type >= sizeof(rows) / sizeof(rows[0]) || !rows[type].name)
        return NULL;
    return &rows[type];
}

const char *wire_type_name(enum wire_type t)
{
    const struct type_row *row = type_row((unsigned)t);
    return row ? row->name : "UNKNOWN";
}

void wire_encode(uint8_t out[WIRE_HEADER_BYTES], const struct wire_header *h)
{
    put_u32(out, WIRE_MAGIC);
    out[4] = WIRE_VERSION;
    out[5] = (uint8_t)h->type;
    out[6] = h->n_fds;
    out[7] = h->flags;
    put_u32(out + 8, h->body_bytes);
    put_u32(out + 12, 0);
    put_u32(out + 16, (uint32_t)h->id);
    put_u32(out + 20, (uint32_t)(h->id >> 32));
}

int wire_decode(struct wire_header *h, const uint8_t in[WIRE_HEADER_BYTES], enum wire_end sender,
                struct fault *f)
{
    uint32_t magic = get_u32(in), body_bytes = get_u32(in + 8), reserved = get_u32(in + 12);
    if (magic != WIRE_MAGIC)
        return fault_set(f, FAULT_BAD_MAGIC, "header.magic",
                         "the header starts with 0x%08" PRIx32 ", expected 0x%08" PRIx32, magic,
                         WIRE_MAGIC);
    if (in[4] != WIRE_VERSION)
        return fault_set(f, FAULT_BAD_VERSION, "header.version",
                         "the header's version is %u, this end speaks %u", in[4], WIRE_VERSION);
    const struct type_row *row = type_row(in[5]);
    if (!row)
        return fault_set(f, FAULT_UNEXPECTED, "header.type", "no message has type %u", in[5]);
    if (row->who != 'B' && row->who != (char)sender)
        return fault_set(f, FAULT_UNEXPECTED, "header.type", "%s is not a %s's to send", row->name,
                         sender == WIRE_CLIENT ? "client" : "daemon");
    uint32_t max = in[5] == WIRE_DATA ? WIRE_DATA_BYTES_MAX : WIRE_CONTROL_BYTES_MAX;
    if (body_bytes > max)
        return fault_set(f, FAULT_TOO_LONG, "header.body_bytes",
                         "the body of %s is %" PRIu32 " bytes, at most %" PRIu32 " are allowed",
                         row->name, body_bytes, max);
    if (in[6] > row->fds_max)
        return fault_set(f, FAULT_BAD_FDS, "header.n_fds",
                         "%s says that it brings %u descriptors, at most %u are allowed", row->name,
                         in[6], row->fds_max);
    if (in[7])
        return fault_set(f, FAULT_BAD_BODY, "header.flags", "flags are 0x%02x, expected 0", in[7]);
    if (reserved)
        return fault_set(f, FAULT_BAD_BODY, "header.reserved",
                         "the reserved bytes are 0x%08" PRIx32 ", expected 0", reserved);
    *h = (struct wire_header){
        .type = in[5],
        .n_fds = in[6],
        .body_bytes = body_bytes,
        .id = get_u32(in + 16) | (uint64_t)get_u32(in + 20) << 32,
    };
    return 0;
}
