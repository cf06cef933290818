# SPDX-License-Identifier: Apache-2.0
"""A real airyd, and what /proc says of it."""
from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Callable, NamedTuple

START_S = 120
STOP_S = 120


class Sample(NamedTuple):
    rss_mib: float
    fds: int
    threads: int


def until(what: Callable[[], object], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not what():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


class Daemon:
    def __init__(self, airyd: str, work: Path, name: str, *options: str) -> None:
        self.airyd, self.options = airyd, options
        self.path = str(work / f"{name}.sock")
        self.log_path = work / f"{name}.log"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with open(self.log_path, "ab") as log:
            self.process = subprocess.Popen([self.airyd, "--socket", self.path, *self.options], stderr=log, stdin=subprocess.DEVNULL)

    def listens(self) -> bool:
        assert self.process is not None
        if self.process.poll() is not None:
            raise SystemExit(f"soak: airyd ended with status {self.process.returncode}:\n{self.log()}")
        with socket.socket(socket.AF_UNIX) as s:
            try:
                s.connect(self.path)
                return True
            except OSError:
                return False

    def wait_ready(self) -> None:
        if not until(self.listens, START_S):
            raise SystemExit(f"soak: airyd does not listen after {START_S} s:\n{self.log()}")

    def alive(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """SIGTERM; its exit status, -9 when it had to be killed."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
            return -9

    def log(self) -> str:
        return self.log_path.read_text(errors="replace")[-2000:] if self.log_path.exists() else ""

    def sample(self) -> Sample:
        assert self.process is not None
        folder = f"/proc/{self.process.pid}"
        pages = int(Path(folder, "statm").read_text().split()[1])
        return Sample(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, len(os.listdir(folder + "/fd")), len(os.listdir(folder + "/task")))

    def descriptors(self) -> list[str]:
        assert self.process is not None
        folder, found = f"/proc/{self.process.pid}/fd", []
        for fd in os.listdir(folder):
            try:
                found.append(os.readlink(f"{folder}/{fd}"))
            except FileNotFoundError:
                pass
        return sorted(found)
