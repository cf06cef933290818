// SPDX-License-Identifier: Apache-2.0
//
// make_seeds.c - writes the fuzz targets' first inputs, a folder each: OpenEXR files of every kind from OpenEXR's own
// library, the golden messages, all parameters of the table, the manual's wall definitions, the dialogues of both kinds of
// boards, and what a client and a daemon really say to each other (seeds_talk.c).
//
//     make_seeds FOLDER          run in the repository's root; $AIRYD is the daemon
//
// Invariant: all but the traffic is the same in each run.
#include <dirent.h>
#include <errno.h>
#include <sys/stat.h>

#include "fuzz.h"
#include "seeds.h"
#include "tools/exr_tool.h"
#include "wire.h"

static const char *root;

void seed_write(const char *target, const char *name, const struct seed *s)
{
    char path[512];
    snprintf(path, sizeof(path), "%s/%s", root, target);
    must(mkdir(path, 0777) == 0 || errno == EEXIST);
    snprintf(path, sizeof(path), "%s/%s/%s", root, target, name);
    FILE *f = fopen(path, "wb");
    must(f);
    must(fwrite(s->bytes, 1, s->size, f) == s->size && fclose(f) == 0);
}

void seed_add(struct seed *s, const void *bytes, size_t n)
{
    must(n <= sizeof(s->bytes) - s->size);
    memcpy(s->bytes + s->size, bytes, n);
    s->size += n;
}

void seed_number(struct seed *s, uint64_t v, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++)
        seed_add(s, &(uint8_t){ (uint8_t)(v >> 8 * i) }, 1);
}

static void write_text(const char *target, const char *name, const char *text)
{
    static struct seed s;
    s.size = 0;
    seed_add(&s, text, strlen(text));
    seed_write(target, name, &s);
}

// ---- OpenEXR files -------------------------------------------------------------------------------------

static void write_exr(const struct exr_tool_spec *spec, const char *name, const uint8_t way[8])
{
    static struct seed s;
    uint8_t *bytes;
    size_t size;
    must(!exr_tool_make(spec, &bytes, &size));
    s.size = 0;
    seed_add(&s, way, 8);
    seed_add(&s, bytes, size);
    seed_write("exr", name, &s);
    s.size = 0;
    seed_add(&s, bytes, size);
    seed_write("asset", name, &s);
    free(bytes);
}

// One selection a layout, so that its layers, views and mattes are read.
static void write_exrs(void)
{
    static const uint8_t ways[][8] = {
        [EXR_TOOL_RGBA] = { 0, 0, 0, 1, 1, 0x81, 15, 0 }, [EXR_TOOL_Y] = { 0, 0, 0, 0, 1, 0x84, 15, 0 },
        [EXR_TOOL_YC] = { 0, 0, 0, 0, 0, 0x80, 15, 0 },   [EXR_TOOL_STEREO] = { 0, 0, 0, 0, 0, 0xa2, 15, 0 },
        [EXR_TOOL_G] = { 0, 0, 0, 0, 0, 0x20, 15, 0 },    [EXR_TOOL_UINT] = { 0, 0, 0, 0, 0, 0x20, 15, 0 },
        [EXR_TOOL_EYES] = { 0, 0, 0, 2, 3, 0x81, 15, 0 }, [EXR_TOOL_CROWD] = { 0, 0, 4, 0, 0, 0x20, 15, 0 },
        [EXR_TOOL_SMALL] = { 0, 0, 0, 0, 0, 0x80, 15, 0 }, [EXR_TOOL_YCGLOW] = { 0, 0, 0, 2, 0, 0x80, 15, 0 },
    };
    char name[64];
    for (int layout = EXR_TOOL_RGBA; layout <= EXR_TOOL_YCGLOW; layout++)
        for (int compression = 0; compression <= 9; compression++) {
            const struct exr_tool_spec spec = { .layout = (enum exr_tool_layout)layout, .compression = compression,
                                                .type = 1 + compression % 3, .tile_width = 8, .tile_height = 8,
                                                .width = 20, .height = 18, .parts = 1, .specials = compression & 1 };
            snprintf(name, sizeof(name), "layout%d_c%d", layout, compression);
            write_exr(&spec, name, ways[layout]);
        }
    for (int kind = 0; kind < 12; kind++) {
        const struct exr_tool_spec spec = { .layout = EXR_TOOL_RGBA, .compression = 3 + kind % 7, .type = 1, .tiled = kind % 4,
                                            .tile_width = 8, .tile_height = 16, .round_up = kind & 1, .min_x = -4, .min_y = 6,
                                            .width = 26, .height = 22, .parts = 1 + kind % 3, .aov = kind > 5 };
        const uint8_t way[8] = { 0, 0, 0, kind > 5 ? 3 : 0, 4, 0x82, (uint8_t)(kind % 16), (uint8_t)(kind & 1 ? 130 + kind : 0) };
        snprintf(name, sizeof(name), "kind%d", kind);
        write_exr(&spec, name, way);
    }
}

// ---- golden messages -----------------------------------------------------------------------------------

static size_t read_hex(const char *path, uint8_t *out, size_t room)
{
    FILE *f = fopen(path, "r");
    unsigned byte;
    size_t n = 0;
    must(f);
    while (fscanf(f, "%2x", &byte) == 1 && n < room)
        out[n++] = (uint8_t)byte;
    fclose(f);
    return n;
}

void seed_message(struct seed *s, const uint8_t *message, size_t n, bool long_steps)
{
    const unsigned n_fds = message[6];
    if (n_fds && n_fds <= 4) {
        seed_number(s, long_steps ? 2 | 1 << 4 : 2 | (n_fds - 1) << 2, 1);
        seed_number(s, 24, 1);
        seed_add(s, message, 24);
        message += 24;
        n -= 24;
    }
    seed_number(s, 1, 1);
    seed_number(s, n, 2);
    seed_add(s, message, n);
}

void seed_body(const char *name, const uint8_t *message, size_t n)
{
    static const uint8_t numbers[] = { [WIRE_BLOOM] = 0,  [WIRE_ASSET] = 1,    [WIRE_WALL] = 2,     [WIRE_HELLO] = 3,
                                       [WIRE_WELCOME] = 4, [WIRE_RESULT] = 5,  [WIRE_ERROR] = 6,    [WIRE_ASSET_KEPT] = 7,
                                       [WIRE_CREDIT] = 8, [WIRE_PROGRESS] = 9, [WIRE_STATUS_REPLY] = 10,
                                       [WIRE_WALL_REPLY] = 11 };
    static struct seed s;
    const uint8_t type = message[5];
    if (type >= sizeof(numbers) || (!numbers[type] && type != WIRE_BLOOM))
        return;
    s.size = 0;
    seed_number(&s, numbers[type], 1);
    seed_number(&s, message[6] % 3, 1);
    seed_add(&s, message + WIRE_HEADER_BYTES, n - WIRE_HEADER_BYTES);
    seed_write("body", name, &s);
}

static void write_vector(const char *folder, const char *file)
{
    static struct seed conn, lib;
    char path[512];
    uint8_t m[8192];
    snprintf(path, sizeof(path), "%s/%s", folder, file);
    const size_t n = read_hex(path, m, sizeof(m));
    if (n < WIRE_HEADER_BYTES)
        return;
    conn.size = lib.size = 0;
    const bool from_client = m[5] == WIRE_HELLO || m[5] == WIRE_BLOOM || m[5] == WIRE_CANCEL || m[5] == WIRE_STATUS ||
                             m[5] == WIRE_ASSET || m[5] == WIRE_WALL || strstr(file, "client");
    seed_number(&conn, from_client ? 1 : 2, 1);
    seed_message(&conn, m, n, false);
    seed_write("conn", file, &conn);
    if (from_client) { // after a HELLO, and then its end is waited for
        uint8_t hello[256];
        const size_t hello_bytes = read_hex("proto/vectors/hello.hex", hello, sizeof(hello));
        conn.size = 0;
        seed_number(&conn, 1, 1);
        seed_message(&conn, hello, hello_bytes, false);
        seed_message(&conn, m, n, false);
        seed_number(&conn, 3 | 1 << 2, 1);
        seed_write("client", file, &conn);
    }
    seed_body(file, m, n);
    seed_number(&lib, 1, 1); // a welcome, then a submit, a status and a question about walls, then this
    seed_add(&lib, "\x14\x34\x05\x06\x16", 5);
    seed_message(&lib, m, n, true);
    seed_add(&lib, "\x03\x08\x08\x08", 4);
    seed_write("libairy", file, &lib);
}

static void write_vectors(void)
{
    static const char folder[] = "proto/vectors";
    struct dirent **list;
    const int n = scandir(folder, &list, NULL, alphasort);
    must(n > 0);
    for (int i = 0; i < n; i++) {
        if (strstr(list[i]->d_name, ".hex"))
            write_vector(folder, list[i]->d_name);
        free(list[i]);
    }
    free(list);
}

// ---- parameters ----------------------------------------------------------------------------------------

static void write_params(void)
{
    static const char *const texts[] = {
        "psf=gaussians:sigma=2/8/32,weight=0.2/0.1/0.05", "psf=gaussians:sigma=0.5%/2%,weight=0.3/0.1,tint=1:0.5:0.2",
        "psf=eye", "psf=airy:f=8,pitch=5,weight=0.1", "psf=aperture:f=2.8,blades=7,rotation=15",
        "psf=image:00112233445566778899aabbccddeeff", "psf=octaves:4,2,0.5", "psf=halation:sigma=12,weight=0.2",
        "look=mip-chain\nsun=x=50%,y=20%,radius=5%,gain=2,tint=1:.9:.7", "look=three-scale\nstages=6\ntint=1:1:1/1:.9:.8", "look=jimenez\nradius=1", "grow=auto", "grow=2%",
        "layers=bright/bloom/level:0", "view=level:1", "source=glow\nmatte=id.m", "dirt=00112233445566778899aabbccddeeff",
        "threshold~1.5\nintensity~0.2", "exposure=auto\nkey~0.18",
    };
    char name[64], line[600];
    for (unsigned i = 0; i < sizeof(texts) / sizeof(*texts); i++) {
        snprintf(name, sizeof(name), "text%u", i);
        write_text("params", name, texts[i]);
    }
#define NUMBER(name_, field, def, min, max, unit, help)                                             \
    snprintf(line, sizeof(line), #name_ "~%.17g\n" #name_ "=%.17g", (double)(max), (double)(def)); \
    write_text("params", #name_, line);
#define CHOICE(name_, field, def, words, help)                                                      \
    snprintf(line, sizeof(line), "%s", words);                                                     \
    for (char *save = NULL, *word = strtok_r(line, " ", &save); word; word = strtok_r(NULL, " ", &save)) { \
        char text[128];                                                                            \
        snprintf(text, sizeof(text), #name_ "=%s", word);                                          \
        snprintf(name, sizeof(name), #name_ ".%s", word);                                          \
        write_text("params", name, text);                                                          \
    }
#define TEXT(name_, field, def, help) write_text("params", #name_, #name_ "=" def);
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
}

// ---- walls ---------------------------------------------------------------------------------------------

// The manual's examples, between .nf and .fi, with its "\-" as "-".
static void write_walls(void)
{
    static struct seed s;
    FILE *f = fopen("client/airy-wall.5", "r");
    char line[512], name[32];
    unsigned n = 0;
    bool in = false;
    must(f);
    while (fgets(line, sizeof(line), f)) {
        if (!strcmp(line, ".fi\n") && in) {
            snprintf(name, sizeof(name), "manual%u", n++);
            seed_write("wall", name, &s);
            in = false;
        }
        for (const char *c = line; in && *c; c++)
            if (*c != '\\')
                seed_add(&s, c, 1);
        if (!strcmp(line, ".nf\n")) {
            in = true;
            s.size = 0;
        }
    }
    fclose(f);
    must(n > 1);
    write_text("wall", "gud", "wall: g\nsize: [32, 16]\npanels:\n- {name: p, size: [32, 16]}\nboards:\n"
                              "- {name: b, serial: S1, kind: gud, size: [32, 16], panels: p}\n");
    write_text("wall", "bare", "wall: w\nsize: [8, 4]\npanels:\n- {name: p, size: [8, 4]}\n");
    write_text("wall", "mistakes", "wall: 7\nsize: [0, -4]\nfoo: bar\npanels:\n- {name: p, size: [8], at: x}\n- &a {}\n");
}

// ---- boards --------------------------------------------------------------------------------------------

static void reply(struct seed *s, const void *bytes, size_t n)
{
    seed_number(s, 0, 1);
    seed_number(s, n, 2);
    seed_add(s, bytes, n);
}

static void write_gud(const char *name, uint8_t format, uint8_t flags, uint32_t buffer)
{
    static struct seed s;
    enum { W = 16, H = 8 };
    static const uint16_t mode[8] = { W, W + 8, W + 16, W + 24, H, H + 2, H + 4, H + 6 };
    static const uint8_t property[10] = { 50, 0, 0x3f }, of_connector[10] = { 12, 0, 7 };
    struct seed part = { .size = 0 };
    s.size = 0;
    seed_add(&s, "\x01\x10\x08\x01\x05\x00\x01\x02\x00\x02", 10); // GUD, 16 x 8, one interface, one bulk OUT
    seed_number(&part, 0x1d50614d, 4);
    seed_number(&part, 1, 1);
    seed_number(&part, flags, 4);
    seed_number(&part, 0, 1);
    seed_number(&part, buffer, 4);
    for (unsigned i = 0; i < 4; i++)
        seed_number(&part, i < 2 ? W : H, 4);
    reply(&s, part.bytes, 30);
    reply(&s, &format, 1);
    reply(&s, property, sizeof(property));
    reply(&s, "\0\0\0\0\0", 5);
    reply(&s, of_connector, sizeof(of_connector));
    reply(&s, "\1", 1);
    part.size = 0;
    seed_number(&part, 10000, 4);
    for (unsigned i = 0; i < 8; i++)
        seed_number(&part, mode[i], 2);
    seed_number(&part, 1 << 10, 4);
    reply(&s, part.bytes, 24);
    for (unsigned i = 0; i < 4; i++) { // four settings, each with its status if it gives one
        seed_number(&s, 0, 1);
        if (flags & 1)
            reply(&s, "\0", 1);
    }
    seed_add(&s, "\1\0\1\0\1\0\1\0", 8);
    seed_write("panel", name, &s);
}

static void write_panels(void)
{
    static struct seed s;
    write_gud("gud_rgb888", 0x50, 0, 16 * 8 * 3);
    write_gud("gud_bands", 0x80, 1, 16 * 4 * 2);
    write_gud("gud_full", 0x40, 3, 0);
    seed_add(&s, "\x00\x40\x08\x01\x05\x00\x01\x02\x40\x00\x00\x00\x04\x01\x02\x03\x04\x04\x05\x06\x07\x08\x03", 23);
    seed_write("panel", "fadecandy", &s);
}

// ---- frames and raw pictures ---------------------------------------------------------------------------

static void write_frames(void)
{
    static const char *const texts[] = { "1-10\nshot.####.exr", "1-100x3,200-150x5\n/a/b/%04d.exr", "-5--1\n$F4.exr", "7\n@@@.exr",
                                         "10-1,3,3,3\nx$F.#.exr", "1,5,9-12\n%d", "1-999999999\n#", "-999999999\n##############" };
    char name[16];
    for (unsigned i = 0; i < sizeof(texts) / sizeof(*texts); i++) {
        snprintf(name, sizeof(name), "range%u", i);
        write_text("frames", name, texts[i]);
    }
}

static void write_raw(const char *name, uint8_t type, uint8_t way, unsigned channels, const uint8_t *names, bool planar)
{
    static struct seed s;
    const unsigned width = 17, height = 9, bytes = type == 1 ? 2 : 4, row = width * bytes * (planar ? 1 : channels);
    s.size = 0;
    seed_number(&s, type | way, 1);
    seed_number(&s, (uint64_t)width * height * bytes * channels, 3);
    seed_number(&s, width, 2);
    seed_number(&s, height, 2);
    seed_number(&s, channels, 1);
    for (unsigned i = 0; i < channels; i++) {
        seed_number(&s, names[i], 1);
        seed_number(&s, planar ? (uint64_t)i * row * height : (uint64_t)i * bytes, 2);
        seed_number(&s, row, 2);
        seed_number(&s, planar ? bytes : bytes * channels, 1);
    }
    seed_add(&s, "\x00\x3c\x00\x7c\x01\xfc\x80\x3f", 8);
    seed_write("raw", name, &s);
}

static void write_raws(void)
{
    static const uint8_t rgb[] = { 0, 1, 2, 9, 4, 5, 6, 7 }, y[] = { 3, 8, 9, 4 };
    write_raw("planar_half", 1, 0, 3, rgb, true);
    write_raw("rgbm_float", 2, 16, 4, rgb, false);
    write_raw("all_half", 1, 4 | 16 | 32, 8, rgb, false);
    write_raw("all_float", 2, 4 | 16 | 32, 8, rgb, true);
    write_raw("y_half", 1, 4 | 16 | 32, 4, y, false);
}

int main(int argc, char **argv)
{
    if (argc != 2) {
        fprintf(stderr, "usage: make_seeds FOLDER\n");
        return 2;
    }
    root = argv[1];
    must(mkdir(root, 0777) == 0 || errno == EEXIST);
    write_exrs();
    write_vectors();
    write_params();
    write_walls();
    write_panels();
    write_frames();
    write_raws();
    return seeds_talk(getenv("AIRYD")) < 0;
}
