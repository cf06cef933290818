/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_help.h - the pieces that help texts are made of, on standard output, in lines of 79 columns.
 */
#ifndef AIRY_CMD_HELP_H
#define AIRY_CMD_HELP_H

#include "cmd_options.h"

void help_option(const struct option_row *r);
void help_params(void); /* of the bloom: every one, with its range and default */

#endif
