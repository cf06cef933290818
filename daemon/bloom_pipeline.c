// SPDX-License-Identifier: Apache-2.0
// bloom_pipeline.c - pipelines by the name of their shader's variant and its specialisation, made when first asked for.
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"
#include "spirv.h"

static const struct spirv_entry *spirv_find(const char *name)
{
    for (unsigned i = 0; i < sizeof(spirv_table) / sizeof(spirv_table[0]); i++)
        if (!strcmp(spirv_table[i].name, name))
            return &spirv_table[i];
    return NULL;
}

static bool starts(const char *name, const char *with) { return !strncmp(name, with, strlen(with)); }

// A free place, or that of the pipeline which no recording has used for longest. (Views, displays and mattes make more variants than
// anybody needs at once; a recording itself has at most PASSES_MAX draws of far fewer pipelines than there are places.)
static struct named_pipeline *place_for(struct bloom *b)
{
    if (b->pipelines < PIPELINES_MAX)
        return &b->pipeline[b->pipelines];
    struct named_pipeline *oldest = &b->pipeline[0];
    for (unsigned i = 1; i < PIPELINES_MAX; i++)
        if (b->pipeline[i].used < oldest->used)
            oldest = &b->pipeline[i];
    assert(oldest->used < b->recordings);
    vk_pipeline_destroy(&b->vk, &oldest->pipeline);
    oldest->name[0] = '\0';
    return oldest;
}

const struct vk_pipeline *pipeline_get(struct bloom *b, struct fault *f, int32_t spec, const char *format, ...)
{
    char name[40];
    va_list args;
    va_start(args, format);
    vsnprintf(name, sizeof(name), format, args);
    va_end(args);
    for (unsigned i = 0; i < b->pipelines; i++)
        if (b->pipeline[i].spec == spec && !strcmp(b->pipeline[i].name, name)) {
            b->pipeline[i].used = b->recordings;
            return &b->pipeline[i].pipeline;
        }
    const struct spirv_entry *s = spirv_find(name);
    assert(s);
    struct named_pipeline *p = place_for(b);
    const bool picture = starts(name, "composite") || starts(name, "develop");
    const bool layered = starts(name, "bright") || starts(name, "extract");
    const bool wall = starts(name, "wall");
    const unsigned attachments = layered ? (strstr(name, "_c3") ? 6 : 2) : wall ? 1 : LEVEL_PHASES;
    const int r = starts(name, "histogram")
                      ? vk_compute_create(&b->vk, &p->pipeline, s->words, s->bytes, f)
                      : vk_pipeline_create(&b->vk, &p->pipeline, s->words, s->bytes,
                                           picture          ? VK_FORMAT_R32G32B32A32_UINT
                                           : strstr(name, "_s16") ? VK_FORMAT_R16G16B16A16_SFLOAT
                                                                  : VK_FORMAT_R32G32B32A32_SFLOAT,
                                           attachments, &spec, layered || picture || wall ? 1 : 0, f);
    if (r < 0)
        return NULL;
    snprintf(p->name, sizeof(p->name), "%s", name);
    p->spec = spec;
    p->used = b->recordings;
    if (p == &b->pipeline[b->pipelines])
        b->pipelines++;
    return &p->pipeline;
}

const uint32_t *pipeline_vertex(size_t *bytes)
{
    const struct spirv_entry *s = spirv_find("fullscreen");
    *bytes = s->bytes;
    return s->words;
}

// Of a shader's variants, how many plain requests have: a bright pass has one a curve; the others one each, whatever else
// the scan of a frame may ask for.
static unsigned plain_variants(const char *name)
{
    static const char *const rare[] = { "fullscreen", "extract", "develop", "histogram", "wall" };
    for (unsigned k = 0; k < sizeof(rare) / sizeof(rare[0]); k++)
        if (starts(name, rare[k]) || strstr(name, "_s16"))
            return 0;
    return starts(name, "bright") ? BRIGHT_SMOOTHSTEP + 1 : 1;
}

unsigned bloom_pipelines(const struct bloom *b, unsigned *possible)
{
    unsigned made = 0;
    *possible = 0;
    for (unsigned i = 0; i < sizeof(spirv_table) / sizeof(spirv_table[0]); i++) {
        const char *name = spirv_table[i].name;
        const unsigned most = plain_variants(name);
        unsigned have = 0;
        for (unsigned k = 0; k < b->pipelines; k++)
            have += !strcmp(b->pipeline[k].name, name);
        *possible += most;
        made += have < most ? have : most;
    }
    return made;
}
