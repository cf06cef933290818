/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_message.h - WALL and WALL_REPLY: what clients ask of walls, and what they are told. The socket thread's; blocks on
 * nothing.
 */
#ifndef AIRYD_WALL_MESSAGE_H
#define AIRYD_WALL_MESSAGE_H

#include "airy.pb-c.h"
#include "body.h"
#include "scheduler.h"
#include "walls.h"

struct wall_desk { /* what it takes to answer */
    struct walls *walls;
    struct asset_cache *assets;
    struct sched *sched;
    struct block_pool *blocks;
};

/* Does what m asks, for this client. *preview: NULL, or the pixels to be sent as DATA before the reply (a block of the pool's, *bytes of
 * it). *r: the reply, in the arena, valid until it is reset. 0, or -1 and *f. */
int wall_message(const struct wall_desk *d, const Airy__Wall *m, const void *client, struct body_arena *arena,
                 Airy__WallReply **r, struct block **preview, uint64_t *bytes, struct fault *f);

#endif
