// SPDX-License-Identifier: Apache-2.0
// make_vectors_wall.c - the example messages about walls; see make_vectors.c.
#include "make_vectors.h"

static void wall_question_vectors(each_vector each, void *ctx)
{
    Airy__Wall list = AIRY__WALL__INIT;
    each(&(struct vector){ .name = "wall_list",
                           .what = "asks for all walls and controllers: every field is its default",
                           .type = WIRE_WALL,
                           .id = 8,
                           .body = &list.base },
         ctx);
    Airy__Wall open = AIRY__WALL__INIT;
    open.action = AIRY__WALL__ACTION__OPEN;
    open.definition = (char *)"name: lobby";
    open.calibration = (char *)"0123456789abcdef0123456789abcdef";
    open.keep = 1;
    each(&(struct vector){ .name = "wall_open",
                           .what = "opens a wall (a real definition has more lines) that is to outlive its connection",
                           .type = WIRE_WALL,
                           .id = 9,
                           .body = &open.base },
         ctx);
    Airy__Wall pattern = AIRY__WALL__INIT;
    pattern.action = AIRY__WALL__ACTION__PATTERN;
    pattern.name = (char *)"lobby";
    pattern.pattern = (char *)"led";
    pattern.board = (char *)"left";
    pattern.led = 300;
    pattern.level = 0.5;
    each(&(struct vector){ .name = "wall_pattern",
                           .what = "lights one LED of one board at half its light",
                           .type = WIRE_WALL,
                           .id = 10,
                           .body = &pattern.base },
         ctx);

    Airy__Payload input = AIRY__PAYLOAD__INIT;
    Airy__Output output = AIRY__OUTPUT__INIT;
    Airy__WallTarget target = AIRY__WALL_TARGET__INIT;
    Airy__Bloom bloom = AIRY__BLOOM__INIT;
    bloom.input = &input;
    bloom.output = &output;
    bloom.wall = &target;
    input.kind = AIRY__PAYLOAD__KIND__FILE;
    input.size = 1048576;
    output.kind = AIRY__OUTPUT__KIND__WALL;
    target.name = (char *)"lobby";
    target.present_ns = UINT64_C(81000016666667);
    each(&(struct vector){ .name = "bloom_wall",
                           .what = "an open EXR file, to be shown on a wall at its time",
                           .type = WIRE_BLOOM,
                           .id = 11,
                           .n_fds = 1,
                           .body = &bloom.base },
         ctx);
}

static void wall_answer_vectors(each_vector each, void *ctx)
{
    Airy__Percentiles late = AIRY__PERCENTILES__INIT, skew = late, latency = late;
    late.p50 = 0.0625;
    late.p99 = 0.25;
    late.max = 1.5;
    skew.max = 0.5;
    latency.p99 = 3.75;
    Airy__WallBoard left = AIRY__WALL_BOARD__INIT, right = left, *boards[] = { &left, &right };
    left.name = (char *)"left";
    left.kind = right.kind = (char *)"fadecandy";
    left.serial = (char *)"ABCDEFGHIJKLMNOP";
    left.state = (char *)"ready";
    left.path = (char *)"1-4.2";
    left.sent = left.rendered = left.received = 3600;
    left.stalls = 1;
    left.latency_ms = &latency;
    left.amps = 4;
    left.amps_wanted = 5;
    right.name = right.serial = (char *)"QRSTUVWXYZABCDEF";
    right.state = (char *)"absent";
    right.problem = (char *)"unplugged";
    right.missed = 120;
    right.losses = 1;
    Airy__WallSupply supply = AIRY__WALL_SUPPLY__INIT, *supplies[] = { &supply };
    supply.name = (char *)"main";
    supply.amps = supply.amps_limit = 4;
    supply.amps_wanted = 5;
    Airy__WallState wall = AIRY__WALL_STATE__INIT, *walls[] = { &wall };
    wall.name = (char *)"lobby";
    wall.width = 64;
    wall.height = 16;
    wall.rate = 60;
    wall.leds = 1024;
    wall.source = (char *)"live";
    wall.fps = wall.frames_per_second = 60;
    wall.ticks = 3601;
    wall.ticks_missed = 1;
    wall.late_ms = &late;
    wall.skew_ms = &skew;
    wall.frames = 3602;
    wall.shown = 3600;
    wall.dropped = 2;
    wall.exposure = -1.5;
    wall.realtime = 1;
    wall.boards = boards;
    wall.n_boards = 2;
    wall.supplies = supplies;
    wall.n_supplies = 1;
    Airy__Controller used = AIRY__CONTROLLER__INIT, unread = used, *controllers[] = { &used, &unread };
    used.kind = unread.kind = (char *)"fadecandy";
    used.serial = left.serial;
    used.path = left.path;
    used.wall = wall.name;
    unread.path = (char *)"1-4.3";
    unread.problem = (char *)"its serial cannot be read: permission denied";
    Airy__WallReply reply = AIRY__WALL_REPLY__INIT;
    reply.walls = walls;
    reply.n_walls = 1;
    reply.controllers = controllers;
    reply.n_controllers = 2;
    each(&(struct vector){ .name = "wall_reply",
                           .what = "the answer to wall_list: a wall, one of whose boards is gone, and a controller without a permission",
                           .type = WIRE_WALL_REPLY,
                           .id = 8,
                           .body = &reply.base },
         ctx);

    Airy__WallState small = AIRY__WALL_STATE__INIT, *one[] = { &small };
    Airy__Payload preview = AIRY__PAYLOAD__INIT;
    small.name = (char *)"sign";
    small.width = 2;
    small.height = 1;
    small.source = (char *)"held";
    preview.kind = AIRY__PAYLOAD__KIND__INLINE;
    preview.size = 6;
    Airy__WallReply shown = AIRY__WALL_REPLY__INIT;
    shown.walls = one;
    shown.n_walls = 1;
    shown.preview = &preview;
    each(&(struct vector){ .name = "wall_reply_preview",
                           .what = "a preview of 2 x 1 pixels, whose 6 bytes came as DATA",
                           .type = WIRE_WALL_REPLY,
                           .id = 12,
                           .body = &shown.base },
         ctx);

    Airy__Region need = AIRY__REGION__INIT;
    need.x = 860;
    need.width = 1060;
    need.height = 1080;
    Airy__Payload none = AIRY__PAYLOAD__INIT;
    Airy__Result result = AIRY__RESULT__INIT;
    result.output = &none;
    result.need = &need;
    each(&(struct vector){ .name = "result_wall",
                           .what = "the frame of request 11 waits for its tick; what the wall's panels needed of it",
                           .type = WIRE_RESULT,
                           .id = 11,
                           .body = &result.base },
         ctx);
    Airy__Error mistake = AIRY__ERROR__INIT;
    mistake.code = FAULT_WALL;
    mistake.symbol = (char *)"WALL";
    mistake.text = (char *)"line 12: rate is 0, expected 1 to 240";
    mistake.field = (char *)"wall";
    each(&(struct vector){ .name = "error_wall",
                           .what = "the definition of request 9 has a mistake",
                           .type = WIRE_ERROR,
                           .id = 9,
                           .body = &mistake.base },
         ctx);
}

void wall_vectors(each_vector each, void *ctx)
{
    wall_question_vectors(each, ctx);
    wall_answer_vectors(each, ctx);
}
