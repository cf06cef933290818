// SPDX-License-Identifier: Apache-2.0
//
// make_vectors.c - writes proto/vectors: for each example message NAME.hex (the bytes on the wire) and
// NAME.json (what they mean; the body in protobuf's JSON mapping). NAME begins with "bad_" when a
// receiver must refuse it.
//
//     make_vectors proto/vectors      writes the files
//     make_vectors --tables           prints PROTOCOL.md's tables
//     make_vectors --dump NAME        prints NAME as a dump for PROTOCOL.md
#include <errno.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "airy.pb-c.h"
#include "fault.h"
#include "make_vectors.h"
#include "params.h"
#include "wire.h"

enum { MESSAGE_MAX = WIRE_HEADER_BYTES + 4096 };

// ---- JSON of a protobuf-c message -----------------------------------------------------------------

static void json_text(FILE *f, const char *s)
{
    fputc('"', f);
    for (; *s; s++)
        if (*s == '"' || *s == '\\')
            fprintf(f, "\\%c", *s);
        else
            fputc(*s, f);
    fputc('"', f);
}

static void json_name(FILE *f, const char *snake)
{
    fputc('"', f);
    for (; *snake; snake++)
        if (*snake == '_' && snake[1] >= 'a' && snake[1] <= 'z')
            fputc(*++snake - 'a' + 'A', f);
        else
            fputc(*snake, f);
    fputc('"', f);
}

static void json_message(FILE *f, const ProtobufCMessage *m, int indent);

static void json_value(FILE *f, const ProtobufCFieldDescriptor *d, const void *p, int indent)
{
    switch (d->type) {
    case PROTOBUF_C_TYPE_UINT32:
        fprintf(f, "%" PRIu32, *(const uint32_t *)p);
        return;
    case PROTOBUF_C_TYPE_INT32:
        fprintf(f, "%" PRId32, *(const int32_t *)p);
        return;
    case PROTOBUF_C_TYPE_UINT64:
        fprintf(f, "\"%" PRIu64 "\"", *(const uint64_t *)p);
        return;
    case PROTOBUF_C_TYPE_DOUBLE:
        fprintf(f, "%.15g", *(const double *)p);
        return;
    case PROTOBUF_C_TYPE_BOOL:
        fputs(*(const protobuf_c_boolean *)p ? "true" : "false", f);
        return;
    case PROTOBUF_C_TYPE_ENUM:
        json_text(f, protobuf_c_enum_descriptor_get_value(d->descriptor, *(const int *)p)->name);
        return;
    case PROTOBUF_C_TYPE_STRING:
        json_text(f, *(char *const *)p);
        return;
    case PROTOBUF_C_TYPE_MESSAGE:
        json_message(f, *(ProtobufCMessage *const *)p, indent);
        return;
    default:
        fprintf(stderr, "make_vectors: field %s has a type that airy.proto did not have\n", d->name);
        exit(1);
    }
}

static size_t value_bytes(ProtobufCType t)
{
    switch (t) {
    case PROTOBUF_C_TYPE_STRING:
    case PROTOBUF_C_TYPE_MESSAGE:
        return sizeof(void *);
    case PROTOBUF_C_TYPE_UINT64:
    case PROTOBUF_C_TYPE_DOUBLE:
        return 8;
    default:
        return 4;
    }
}

static bool is_default(const ProtobufCFieldDescriptor *d, const void *p)
{
    if (d->type == PROTOBUF_C_TYPE_MESSAGE)
        return !*(void *const *)p;
    if (d->type == PROTOBUF_C_TYPE_STRING)
        return !**(char *const *)p;
    static const uint8_t zero[8];
    return !memcmp(p, zero, value_bytes(d->type));
}

static void json_message(FILE *f, const ProtobufCMessage *m, int indent)
{
    const char *separator = "";
    fputc('{', f);
    for (unsigned i = 0; i < m->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *d = &m->descriptor->fields[i];
        const uint8_t *p = (const uint8_t *)m + d->offset;
        bool list = d->label == PROTOBUF_C_LABEL_REPEATED;
        size_t n = list ? *(const size_t *)((const uint8_t *)m + d->quantifier_offset) : 1;
        if (d->flags & PROTOBUF_C_FIELD_FLAG_ONEOF) {
            if (*(const uint32_t *)((const uint8_t *)m + d->quantifier_offset) != d->id)
                continue;
        } else if (list ? !n : is_default(d, p)) {
            continue;
        }
        fprintf(f, "%s\n%*s", separator, indent + 2, "");
        separator = ",";
        json_name(f, d->name);
        fputs(": ", f);
        if (!list) {
            json_value(f, d, p, indent + 2);
            continue;
        }
        fputc('[', f);
        for (size_t k = 0; k < n; k++) {
            if (k)
                fputs(", ", f);
            json_value(f, d, *(const uint8_t *const *)p + k * value_bytes(d->type), indent + 2);
        }
        fputc(']', f);
    }
    if (*separator)
        fprintf(f, "\n%*s", indent, "");
    fputc('}', f);
}

// ---- the messages -------------------------------------------------------------------------------

static size_t encode(const struct vector *v, uint8_t out[MESSAGE_MAX])
{
    size_t n = v->body ? protobuf_c_message_get_packed_size(v->body) : v->data_bytes;
    if (WIRE_HEADER_BYTES + n > MESSAGE_MAX)
        abort();
    wire_encode(out, &(struct wire_header){
                         .type = v->type, .n_fds = v->n_fds, .body_bytes = (uint32_t)n, .id = v->id });
    if (v->body)
        protobuf_c_message_pack(v->body, out + WIRE_HEADER_BYTES);
    else if (n)
        memcpy(out + WIRE_HEADER_BYTES, v->data, n);
    if (v->patch_at)
        out[v->patch_at] = v->patch;
    return WIRE_HEADER_BYTES + n;
}

static const char *sender(const struct vector *v)
{
    static const char who[] = {
#define X(number, name, who, fds) [number] = who,
        WIRE_TYPES(X)
#undef X
    };
    return v->from ? v->from : who[v->type] == 'D' ? "daemon" : "client";
}

static FILE *create(const char *folder, const char *name, const char *suffix)
{
    char path[4096];
    snprintf(path, sizeof(path), "%s/%s.%s", folder, name, suffix);
    FILE *f = fopen(path, "w");
    if (!f) {
        fprintf(stderr, "make_vectors: %s: %s\n", path, strerror(errno));
        exit(1);
    }
    return f;
}

static void hex_bytes(FILE *f, const uint8_t *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        fprintf(f, "%02x", p[i]);
}

static void write_json(FILE *f, const struct vector *v, const uint8_t *bytes, size_t n)
{
    fprintf(f, "{\n  \"name\": \"%s\",\n  \"what\": ", v->name);
    json_text(f, v->what);
    fprintf(f, ",\n  \"from\": \"%s\",\n  \"hex\": \"", sender(v));
    hex_bytes(f, bytes, n);
    fputs("\",\n", f);
    if (v->error) {
        fprintf(f, "  \"error\": \"%s\"\n}\n", v->error);
        return;
    }
    fprintf(f,
            "  \"header\": {\"type\": \"%s\", \"number\": %d, \"n_fds\": %u, \"flags\": 0, "
            "\"body_bytes\": %zu, \"id\": \"%" PRIu64 "\"},\n",
            wire_type_name(v->type), (int)v->type, v->n_fds, n - WIRE_HEADER_BYTES, v->id);
    if (v->type == WIRE_DATA) {
        fputs("  \"data\": \"", f);
        hex_bytes(f, bytes + WIRE_HEADER_BYTES, n - WIRE_HEADER_BYTES);
        fputs("\"\n}\n", f);
        return;
    }
    fputs("  \"body\": ", f);
    if (v->body)
        json_message(f, v->body, 2);
    else
        fputs("{}", f);
    fputs("\n}\n", f);
}

static void write_vector(const char *folder, const struct vector *v)
{
    uint8_t bytes[MESSAGE_MAX];
    size_t n = encode(v, bytes);
    FILE *f = create(folder, v->name, "hex");
    for (size_t i = 0; i < n; i += 24) {
        hex_bytes(f, bytes + i, n - i < 24 ? n - i : 24);
        fputc('\n', f);
    }
    if (fclose(f))
        abort();
    f = create(folder, v->name, "json");
    write_json(f, v, bytes, n);
    if (fclose(f))
        abort();
}

static void dump_vector(const struct vector *v)
{
    uint8_t bytes[MESSAGE_MAX];
    size_t n = encode(v, bytes);
    printf("```hex %s\n", v->name);
    for (size_t i = 0; i < n; i += i ? 16 : 8) {
        size_t row = i ? 16 : 8, k;
        if (i == 8 || (i > 8 && i < WIRE_HEADER_BYTES))
            row = WIRE_HEADER_BYTES - i;
        for (k = 0; k < row && i + k < n; k++)
            printf("%02x ", bytes[i + k]);
        for (; k < 16; k++)
            printf("   ");
        printf("| ");
        for (k = 0; i >= WIRE_HEADER_BYTES && k < row && i + k < n; k++)
            putchar(bytes[i + k] >= 32 && bytes[i + k] < 127 ? bytes[i + k] : '.');
        if (i == 0)
            printf("magic, version, type %s, n_fds %u, flags", wire_type_name(v->type), v->n_fds);
        if (i == 8)
            printf("body %zu bytes, reserved, id %" PRIu64, n - WIRE_HEADER_BYTES, v->id);
        putchar('\n');
    }
    puts("```");
}

static void handshake_vectors(each_vector each, void *ctx)
{
    Airy__Hello hello = AIRY__HELLO__INIT;
    hello.version_min = hello.version_max = 1;
    hello.client = (char *)"example/1.0";
    each(&(struct vector){ .name = "hello",
                           .what = "the first message of every connection",
                           .type = WIRE_HELLO,
                           .body = &hello.base },
         ctx);

    Airy__Limits limits = AIRY__LIMITS__INIT;
    limits.max_frame_bytes = UINT64_C(2) << 30;
    limits.max_width = limits.max_height = 16384;
    limits.max_pixels = UINT64_C(1) << 27;
    limits.credit_bytes = UINT64_C(4) << 30;
    limits.max_requests = 64;
    limits.max_body_bytes = WIRE_DATA_BYTES_MAX;
    Airy__Device device = AIRY__DEVICE__INIT;
    device.name = (char *)"llvmpipe (LLVM 15.0.6, 256 bits)";
    device.kind = (char *)"cpu";
    device.driver = (char *)"llvmpipe Mesa 22.3.6";
    char *features[] = { (char *)"exr", (char *)"raw", (char *)"memfd", (char *)"file",
                         (char *)"inline", (char *)"asset", (char *)"plan",
                         (char *)"wall" };
    Airy__Welcome welcome = AIRY__WELCOME__INIT;
    welcome.version = 1;
    welcome.server = (char *)"airyd/0.1.0";
    welcome.features = features;
    welcome.n_features = sizeof(features) / sizeof(features[0]);
    welcome.limits = &limits;
    welcome.device = &device;
    each(&(struct vector){ .name = "welcome",
                           .what = "the answer to hello",
                           .type = WIRE_WELCOME,
                           .body = &welcome.base },
         ctx);

    Airy__Error refused = AIRY__ERROR__INIT;
    refused.code = FAULT_BAD_VERSION;
    refused.symbol = (char *)"BAD_VERSION";
    refused.text = (char *)"the client speaks versions 2 to 3, this daemon 1";
    refused.field = (char *)"version_min";
    each(&(struct vector){ .name = "error_connection",
                           .what = "id 0: the connection is refused; the daemon closes after it",
                           .type = WIRE_ERROR,
                           .body = &refused.base },
         ctx);
}

static void bloom_vectors(each_vector each, void *ctx)
{
    Airy__Payload input = AIRY__PAYLOAD__INIT;
    Airy__Output output = AIRY__OUTPUT__INIT;
    Airy__ExrOptions exr = AIRY__EXR_OPTIONS__INIT;
    Airy__Bloom bloom = AIRY__BLOOM__INIT;
    bloom.input = &input;
    bloom.output = &output;
    bloom.format_case = AIRY__BLOOM__FORMAT_EXR;
    bloom.exr = &exr;
    input.kind = AIRY__PAYLOAD__KIND__INLINE;
    input.size = 8;
    each(&(struct vector){ .name = "bloom_exr_inline",
                           .what = "an EXR file of 8 bytes to come as DATA, all defaults",
                           .type = WIRE_BLOOM,
                           .id = 1,
                           .body = &bloom.base },
         ctx);

    Airy__Param number = AIRY__PARAM__INIT, text = AIRY__PARAM__INIT, *params[] = { &number, &text };
    number.name = (char *)"threshold";
    number.value_case = AIRY__PARAM__VALUE_NUMBER;
    number.number = 1.5;
    text.name = (char *)"bright";
    text.value_case = AIRY__PARAM__VALUE_TEXT;
    text.text = (char *)"luminance";
    bloom.params = params;
    bloom.n_params = 2;
    bloom.progress = 1;
    exr.part = (char *)"beauty";
    exr.view = (char *)"left";
    exr.pixels = (char *)"half";
    exr.compression = (char *)"zip";
    input.kind = AIRY__PAYLOAD__KIND__FILE;
    input.size = 1048576;
    output.kind = AIRY__OUTPUT__KIND__MEMFD;
    each(&(struct vector){ .name = "bloom_exr_file",
                           .what = "an open EXR file, two parameters, one part and view",
                           .type = WIRE_BLOOM,
                           .id = 2,
                           .n_fds = 1,
                           .body = &bloom.base },
         ctx);

    Airy__RawChannel r = AIRY__RAW_CHANNEL__INIT, g = r, b = r, *channels[] = { &r, &g, &b };
    Airy__RawLayout raw = AIRY__RAW_LAYOUT__INIT;
    r.name = (char *)"R";
    g.name = (char *)"G";
    b.name = (char *)"B";
    g.offset = 2;
    b.offset = 4;
    r.row_stride = g.row_stride = b.row_stride = 3840;
    r.pixel_stride = g.pixel_stride = b.pixel_stride = 6;
    raw.width = 640;
    raw.height = 360;
    raw.type = AIRY__PIXEL_TYPE__PIXEL_HALF;
    raw.channels = channels;
    raw.n_channels = 3;
    Airy__Bloom live = AIRY__BLOOM__INIT;
    live.input = &input;
    live.output = &output;
    live.format_case = AIRY__BLOOM__FORMAT_RAW;
    live.raw = &raw;
    input.kind = AIRY__PAYLOAD__KIND__MEMFD;
    input.offset = 4096;
    input.size = 1382400;
    output.kind = AIRY__OUTPUT__KIND__BUFFER;
    output.fd = 1;
    output.size = 1382400;
    each(
        &(struct vector){
            .name = "bloom_raw_memfd",
            .what = "640x360 interleaved half RGB, from the client's memfd into its second one",
            .type = WIRE_BLOOM,
            .id = UINT64_C(0x0123456789abcdef),
            .n_fds = 2,
            .body = &live.base },
        ctx);

    each(&(struct vector){ .name = "data_client",
                           .what = "payload bytes of request 1",
                           .type = WIRE_DATA,
                           .id = 1,
                           .data = "\x76\x2f\x31\x01\x02\x00\x00\x00",
                           .data_bytes = 8 },
         ctx);
    each(&(struct vector){ .name = "data_daemon",
                           .what = "result bytes of request 1",
                           .type = WIRE_DATA,
                           .id = 1,
                           .data = "\x76\x2f\x31\x01",
                           .data_bytes = 4,
                           .from = "daemon" },
         ctx);
    each(
        &(struct vector){
            .name = "cancel", .what = "asks request 2 to stop", .type = WIRE_CANCEL, .id = 2 },
        ctx);
    each(&(struct vector){ .name = "cancelled",
                           .what = "request 2 ended by its cancel",
                           .type = WIRE_CANCELLED,
                           .id = 2 },
         ctx);
}

static void result_vectors(each_vector each, void *ctx)
{
    Airy__Payload output = AIRY__PAYLOAD__INIT;
    Airy__StageTimes ms = AIRY__STAGE_TIMES__INIT;
    Airy__Result result = AIRY__RESULT__INIT;
    output.kind = AIRY__PAYLOAD__KIND__INLINE;
    output.size = 4;
    ms.total = 12.5;
    result.output = &output;
    result.ms = &ms;
    each(&(struct vector){ .name = "result_inline",
                           .what = "the end of request 1, whose 4 bytes came as DATA",
                           .type = WIRE_RESULT,
                           .id = 1,
                           .body = &result.base },
         ctx);

    Airy__Energy energy = AIRY__ENERGY__INIT;
    energy.input = 1000.5;
    energy.bright = 250;
    energy.bloomed = 24.25;
    energy.lost = 0.75;
    energy.clamped = 12.5;
    energy.suppressed = 0.125;
    Airy__NonFinite bad = AIRY__NON_FINITE__INIT;
    bad.nan = 2;
    bad.negative = 17;
    bad.any = 1;
    bad.first_x = -3;
    bad.first_y = 40;
    bad.first_channel = (char *)"G";
    Airy__Target target = AIRY__TARGET__INIT, *targets[] = { &target };
    target.name = (char *)"beauty";
    target.min_x = -16;
    target.min_y = -8;
    target.width = 1952;
    target.height = 1096;
    target.plan = (char *)"R3 levels 0..5 b4>>b6";
    target.rule = (char *)"R3";
    target.levels = 5;
    target.error_bound = 0.0005;
    target.max_bright = 5000;
    target.energy = &energy;
    target.nonfinite = &bad;
    target.saturated = 3;
    target.tiles = 558;
    target.tiles_bright = 61;
    target.skipped = (char *)"497 tiles without a highlight";
    target.storage = (char *)"half";
    target.exposure = -1;
    target.predicted_ms = 21.5;
    char *notes[] = { (char *)"preview dropped" };
    output.kind = AIRY__PAYLOAD__KIND__MEMFD;
    output.size = 1049000;
    ms = (Airy__StageTimes)AIRY__STAGE_TIMES__INIT;
    ms.queue = 0.25;
    ms.decode = 15;
    ms.bloom = 20;
    ms.encode = 58;
    ms.total = 93.5;
    result.targets = targets;
    result.n_targets = 1;
    result.device = (char *)"llvmpipe (LLVM 15.0.6, 256 bits)";
    result.chunks = 69;
    result.chunks_copied = 7;
    result.notes = notes;
    result.n_notes = 1;
    result.exposure = -1;
    each(&(struct vector){ .name = "result_memfd",
                           .what = "the end of request 2, its file in a memfd",
                           .type = WIRE_RESULT,
                           .id = 2,
                           .n_fds = 1,
                           .body = &result.base },
         ctx);

    Airy__Error error = AIRY__ERROR__INIT;
    error.code = FAULT_PARAM_RANGE;
    error.symbol = (char *)"PARAM_RANGE";
    error.text = (char *)"threshold is -1, expected 0 to 1e+30";
    error.field = (char *)"params.threshold";
    each(&(struct vector){ .name = "error_request",
                           .what = "request 3 failed",
                           .type = WIRE_ERROR,
                           .id = 3,
                           .body = &error.base },
         ctx);
    Airy__Error busy = AIRY__ERROR__INIT;
    busy.code = FAULT_BUSY;
    busy.symbol = (char *)"BUSY";
    busy.text = (char *)"64 requests are in flight on this connection, at most 64 are allowed";
    busy.retryable = 1;
    busy.retry_after_ms = 250;
    busy.queue_position = 64;
    each(&(struct vector){ .name = "error_busy",
                           .what = "request 4 came when too much was in flight",
                           .type = WIRE_ERROR,
                           .id = 4,
                           .body = &busy.base },
         ctx);
}

static void other_vectors(each_vector each, void *ctx)
{
    Airy__Credit credit = AIRY__CREDIT__INIT;
    credit.bytes = 8;
    each(&(struct vector){ .name = "credit",
                           .what = "8 bytes of credit come back",
                           .type = WIRE_CREDIT,
                           .body = &credit.base },
         ctx);
    Airy__Progress progress = AIRY__PROGRESS__INIT;
    progress.stage = (char *)"bloom";
    progress.fraction = 0.5;
    each(&(struct vector){ .name = "progress",
                           .what = "request 2 is half done",
                           .type = WIRE_PROGRESS,
                           .id = 2,
                           .body = &progress.base },
         ctx);
    each(
        &(struct vector){
            .name = "status", .what = "asks how the daemon is", .type = WIRE_STATUS, .id = 5 },
        ctx);
    Airy__Device device = AIRY__DEVICE__INIT;
    device.name = (char *)"llvmpipe (LLVM 15.0.6, 256 bits)";
    device.kind = (char *)"cpu";
    Airy__StageTimes ms = AIRY__STAGE_TIMES__INIT;
    ms.total = 93.5;
    Airy__StatusReply status = AIRY__STATUS_REPLY__INIT;
    status.server = (char *)"airyd/0.1.0";
    status.device = &device;
    status.uptime_s = 3600.5;
    status.clients = 2;
    status.queued = 3;
    status.running = 2;
    status.done = 1001;
    status.failed = 4;
    status.pixels = UINT64_C(5000000000);
    status.rss_bytes = 400000000;
    status.mean_ms = &ms;
    each(&(struct vector){ .name = "status_reply",
                           .what = "the answer to status",
                           .type = WIRE_STATUS_REPLY,
                           .id = 5,
                           .body = &status.base },
         ctx);
}

static void asset_vectors(each_vector each, void *ctx)
{
    Airy__Payload input = AIRY__PAYLOAD__INIT;
    Airy__Asset asset = AIRY__ASSET__INIT;
    asset.input = &input;
    input.kind = AIRY__PAYLOAD__KIND__FILE;
    input.size = 24512;
    each(&(struct vector){ .name = "asset_file",
                           .what = "an image to be kept, from an open file",
                           .type = WIRE_ASSET,
                           .id = 6,
                           .n_fds = 1,
                           .body = &asset.base },
         ctx);
    Airy__AssetKept kept = AIRY__ASSET_KEPT__INIT;
    kept.digest = (char *)"0123456789abcdef0123456789abcdef";
    kept.width = 64;
    kept.height = 36;
    each(&(struct vector){ .name = "asset_kept",
                           .what = "the image of request 6 is kept under this digest",
                           .type = WIRE_ASSET_KEPT,
                           .id = 6,
                           .body = &kept.base },
         ctx);
    Airy__Error unknown = AIRY__ERROR__INIT;
    unknown.code = FAULT_NO_ASSET;
    unknown.symbol = (char *)"NO_ASSET";
    unknown.text = (char *)"no image with digest ffffffffffffffffffffffffffffffff is kept: send it first";
    unknown.field = (char *)"params.dirt";
    each(&(struct vector){ .name = "error_asset",
                           .what = "request 7 names an image that is not kept",
                           .type = WIRE_ERROR,
                           .id = 7,
                           .body = &unknown.base },
         ctx);
}

static void bad_vectors(each_vector each, void *ctx)
{
    const struct vector bad[] = {
        { .name = "bad_magic",
          .what = "the second byte of the magic is wrong",
          .type = WIRE_STATUS,
          .id = 5,
          .error = "BAD_MAGIC",
          .patch_at = 1,
          .patch = 'i' },
        { .name = "bad_version",
          .what = "version 2",
          .type = WIRE_HELLO,
          .error = "BAD_VERSION",
          .patch_at = 4,
          .patch = 2 },
        { .name = "bad_type",
          .what = "no message has type 99",
          .type = WIRE_STATUS,
          .error = "UNEXPECTED",
          .patch_at = 5,
          .patch = 99 },
        { .name = "bad_type_zero",
          .what = "no message has type 0",
          .type = WIRE_STATUS,
          .error = "UNEXPECTED",
          .patch_at = 5,
          .patch = 0 },
        { .name = "bad_sender",
          .what = "RESULT from a client",
          .type = WIRE_RESULT,
          .id = 1,
          .error = "UNEXPECTED",
          .from = "client" },
        { .name = "bad_sender_daemon",
          .what = "HELLO from a daemon",
          .type = WIRE_HELLO,
          .error = "UNEXPECTED",
          .from = "daemon" },
        { .name = "bad_length",
          .what = "BLOOM that states 131072 bytes; refused from the header alone",
          .type = WIRE_BLOOM,
          .id = 1,
          .data = "",
          .error = "TOO_LONG",
          .patch_at = 10,
          .patch = 2 },
        { .name = "bad_length_data",
          .what = "DATA that states 16777216 bytes",
          .type = WIRE_DATA,
          .id = 1,
          .error = "TOO_LONG",
          .patch_at = 11,
          .patch = 1 },
        { .name = "bad_fds_count",
          .what = "BLOOM that states 3 descriptors",
          .type = WIRE_BLOOM,
          .id = 1,
          .error = "BAD_FDS",
          .n_fds = 3 },
        { .name = "bad_fds_type",
          .what = "STATUS that states a descriptor",
          .type = WIRE_STATUS,
          .id = 1,
          .error = "BAD_FDS",
          .n_fds = 1 },
        { .name = "bad_fds_asset",
          .what = "ASSET that states 2 descriptors",
          .type = WIRE_ASSET,
          .id = 1,
          .error = "BAD_FDS",
          .n_fds = 2 },
        { .name = "bad_sender_kept",
          .what = "ASSET_KEPT from a client",
          .type = WIRE_ASSET_KEPT,
          .id = 1,
          .error = "UNEXPECTED",
          .from = "client" },
        { .name = "bad_fds_wall",
          .what = "WALL that states a descriptor",
          .type = WIRE_WALL,
          .id = 1,
          .error = "BAD_FDS",
          .n_fds = 1 },
        { .name = "bad_sender_wall",
          .what = "WALL_REPLY from a client",
          .type = WIRE_WALL_REPLY,
          .id = 1,
          .error = "UNEXPECTED",
          .from = "client" },
        { .name = "bad_flags",
          .what = "flags are not 0",
          .type = WIRE_STATUS,
          .id = 1,
          .error = "BAD_BODY",
          .patch_at = 7,
          .patch = 1 },
        { .name = "bad_reserved",
          .what = "the reserved bytes are not 0",
          .type = WIRE_STATUS,
          .id = 1,
          .error = "BAD_BODY",
          .patch_at = 15,
          .patch = 128 },
        { .name = "bad_body_cut",
          .what = "the body ends within a varint",
          .type = WIRE_HELLO,
          .data = "\x08\x81",
          .data_bytes = 2,
          .error = "BAD_BODY" },
        { .name = "bad_body_length",
          .what = "a text that is longer than the body",
          .type = WIRE_HELLO,
          .data = "\x1a\x05hi",
          .data_bytes = 4,
          .error = "BAD_BODY" },
        { .name = "bad_body_nested",
          .what = "a sub-message that is damaged",
          .type = WIRE_BLOOM,
          .id = 1,
          .data = "\x12\x02\x08\x80",
          .data_bytes = 4,
          .error = "BAD_BODY" },
    };
    for (unsigned i = 0; i < sizeof(bad) / sizeof(bad[0]); i++)
        each(&bad[i], ctx);
}

static void all_vectors(each_vector each, void *ctx)
{
    handshake_vectors(each, ctx);
    bloom_vectors(each, ctx);
    result_vectors(each, ctx);
    other_vectors(each, ctx);
    asset_vectors(each, ctx);
    wall_vectors(each, ctx);
    turn_vectors(each, ctx);
    stamp_vectors(each, ctx);
    bad_vectors(each, ctx);
}

// ---- PROTOCOL.md's tables --------------------------------------------------------------------------

static void print_word(const char *words, unsigned n)
{
    for (; n; n--)
        words += strcspn(words, " ") + 1;
    printf("%.*s", (int)strcspn(words, " "), words);
}

static void print_tables(void)
{
#define X(number, name, who, fds)                                                                       \
    printf("| %d | %s | %s | %d |\n", number, #name,                                                    \
           who == 'C'   ? "client"                                                                      \
           : who == 'D' ? "daemon"                                                                      \
                        : "both",                                                                       \
           fds);
    WIRE_TYPES(X)
#undef X
    puts("");
#define X(code, symbol, retryable, closes, text)                                                        \
    printf("| %d | %s | %s | %s | %s |\n", code, #symbol, retryable ? "yes" : "", closes ? "yes" : "",  \
           text);
    AIRY_FAULTS(X)
#undef X
    puts("");
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    printf("| %s | number | %.15g | %.15g to %.15g | %s | %s |\n", #name, (double)(def), (double)(min), \
           (double)(max), unit, help);
#define CHOICE(name, field, def, words, help)                                                           \
    printf("| %s | choice | ", #name);                                                                  \
    print_word(words, def);                                                                             \
    printf(" | %s | | %s |\n", words, help);
#define TEXT(name, field, def, help) printf("| %s | text | %s | | | %s |\n", #name, def, help);
#include "params.def"
}

static void write_each(const struct vector *v, void *folder) { write_vector(folder, v); }

static void dump_each(const struct vector *v, void *name)
{
    if (!strcmp(v->name, name))
        dump_vector(v);
}

int main(int argc, char **argv)
{
    if (argc == 2 && !strcmp(argv[1], "--tables"))
        print_tables();
    else if (argc == 3 && !strcmp(argv[1], "--dump"))
        all_vectors(dump_each, argv[2]);
    else if (argc == 2 && argv[1][0] != '-')
        all_vectors(write_each, argv[1]);
    else
        return fprintf(stderr, "usage: make_vectors FOLDER | --tables | --dump NAME\n"), 2;
    return 0;
}
