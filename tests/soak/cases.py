# SPDX-License-Identifier: Apache-2.0
"""The requests of a soak: inputs made from a seed, parameters, and the truth about each.

A case is plain JSON, for clients in any language:
    {"id", "input": path, "raw": null or {"width", "height", "type", "channels"}, "exr": {"pixels", "compression"},
     "params": {name: number or text}, "dirt": path or null, "pixels": width * height}
Its truth is the SHA-256 of the bytes that a calm daemon gives for it. The same bytes in have the same bytes out, at any load,
in any language, by any way: that is what every later frame is held to.
"""
from __future__ import annotations

import hashlib
import os
import random
import struct
import subprocess
from pathlib import Path
from typing import Any

Case = dict[str, Any]

SMALL = [(1, 1), (2, 3), (17, 5), (64, 64), (129, 257), (320, 180)]
LARGE = [(640, 360), (1280, 720), (1920, 1080), (3840, 2160)]
KERNEL_PIXELS_MAX = 1280 * 720  # whole kernels are convolved on the host: seconds beyond this
SCENE_PIXELS_MAX = 640 * 360  # the demo's frames take a second of CPU at this size

# The high bytes of samples, by a random byte: mostly dark, some at the threshold, a few lamps. All finite and positive.
_HALF = bytes([0x28 + i % 0x10 if i < 200 else 0x38 + i % 8 if i < 250 else 0x4C + i % 8 for i in range(256)])
_FLOAT = bytes([0x3C + i % 3 if i < 250 else 0x40 + i % 3 for i in range(256)])


def params_of(rng: random.Random, pixels: int, exr: bool) -> tuple[dict[str, Any], bool]:
    """One set of parameters, and whether a dirt image belongs to it."""
    n = lambda low, high: round(rng.uniform(low, high), 3)
    sums = [
        {},
        {"threshold": n(0.1, 3), "knee": n(0, 0.5)},
        {"psf": f"gaussians:sigma={n(1, 4)}/{n(5, 30)}/1%,weight=.1/.05/.03", "tolerance": 1e-4},
        {"psf": f"octaves:sigma={n(0.8, 2)},count={rng.randint(2, 7)},weight=.4,slope={n(0, 1.5)}", "near": n(0, 2)},
        {"psf": "halation:sigma=12/7/4,gain=.3/.15/.05", "bright": "channel", "clamp": n(4, 30)},
        {"bright": "smoothstep", "threshold": n(0.3, 1.5), "knee": n(0.1, 0.9), "firefly": n(2, 9)},
        {"exposure": "auto", "key": 0.25, "threshold_unit": "stops", "threshold": n(-1, 3)},
        {"exposure": n(-2, 2), "display": rng.choice(["aces", "reinhard"]), "encoding": rng.choice(["srgb", "gamma2.2"])},
        {"composite": "mix", "intensity": n(0.1, 1), "tolerance": 1e-2, "storage": "half"},
        {"edge": "fill", "tolerance": 1e-5},
        {"show": rng.choice(["bright", "bloom", "residual", "source"])},
        {"bloom": "off"},
        {"nonfinite": "zero", "saturation": n(0, 2), "display": "aces"},
        {"look": "half-gaussian"},
        {"look": "mip-chain", "sun": "x=50%,y=20%,radius=5%,gain=2,tint=1:.9:.7"},
        {"look": "three-scale", "stages": "6", "tint": "1:1:1/1:.9:.8"},
        {"look": "three-scale", "kawase": rng.randint(1, 6)},
        {"look": "jimenez", "radius": n(0.3, 2), "legacy_gain": rng.choice(["off", "on"])},
        {"look": "airy-eight", "threshold": n(0.5, 1.5)},
    ]
    kernels = [{"psf": f"eye:degrees={rng.randint(20, 90)}"}, {"psf": "airy:f=11,weight=.2"}, {"psf": f"aperture:blades={rng.randint(3, 9)},weight=.2"}]
    of_files = [{"layers": "bright/bloom/level:0"}, {"grow": rng.choice(["8", "3%"])}, {"layers": "source", "grow": "4"}]
    which = rng.random()
    if which < 0.12 and pixels <= KERNEL_PIXELS_MAX:
        return rng.choice(kernels), False
    if which < 0.3 and exr:
        return rng.choice(of_files), False
    if which < 0.4:
        return {"dirt_gain": n(0.2, 1)}, True
    return rng.choice(sums), False


def samples(rng: random.Random, count: int, kind: str) -> bytearray:
    size = 2 if kind == "half" else 4
    data = bytearray(rng.randbytes(count * size))
    data[size - 1 :: size] = data[size - 1 :: size].translate(_HALF if kind == "half" else _FLOAT)
    return data


def exr_file(width: int, height: int, kind: str, data: bytes) -> bytes:
    """An uncompressed scanline file with B, G and R, by the format's description; data: rows of B, then G, then R."""
    size, number = (2, 1) if kind == "half" else (4, 2)
    text = lambda s: s.encode() + b"\0"
    attribute = lambda name, type, value: text(name) + text(type) + struct.pack("<I", len(value)) + value
    channels = b"".join(text(c) + struct.pack("<IB3xII", number, 0, 1, 1) for c in "BGR") + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<II", 20000630, 2)
    for name, type, value in [
        ("channels", "chlist", channels),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]:
        head += attribute(name, type, value)
    head += b"\0"
    row = 3 * size * width
    first = len(head) + 8 * height
    out = bytearray(head + b"".join(struct.pack("<Q", first + y * (8 + row)) for y in range(height)))
    for y in range(height):
        out += struct.pack("<iI", y, row) + data[y * row : (y + 1) * row]
    return bytes(out)


class Inputs:
    """Files in a folder, each made once."""

    def __init__(self, folder: Path, scene: str, seed: int) -> None:
        self.folder, self.scene, self.seed = folder, scene, seed

    def make(self, width: int, height: int, form: str, kind: str) -> Path:
        path = self.folder / f"{form}-{kind}-{width}x{height}"
        if path.exists():
            return path
        rng = random.Random(f"{self.seed} {path.name}")
        if form == "scene":
            subprocess.run([self.scene, path, str(width), str(height)], check=True, stderr=subprocess.DEVNULL)
        elif form == "exr":
            path.write_bytes(exr_file(width, height, kind, samples(rng, 3 * width * height, kind)))
        else:
            path.write_bytes(samples(rng, (4 if form == "rgba" else 3 if form == "rgb" else 1) * width * height, kind))
        return path


def make_case(rng: random.Random, inputs: Inputs, size: tuple[int, int], number: int) -> Case:
    pixels = size[0] * size[1]
    form = rng.choice(["exr", "exr", "rgb", "rgba", "y"] + ["scene"] * (2 if pixels <= SCENE_PIXELS_MAX else 0))
    kind = "half" if form == "scene" else rng.choice(["half", "float"])
    file = form in ("exr", "scene")
    params, dirty = params_of(rng, pixels, file)
    exr = {}
    if file and rng.random() < 0.6:
        exr["pixels"] = rng.choice(["keep", "half", "float"])
        exr["compression"] = rng.choice(["none", "rle", "zips", "zip"] + ([] if pixels > SCENE_PIXELS_MAX else ["piz", "pxr24", "b44", "dwaa"]))
    raw = None if file else {"width": size[0], "height": size[1], "type": kind, "channels": {"rgb": "RGB", "rgba": "RGBA", "y": "Y"}[form]}
    return {
        "id": number,
        "input": str(inputs.make(*size, form, kind)),
        "raw": raw,
        "exr": exr,
        "params": params,
        "dirt": str(inputs.make(64, 36, "scene", "half")) if dirty else None,
        "pixels": pixels,
    }


def make_cases(seed: int, inputs: Inputs, count: int, large: bool) -> list[Case]:
    """Small sizes often, each of the large ones at least twice."""
    rng = random.Random(seed)
    sizes = [s for s in LARGE for _ in range(2)] if large else []
    sizes += [SMALL[i % len(SMALL)] for i in range(count - len(sizes))]
    return [make_case(rng, inputs, size, i) for i, size in enumerate(sizes)]


def options_of(case: Case, digest: str | None) -> dict[str, Any]:
    """The Python client's keywords for it; digest: of its dirt, as the daemon gave it."""
    options = {**case["params"], **case["exr"]}
    if digest:
        options["dirt"] = digest
    return options


def source_of(case: Case) -> Any:
    import airy

    raw = case["raw"]
    return case["input"] if raw is None else airy.Raw(case["input"], raw["width"], raw["height"], raw["type"], raw["channels"])


def digest_of(data: Any) -> str:
    return hashlib.sha256(data).hexdigest()


def file_digest(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def truths(socket: str, cases: list[Case]) -> dict[int, str]:
    """Each once, one after another, in a daemon that does nothing else. A case that is refused is a mistake of this file."""
    import airy

    found = {}
    with airy.Client(socket, timeout=60) as client:
        for case in cases:
            dirt = client.asset(case["dirt"]).digest if case["dirt"] else None
            try:
                found[case["id"]] = digest_of(client.bloom(source_of(case), **options_of(case, dirt)).data)
            except airy.DaemonError as e:
                raise SystemExit(f"soak: {e}: case {case}")
    return found
