/* SPDX-License-Identifier: Apache-2.0 */
/* seeds.h - what make_seeds.c and seeds_talk.c share: inputs in the making. A seed that is too long stops the tool. */
#ifndef AIRY_SEEDS_H
#define AIRY_SEEDS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct seed {
    size_t size;
    uint8_t bytes[1 << 18];
};

void seed_add(struct seed *s, const void *bytes, size_t n);
void seed_number(struct seed *s, uint64_t v, unsigned bytes); /* little-endian */
void seed_write(const char *target, const char *name, const struct seed *s);
/* A whole message as steps of fuzz_conn, or (long_steps) of fuzz_libairy. */
void seed_message(struct seed *s, const uint8_t *message, size_t n, bool long_steps);
/* A whole message as an input of fuzz_body, when it has a body of protobuf. */
void seed_body(const char *name, const uint8_t *message, size_t n);

/* Starts that daemon, talks to it as a client does, and writes what both ends said. 0, or -1: said why. */
int seeds_talk(const char *airyd);

#endif
