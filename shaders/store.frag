#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// The last stage of a look: composite, display and view (METHODS section 1, steps 7 to 9) into a slot's output planes, 4 rows
// of a texel's pixels a fragment. `add` is the glow (view bright: E) as rows, the sum of its sections. Where it adds exactly 0, and where the input
// is not finite (nonfinite=keep), the input's bits are handed on.
// Drawn in one band a channel, planes[0] this channel's; -D ALL: in one band, every channel at hand, for saturation.
// -D HALF: 8 halfs in a texel, else 4 floats. -D MATTE: src is the matte.
#include "look.glsl"
#include "display.glsl"

layout(location = 0) out uvec4 out0;
layout(location = 1) out uvec4 out1;
layout(location = 2) out uvec4 out2;
layout(location = 3) out uvec4 out3;
layout(constant_id = 0) const int ADD_TEXELS = 0; // a section has the frame's height
layout(constant_id = 1) const int DISPLAY = 0;
layout(constant_id = 2) const int SECTIONS = 1; // 0: no glow
layout(constant_id = 3) const int VIEW = 0;     // 0 final, 1 source, 2 what `add` holds

#ifdef MATTE
layout(rgba32f, set = 0, binding = 0) uniform readonly image2D src;
#endif
layout(rgba32f, set = 0, binding = 1) uniform readonly image2DArray add;
layout(rgba32ui, set = 0, binding = 2) uniform readonly uimage2D planes[3];

// enum view
const int FINAL = 0, SOURCE = 1;

#ifdef HALF
const int WIDE = 8;
const float MOST = 65504.0;
uint bits_of(uvec4 u, int i) { return u[i >> 1] >> (16 * (i & 1)) & 0xffffu; }
float value_of(uint bits) { return unpackHalf2x16(bits).x; }
bool bad_bits(uint bits) { return (bits & 0x7c00u) == 0x7c00u; }
uint packed(float v) { return packHalf2x16(vec2(clamp(v, -MOST, MOST), 0.0)) & 0xffffu; }
#else
const int WIDE = 4;
const float MOST = FLOAT_MAX;
uint bits_of(uvec4 u, int i) { return u[i]; }
float value_of(uint bits) { return uintBitsToFloat(bits); }
bool bad_bits(uint bits) { return nonfinite(bits); }
uint packed(float v) { return floatBitsToUint(clamp(v, -MOST, MOST)); }
#endif

// Up to the tone map, and the glow where it comes after that.
float shown(float scene, float glow)
{
    bool after = stage.numbers.y != 0.0;
    float v = clamp((after ? scene : scene + glow) * stage.numbers.x, 0.0, FLOAT_MAX);
    v = tone_map(v, stage.mode.z);
    return after ? max(v + glow, 0.0) : v;
}

// One sample: the input's bits, its glow or E, the scene's factor, and with ALL what saturation made of it.
uint stored(uint bits, float glow, float factor, float display)
{
    bool bad = bad_bits(bits), same;
    float scene = bad ? 0.0 : value_of(bits) * factor, v;
    // Chosen by constants and selects: a return in the middle costs more than what it saves.
    if (VIEW == SOURCE) {
        v = scene;
        same = !bad && factor == 1.0;
    } else if (VIEW != FINAL) {
        return packed(glow);
    } else if (DISPLAY == 0) {
        v = scene + glow;
        same = !bad && glow == 0.0 && factor == 1.0;
    } else {
#ifdef ALL
        v = encoded(display, stage.mode.w);
#else
        v = encoded(shown(scene, glow), stage.mode.w);
#endif
        same = false;
    }
    uint made = packed(v);
    return same || bad && stage.mode.x != 1 ? bits : made;
}

// Four pixels of a row of the frame.
vec4 glow_of(int texel, int row, int layer)
{
    vec4 sum = vec4(0.0);
    [[unroll]] for (int i = 0; i < SECTIONS; i++) {
        int low, high, first = int(stage.tap[i].x);
        float near, far;
        if (ADD_TEXELS == 1) {
            sum += imageLoad(add, ivec3(texel, first + row, layer));
        } else {
            along(row, int(stage.tap[i].y), stage.dst.y, 0, low, high, near, far);
            sum += imageLoad(add, ivec3(texel, first + low, layer)) * near + imageLoad(add, ivec3(texel, first + high, layer)) * far;
        }
    }
    // Never Inf: Inf times a weight of 0 would be NaN.
    return min(min(sum, FLOAT_MAX) * stage.weight.x, FLOAT_MAX);
}

float factor_at(ivec2 at)
{
#ifdef MATTE
    return 1.0 + imageLoad(src, min(at, stage.dst.xy - 1)).x * (stage.weight.w - 1.0);
#else
    return 1.0;
#endif
}

#ifdef ALL
vec3 scene_of(uint r, uint g, uint b, float factor)
{
    return vec3(bad_bits(r) ? 0.0 : value_of(r), bad_bits(g) ? 0.0 : value_of(g), bad_bits(b) ? 0.0 : value_of(b)) * factor;
}
#endif

uvec4 line(ivec2 q, int row, int block)
{
    uint u[WIDE];
#ifdef ALL
    uvec4 in_r = imageLoad(planes[0], q), in_g = imageLoad(planes[1], q), in_b = imageLoad(planes[2], q);
    uvec4 own = block == 0 ? in_r : block == 1 ? in_g : in_b;
#else
    uvec4 own = imageLoad(planes[0], q);
#endif
    vec4 glow_own[WIDE / 4];
    [[unroll]] for (int i = 0; i < WIDE / 4; i++)
        glow_own[i] = glow_of(q.x * (WIDE / 4) + i, row, block);
#ifdef ALL
    vec4 glow_all[3][WIDE / 4];
    [[unroll]] for (int c = 0; c < 3; c++)
        [[unroll]] for (int i = 0; i < WIDE / 4; i++)
            glow_all[c][i] = glow_of(q.x * (WIDE / 4) + i, row, c);
#endif
    [[unroll]] for (int i = 0; i < WIDE; i++) {
        ivec2 at = ivec2(q.x * WIDE + i, row);
        float factor = factor_at(at), display = 0.0;
#ifdef ALL
        vec3 glow = vec3(glow_all[0][i >> 2][i & 3], glow_all[1][i >> 2][i & 3], glow_all[2][i >> 2][i & 3]);
        vec3 scene = scene_of(bits_of(in_r, i), bits_of(in_g, i), bits_of(in_b, i), factor);
        vec3 v = vec3(shown(scene.r, glow.r), shown(scene.g, glow.g), shown(scene.b, glow.b));
        display = saturated(v, stage.luma.rgb, stage.luma.w)[block];
#endif
        u[i] = stored(bits_of(own, i), glow_own[i >> 2][i & 3], factor, display);
    }
    uvec4 r;
    [[unroll]] for (int i = 0; i < 4; i++)
#ifdef HALF
        r[i] = u[2 * i] | u[2 * i + 1] << 16;
#else
        r[i] = u[i];
#endif
    return r;
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int block = at.y / stage.dst.z, group = at.y - block * stage.dst.z;
    uvec4 rows[4];
    [[unroll]] for (int p = 0; p < 4; p++) {
        int row = min(4 * group + p, stage.dst.y - 1);
        rows[p] = line(ivec2(at.x, row), row, block);
    }
    out0 = rows[0];
    out1 = rows[1];
    out2 = rows[2];
    out3 = rows[3];
}
