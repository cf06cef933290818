/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_metrics.h - a daemon's status in the text format of Prometheus, version 0.0.4: names of the family "airyd_", base units (seconds, bytes).
 */
#ifndef AIRY_CMD_METRICS_H
#define AIRY_CMD_METRICS_H

#include <stdio.h>

#include "airy.h"

/* walls may be NULL: a daemon without them, or one that does not tell. */
void metrics_print(FILE *out, const struct airy_status *s, const struct airy_wall_reply *walls);

#endif
