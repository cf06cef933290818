# SPDX-License-Identifier: Apache-2.0
"""What the tests share: TAP, real daemons, and the conformance suite's payloads. AIRYD, AIRY and SCENE name the programs."""
from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any, Callable

ROOT = Path(__file__).resolve().parents[3]
SUITE = json.loads((ROOT / "tests" / "conformance" / "cases.json").read_text())
VECTORS = ROOT / "proto" / "vectors"
AIRYD = os.environ.get("AIRYD", str(ROOT / "build" / "airyd"))
AIRY = os.environ.get("AIRY", str(ROOT / "build" / "airy"))
SCENE = os.environ.get("SCENE", str(ROOT / "build" / "demo" / "scene"))


class Skip(Exception):
    """Why a test says nothing about what it was to test."""


class Tap:
    def __init__(self) -> None:
        self.n = self.failures = 0

    def run(self, name: str, test: Callable[[], object]) -> None:
        self.n += 1
        name = name.replace("#", "")
        try:
            test()
        except Skip as why:
            print(f"ok {self.n} - {name} # SKIP {why}", flush=True)
            return
        except Exception:
            self.failures += 1
            print(f"not ok {self.n} - {name}")
            print("".join("# " + line + "\n" for line in traceback.format_exc().splitlines()), flush=True)
            return
        print(f"ok {self.n} - {name}", flush=True)

    def end(self) -> int:
        print(f"1..{self.n}", flush=True)
        return 1 if self.failures else 0


def equal(found: Any, expected: Any, what: str = "value") -> None:
    if found != expected:
        raise AssertionError(f"{what} is {short(found)}, expected {short(expected)}")


def short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 200 else text[:200] + "..."


def need(true: Any, why: str) -> None:
    if not true:
        raise AssertionError(why)


def raises(kind: type[BaseException], call: Callable[[], Any]) -> Any:
    try:
        got = call()
    except kind as e:
        return e
    raise AssertionError(f"{kind.__name__} expected, {short(got)} came")


def open_fds() -> list[str]:
    """The descriptors of this process and what they are; the folder's own is left out."""
    found = []
    for fd in os.listdir("/proc/self/fd"):
        try:
            found.append(f"{fd} {os.readlink(f'/proc/self/fd/{fd}')}")
        except FileNotFoundError:
            pass
    return sorted(found)


class Daemon:
    """An airyd of our own on a socket in the work folder."""

    def __init__(self, work: Path, name: str, *options: str) -> None:
        self.path = str(work / f"{name}.sock")
        self.options = options
        self.log = open(work / f"{name}.log", "ab")
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen([AIRYD, "--socket", self.path, *self.options], stderr=self.log)

    def wait_ready(self, seconds: float = 300) -> "Daemon":
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.process.poll() is not None:
                raise AssertionError(f"airyd ended with status {self.process.returncode}, see {self.log.name}")
            with socket.socket(socket.AF_UNIX) as s:
                try:
                    s.connect(self.path)
                    return self
                except OSError:
                    time.sleep(0.02)
        raise AssertionError(f"airyd does not listen after {seconds} s")

    def kill(self, how: int = signal.SIGKILL) -> int:
        self.process.send_signal(how)
        return self.process.wait(120)

    def stop(self) -> None:
        if self.process.poll() is None:
            self.kill()
        self.log.close()


class Payloads:
    """The suite's payloads, each made once, as bytes and as a file."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self.made: dict[str, bytes] = {}

    def __getitem__(self, name: str) -> bytes:
        if name not in self.made:
            self.made[name] = self.make(SUITE["payloads"][name])
        return self.made[name]

    def file(self, name: str) -> str:
        path = self.work / f"payload-{name}"
        if not path.exists():
            path.write_bytes(self[name])
        return str(path)

    def raw(self, name: str) -> dict[str, Any] | None:
        raw: dict[str, Any] | None = SUITE["payloads"][name].get("raw")
        return raw

    def make(self, p: dict[str, Any]) -> bytes:
        if "hex" in p:
            return bytes.fromhex(p["hex"])
        if "of" in p:
            return self[p["of"]][: p["bytes"]]
        if "scene" in p:
            path = self.work / "scene.exr"
            subprocess.run([SCENE, str(path), *map(str, p["scene"])], check=True)
            return path.read_bytes()
        raw = p["raw"]
        if "fill" in raw:
            return struct.pack("<f", raw["fill"]) * (raw["width"] * raw["height"] * len(raw["channels"]))
        half = raw["type"] == "PIXEL_HALF"
        one = struct.Struct("<H" if half else "<I").pack
        spark, dim, opaque = map(one, (0x5000, 0x3000, 0x3C00) if half else (0x42000000, 0x3E000000, 0x3F800000))

        def pixel(light: bytes) -> bytes:
            return b"".join(opaque if c == "A" else light for c in raw["channels"])

        # A row repeats every 61 pixels, and there are 61 different ones.
        width, height = raw["width"], raw["height"]
        lit, dark = pixel(spark), pixel(dim)
        rows = []
        for y in range(min(height, 61)):
            period = b"".join(lit if (7 * x + 13 * y) % 61 == 0 else dark for x in range(61))
            rows.append((period * (width // 61 + 1))[: width * len(lit)])
        return b"".join(rows[y % 61] for y in range(height))


def main(name: str, tests: Callable[[Tap, Path], None]) -> None:
    tap = Tap()
    with tempfile.TemporaryDirectory(prefix="airy-py-") as work:
        tests(tap, Path(work))
    status = tap.end()
    print(f"# {name}", flush=True)
    sys.exit(status)
