/* SPDX-License-Identifier: Apache-2.0 */
/*
 * crew.h - a few threads that share out independent tasks. The caller is member 0 and works too; the others sleep in
 * between, so a run starts no thread and allocates nothing. Which member does which task is left to chance: a task
 * must give the same bytes whoever does it.
 */
#ifndef AIRYD_CREW_H
#define AIRYD_CREW_H

enum { CREW_MAX = 64 };

struct crew;

/* threads: taken as 1 .. CREW_MAX. 0, or -errno. */
int crew_create(struct crew **out, unsigned threads);
void crew_destroy(struct crew *c); /* NULL is fine */
unsigned crew_members(const struct crew *c);
/* Calls fn(ctx, task, member) for each task 0 .. count-1, once; returns when all are done. One caller at a time. */
void crew_run(struct crew *c, unsigned count, void (*fn)(void *ctx, unsigned task, unsigned member), void *ctx);

#endif
