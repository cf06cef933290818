// SPDX-License-Identifier: Apache-2.0
// png.c - libpng's simplified interface.
#include "png.h"

#include <png.h>
#include <stdio.h>

int png_write(const char *path, const uint8_t *rgb, int width, int height)
{
    png_image image = { .version = PNG_IMAGE_VERSION,
                        .width = (png_uint_32)width,
                        .height = (png_uint_32)height,
                        .format = PNG_FORMAT_RGB };
    if (png_image_write_to_file(&image, path, 0, rgb, 0, NULL))
        return 0;
    fprintf(stderr, "%s: %s\n", path, image.message);
    return -1;
}
