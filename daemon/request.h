/* SPDX-License-Identifier: Apache-2.0 */
/*
 * request.h - a BLOOM or ASSET message -> a job: everything that can be judged without reading the payload is
 * judged here, before a byte of memory is taken for it. Never blocks.
 */
#ifndef AIRYD_REQUEST_H
#define AIRYD_REQUEST_H

#include "airy.pb-c.h"
#include "job.h"

enum { REQUEST_PARAMS_MAX = 64 };

/* Fills a fresh job. The descriptors are taken in any case: into the job, or closed. 0, or -1 and *f. */
int request_read(struct job *j, const Airy__Bloom *b, const int *fds, unsigned n_fds, struct fault *f);
int request_read_asset(struct job *j, const Airy__Asset *a, const int *fds, unsigned n_fds, struct fault *f);

#endif
