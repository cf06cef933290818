/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_asset.h - parameters that name an image by its file: --dirt FILE, --psf image:FILE[,...]. The daemon knows images
 * by digest alone, so the file is sent, and the digest takes its place in the request. A value that names
 * no file is left to the daemon to judge.
 */
#ifndef AIRY_CMD_ASSET_H
#define AIRY_CMD_ASSET_H

#include "airy.h"

/* Is there a parameter that names a file? */
bool assets_named(const struct airy_request *asked);
/* Sends every file that `asked` names, and writes the digests into *sent, which is otherwise a copy. 0, or -1 and *e, whose
 * text names the file. */
int assets_send(struct airy *a, const struct airy_request *asked, struct airy_request *sent,
                struct airy_error *e);

#endif
