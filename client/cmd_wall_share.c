// SPDX-License-Identifier: Apache-2.0
// cmd_wall_share.c - airy wall share: the part of a frame that one machine of a split wall needs. The daemon's own plan says it, so
// that the halo is that of the bloom which will run; the frame itself is a hole.
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cmd_asset.h"
#include "cmd_wall_asked.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"

enum { HALF_BYTES = 2 };

static const struct wall_syntax syntax = {
    .name = "wall share",
    .help = "airy wall share FILE --frame WxH [bloom parameters]\n"
            "\n"
            "For a wall that is split over several machines: the region of a frame of this size that the panels of FILE need, the\n"
            "reach of the glow included. A source that sends raw parts (libairy's frame_width, frame_x ...) has to send that\n"
            "much; whole frames may always be sent. Lock the exposure by value: no part knows the whole frame's.\n"
            "\n"
            "    airy wall share left.yaml --frame 3840x1080 --psf gaussians:sigma=8/32,weight=.1/.05\n",
    .expected = "one definition, FILE, and --frame WxH",
    .operands_min = 1,
    .operands_max = 1,
    .options = 1 << WALL_OPTION_FRAME | 1 << WALL_OPTION_JSON | 1 << WALL_OPTION_DEVICE,
    .params = true,
};

/* A frame of this size without a byte in it. */
static int frame_make(struct airy_request *r, const struct wall_asked *a, struct airy_error *e)
{
    static const char *const names[] = { "R", "G", "B" };
    void *map;
    uint64_t row = (uint64_t)a->frame_width * HALF_BYTES, plane = row * a->frame_height;
    r->width = r->frame_width = a->frame_width;
    r->height = r->frame_height = a->frame_height;
    r->type = AIRY_HALF;
    r->n_channels = 3;
    for (unsigned i = 0; i < 3; i++)
        r->channels[i] = (struct airy_channel){ names[i], i * plane, row, HALF_BYTES };
    r->input_fd = airy_memfd(3 * plane, &map, e);
    if (r->input_fd < 0)
        return -1;
    munmap(map, (size_t)(3 * plane));
    return 0;
}

static struct airy_result *plan(struct wall_use *u, const struct wall_asked *a, struct airy_error *e)
{
    static struct airy_request request;
    struct airy_result *result = NULL;
    uint64_t id;
    if (assets_send(u->session.airy, &a->request, &request, e) < 0 || frame_make(&request, a, e) < 0)
        return NULL;
    request.wall = u->name;
    request.plan_only = true;
    if (airy_submit(u->session.airy, &request, &id, e) == 0)
        airy_wait(u->session.airy, id, -1, &result, e);
    close(request.input_fd);
    return result;
}

static void say(const struct wall_use *u, const struct wall_asked *a, const struct airy_region *n)
{
    double share = (double)n->width * n->height / ((double)a->frame_width * a->frame_height);
    struct json j = { .out = stdout };
    if (!a->json) {
        printf("%s needs x %d to %lld, y %d to %lld of %ux%u: %ux%u+%d+%d, %.1f %% of the frame\n", u->name, n->x,
               (long long)n->x + n->width - 1, n->y, (long long)n->y + n->height - 1, a->frame_width, a->frame_height, n->width,
               n->height, n->x, n->y, 100 * share);
        return;
    }
    json_open(&j, NULL, '{');
    json_string(&j, "wall", u->name);
    json_count(&j, "frame_width", a->frame_width);
    json_count(&j, "frame_height", a->frame_height);
    json_integer(&j, "x", n->x);
    json_integer(&j, "y", n->y);
    json_count(&j, "width", n->width);
    json_count(&j, "height", n->height);
    json_close(&j, '}');
    json_line(&j);
}

int cmd_wall_share(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct wall_use u;
    struct airy_error e;
    int rc = wall_asked_read(&a, &syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    if (!a.frame_width) {
        cmd_complain("%s: --frame WxH expected, the size of the whole frame", syntax.name);
        return CMD_USAGE;
    }
    stop_install();
    enum cmd_exit exit = wall_use_open(&u, a.operand[0], &a.session, syntax.name);
    if (exit != CMD_DONE)
        return exit;
    struct airy_result *r = plan(&u, &a, &e);
    if (!r) {
        exit = wall_complain(syntax.name, &e);
    } else if (!r->has_need || !r->need.width || !r->need.height) {
        cmd_complain("%s: the daemon does not say what it needs; restart it with a newer airyd", syntax.name);
        exit = CMD_OTHER;
    } else {
        say(&u, &a, &r->need);
    }
    airy_result_free(r);
    wall_use_close(&u);
    return exit;
}
