// SPDX-License-Identifier: Apache-2.0
// panel_kinds.c - the controllers that can be driven, by enum wall_board_kind. A new one is a file and a line here.
#include "panel.h"

const struct panel_ops *const panel_kinds[WALL_BOARD_KINDS] = {
    [WALL_FADECANDY] = &panel_fadecandy,
    [WALL_GUD] = &panel_gud,
};
