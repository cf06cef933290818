// SPDX-License-Identifier: Apache-2.0
// cmd_asset.c - see cmd_asset.h. Nothing is remembered: what was asked is read again for a new daemon.
#include "cmd_asset.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cmd_run.h"

enum { VALUE_MAX = sizeof(((struct airy_param *)0)->value), CODE_NO_ASSET = 223 }; /* PROTOCOL.md's: no such image */

/* A value in three pieces: "image:", the file, ",weight=.2". */
struct named {
    size_t before;
    char path[VALUE_MAX];
    const char *rest;
};

static bool is_file(const char *path)
{
    struct stat s;
    return *path && stat(path, &s) == 0 && S_ISREG(s.st_mode);
}

static bool is_digest(const char *text, size_t len)
{
    return len == 32 && strspn(text, "0123456789abcdefABCDEF") >= 32;
}

/* What is no digest is meant as a file, there or not: the daemon knows digests alone. */
static bool is_meant(const struct named *n)
{
    size_t len = strlen(n->path);
    return len > 0 && !is_digest(n->path, len);
}

static bool name_take(struct named *n, const char *value, size_t before, size_t len)
{
    n->before = before;
    snprintf(n->path, sizeof(n->path), "%.*s", (int)len, value + before);
    n->rest = value + before + len;
    return is_file(n->path);
}

static bool name_read(struct named *n, const struct airy_param *p)
{
    static const char image[] = "image:";
    size_t before = sizeof(image) - 1;
    if (strcmp(p->name, "dirt") == 0)
        return name_take(n, p->value, 0, strlen(p->value)) || is_meant(n);
    if (strcmp(p->name, "psf") != 0 || strncmp(p->value, image, before) != 0)
        return false;
    const char *file = p->value + before;
    /* A name may have a comma; what comes after the first one is more often the psf's own. */
    return name_take(n, p->value, before, strcspn(file, ",")) || name_take(n, p->value, before, strlen(file)) ||
           (name_take(n, p->value, before, strcspn(file, ",")), is_meant(n));
}

bool assets_named(const struct airy_request *asked)
{
    struct named n;
    for (unsigned i = 0; i < asked->n_params; i++)
        if (name_read(&n, &asked->params[i]))
            return true;
    return false;
}

static int failed(struct airy_error *e, const char *path)
{
    char text[sizeof(e->text)];
    snprintf(text, sizeof(text), "%.160s: %.200s", path, e->text);
    memcpy(e->text, text, sizeof(text));
    return -1;
}

static int file_send(struct airy *a, const char *path, struct airy_asset *kept, struct airy_error *e)
{
    char why[RUN_WHY_MAX];
    int fd = run_input_open(path, why, sizeof(why));
    if (fd < 0) {
        *e = (struct airy_error){ .code = CODE_NO_ASSET, .symbol = "NO_ASSET" };
        snprintf(e->text, sizeof(e->text), "%.380s", why);
        return -1;
    }
    int rc = airy_asset(a, fd, NULL, 0, kept, e);
    close(fd);
    return rc < 0 ? failed(e, path) : 0;
}

int assets_send(struct airy *a, const struct airy_request *asked, struct airy_request *sent,
                struct airy_error *e)
{
    *sent = *asked;
    for (unsigned i = 0; i < asked->n_params; i++) {
        const struct airy_param *p = &asked->params[i];
        struct named n;
        struct airy_asset kept;
        if (!name_read(&n, p))
            continue;
        if (file_send(a, n.path, &kept, e) < 0) {
            if (e->code > 0) /* not a lost connection's */
                snprintf(e->field, sizeof(e->field), "params.%.40s", p->name);
            return -1;
        }
        int len = snprintf(sent->params[i].value, VALUE_MAX, "%.*s%s%s", (int)n.before, p->value, kept.digest,
                           n.rest);
        if (len < 0 || len >= VALUE_MAX) {
            *e = (struct airy_error){ .code = -EMSGSIZE, .symbol = "LOCAL" };
            snprintf(e->text, sizeof(e->text), "--%s: the value is too long with the digest", p->name);
            return -1;
        }
    }
    return 0;
}
