#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# embed.sh OUT_DIR - compiles every variant of every pass with glslang and writes OUT_DIR/spirv.h and, for
# the named looks, OUT_DIR/spirv_look.h: the words of each, and a table of names. A variant's name says its -D flags; daemon/bloom_pipeline.c and
# daemon/look_targets.c ask by name. One glslang a CPU.
set -eu
cd "$(dirname "$0")/.."
out=$1
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
one() { # name file flags...
    echo "$@" >>"$tmp/list"
}
one fullscreen fullscreen.vert
# Names that end in _s16 read and write levels of half.
passes() { # suffix flags...
    suffix=$1
    shift
    for order in 0 4 6 8; do
        for channels in 1 3; do
            one bright_o${order}_c$channels$suffix bright.frag -DORDER=$order -DCHANNELS=$channels "$@"
            one bright_o${order}_c${channels}_half$suffix bright.frag -DORDER=$order -DCHANNELS=$channels -DHALF "$@"
        done
        one composite_o$order$suffix composite.frag -DORDER=$order "$@"
        one composite_o${order}_half$suffix composite.frag -DORDER=$order -DHALF "$@"
        [ $order = 0 ] && continue
        one down_o$order$suffix down.frag -DORDER=$order "$@"
        one down_layered_o$order$suffix down.frag -DORDER=$order -DLAYERED "$@"
        one down_vertical_o$order$suffix down.frag -DORDER=$order -DLAYERED -DVERTICAL "$@"
        one up_o$order$suffix up.frag -DORDER=$order "$@"
    done
    for reach in 1 2 3 4 6 10; do
        one blur_h_r$reach$suffix blur.frag -DREACH=$reach "$@"
        one blur_h_layered_r$reach$suffix blur.frag -DREACH=$reach -DLAYERED "$@"
        one blur_v_r$reach$suffix blur.frag -DREACH=$reach -DVERTICAL "$@"
        one blur_v_add_r$reach$suffix blur.frag -DREACH=$reach -DVERTICAL -DADD_SAME "$@"
    done
}
passes ""
passes _s16 -DSTORE_HALF
for order in 0 4 6 8; do
    for channels in 1 3; do
        one develop_o${order}_c$channels develop.frag -DORDER=$order -DCHANNELS=$channels
        one develop_o${order}_c${channels}_half develop.frag -DORDER=$order -DCHANNELS=$channels -DHALF
    done
done
for channels in 1 3; do
    one extract_c$channels extract.frag -DCHANNELS=$channels
    one extract_c${channels}_half extract.frag -DCHANNELS=$channels -DHALF
    one histogram_c$channels histogram.comp -DCHANNELS=$channels
    one histogram_c${channels}_half histogram.comp -DCHANNELS=$channels -DHALF
done
for channels in 1 3; do
    one wall_columns_c$channels wall_columns.frag -DCHANNELS=$channels
done
for half in "" _half; do
    one wall_rows_input$half wall_rows.frag -DINPUT ${half:+-DHALF}
    one wall_rows_output$half wall_rows.frag -DOUTPUT ${half:+-DHALF}
done
one wall_rows_level wall_rows.frag
one wall_rows_layered wall_rows.frag -DLAYERED
compile='
name=$1 file=$2
shift 2
glslangValidator --quiet -V --target-env vulkan1.3 -Ishaders "$@" --vn "spirv_$name" -o "$0/$name.h" "shaders/$file" >"$0/$name.log" ||
    { cat "$0/$name.log"; echo "shaders/$file $*"; exit 255; } >&2'
finish() { # header table: what `one` has listed
    xargs -L 1 -P "$(nproc)" sh -c "$compile" "$tmp" <"$tmp/list"
    {
        echo "/* Made by shaders/embed.sh. */"
        echo "#include <stddef.h>"
        echo "#include <stdint.h>"
        while read -r name _; do
            cat "$tmp/$name.h"
        done <"$tmp/list" | sed -e '/#pragma/d' -e 's/^const/static const/'
        echo "struct spirv_entry { const char *name; const uint32_t *words; size_t bytes; };"
        echo "static const struct spirv_entry $2[] = {"
        sed 's/ .*//; s/.*/    { "&", spirv_&, sizeof(spirv_&) },/' "$tmp/list"
        echo "};"
    } >"$tmp/header"
    mv "$tmp/header" "$out/$1"
    rm "$tmp/list"
}
finish spirv.h spirv_table
for matte in "" _matte; do
    m=${matte:+-DMATTE}
    one load$matte stage.frag -DLOAD $m
    one load_half$matte stage.frag -DLOAD -DHALF $m
    for all in "" _all; do
        one store$all$matte store.frag $m ${all:+-DALL}
        one store_half$all$matte store.frag -DHALF $m ${all:+-DALL}
    done
done
one sample stage.frag -DSAMPLE
one sample_add stage.frag -DSAMPLE -DADD
one rows stage.frag -DROWS
one mix stage.frag -DMIX
one sum stage.frag -DSUM
one sum_pixels stage.frag -DSUM -DPIXELS
for half in "" _half; do
    one halve$half stage.frag -DLOAD_HALF ${half:+-DHALF}
    one load_rows$half stage.frag -DLOAD_ROWS ${half:+-DHALF}
done
finish spirv_look.h spirv_look_table
