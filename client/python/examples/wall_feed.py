# SPDX-License-Identifier: Apache-2.0
"""wall_feed.py WALL.yaml [SECONDS] - opens an LED wall and feeds it a picture that moves, each frame for a tick of its own.

draw() is what to put your own pixels into: linear light, (height, width, 3), float16 or float32; brighter than 1 glows."""
import sys
import time
from pathlib import Path

import airy
import numpy as np

WIDTH, HEIGHT = 192, 108
AHEAD_NS = 50_000_000  # frames are given so long before their time


def draw(t: float) -> np.ndarray:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] / np.array([HEIGHT, WIDTH]).reshape(2, 1, 1)
    spot = np.exp(-((x - 0.5 - 0.4 * np.sin(t)) ** 2 + (y - 0.5) ** 2) / 0.002)
    return (0.02 + spot[..., None] * np.array([8.0, 4.0, 1.0])).astype(np.float16)


with airy.Client() as client:
    wall = client.wall_open(Path(sys.argv[1]))
    print(f"{wall.name}: {wall.leds} LEDs, {wall.rate:g} frames/s; {sum(b.state == 'ready' for b in wall.boards)} boards ready")
    client.show(draw(0), wall.name)  # the first one takes longest: what it needs is made
    step_ns, begin = int(1e9 / wall.rate), time.monotonic_ns()
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 1e9
    due = begin + AHEAD_NS
    while due < begin + seconds * 1e9:
        time.sleep(max(0, due - AHEAD_NS - time.monotonic_ns()) / 1e9)
        try:
            client.show(draw((due - begin) / 1e9), wall.name, present_ns=due)
        except airy.errors.NoWall:  # the daemon was started again: so is the wall
            client.wall_open(Path(sys.argv[1]))
        except airy.ConnectionLost:
            pass  # that frame's time has gone
        due = max(due + step_ns, time.monotonic_ns())
    time.sleep(AHEAD_NS / 1e9)
    state = client.wall_list(wall.name).walls[0]
    print(f"{state.frames} frames, {state.shown} shown, {state.dropped} dropped")
