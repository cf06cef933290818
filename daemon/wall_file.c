// SPDX-License-Identifier: Apache-2.0
// wall_file.c - see wall_file.h.
#include "wall_file.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static char *read_file(const char *path, uint64_t max, size_t *bytes, struct fault *f)
{
    FILE *file = fopen(path, "re");
    char *data = NULL;
    long size = -1;
    if (!file || fseek(file, 0, SEEK_END) < 0 || (size = ftell(file)) < 0 || fseek(file, 0, SEEK_SET) < 0)
        fault_set(f, FAULT_WALL, "--wall", "%.200s: %s", path, strerror(errno));
    else if ((uint64_t)size > max)
        fault_set(f, FAULT_LIMIT, "--wall", "%.200s has %ld bytes; at most %llu are read", path, size, (unsigned long long)max);
    else if (!(data = malloc((size_t)size + 1)))
        fault_set(f, FAULT_NO_MEMORY, "--wall", "no memory for %ld bytes", size);
    else if ((*bytes = fread(data, 1, (size_t)size, file)) != (size_t)size) {
        fault_set(f, FAULT_WALL, "--wall", "%.200s: read %zu of %ld bytes", path, *bytes, size);
        free(data);
        data = NULL;
    }
    if (file)
        fclose(file);
    return data;
}

// A path in the definition counts from the definition's folder.
static int beside(char out[PATH_MAX], const char *path, const char *name, struct fault *f)
{
    const char *slash = strrchr(path, '/');
    const int folder = slash && name[0] != '/' ? (int)(slash + 1 - path) : 0;
    const int n = snprintf(out, PATH_MAX, "%.*s%s", folder, path, name);
    return n < PATH_MAX ? 0 : fault_set(f, FAULT_WALL, "--wall", "%.200s: the calibration's path is too long", path);
}

static int read_gains(const struct job_env *env, const char *path, struct asset **out, struct fault *f)
{
    struct exr_worker *worker = NULL;
    size_t bytes = 0;
    const _Atomic bool never = false;
    char *data = read_file(path, env->limits.max_frame_bytes, &bytes, f);
    int rc = data ? 0 : -1;
    if (data && exr_worker_create(&worker))
        rc = fault_set(f, FAULT_NO_MEMORY, "--wall", "no memory for reading %.200s", path);
    if (rc == 0)
        rc = asset_keep(env->assets, data, bytes, &env->limits.exr, worker, &never, out, f);
    exr_worker_destroy(worker);
    free(data);
    return rc;
}

static int open_text(struct walls *w, const struct job_env *env, const char *path, const char *text, size_t bytes, struct fault *f)
{
    struct wall_def *d;
    struct asset *gains = NULL;
    struct wall_ref *r;
    char image[PATH_MAX];
    if (wall_def_parse(&d, text, bytes, NULL, f) < 0)
        return -1;
    int rc = 0;
    if (*d->calibration)
        rc = beside(image, path, d->calibration, f) < 0 ? -1 : read_gains(env, image, &gains, f);
    wall_def_free(d);
    if (rc == 0)
        rc = walls_open(w, text, bytes, gains, NULL, &r, f);
    asset_release(env->assets, gains);
    return rc;
}

int wall_file_open(struct walls *w, const struct job_env *env, const char *path, struct fault *f)
{
    size_t bytes = 0;
    char *text = read_file(path, WALL_TEXT_MAX, &bytes, f);
    if (!text)
        return -1;
    int rc = open_text(w, env, path, text, bytes, f);
    free(text);
    if (rc == 0 || f->code != FAULT_WALL || !strcmp(f->field, "--wall"))
        return rc;
    struct fault inner = *f;
    return fault_set(f, FAULT_WALL, "--wall", "%.120s: %.180s", path, inner.text);
}
