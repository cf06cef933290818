# SPDX-License-Identifier: Apache-2.0
"""Part one: a daemon under the load of many kinds of clients, of which some are killed, stopped, or hostile from the start.

Lanes run clients, one process after another; now and then all stop, and what the daemon has left when the last client is gone is
compared with what it had at first: descriptors and threads exactly, memory as Plan.rss_text says.
"""
from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from cases import Case, file_digest
from host import Daemon, Sample, until
from tally import Tally, quarters

STUCK_S = 300  # a client that is not done so long after it should be is stuck
REST_S = 90
LANES = 4
CLIENT_S = (0.3, 5.0)
RSS_SHARE, RSS_MIB = 1.10, 32  # the last quarter's idle memory against the first's after warm-up


@dataclass
class Plan:
    """Where everything is."""

    work: Path
    airy: str
    python: str
    node: list[str] | None  # the program and what it is given at the end; None: there is none
    here: Path
    cases: list[Case]
    truth: dict[int, str]
    tally: Tally

    def spec(self, name: str, daemon: Daemon, **more: Any) -> Path:
        path = self.work / name
        path.write_text(json.dumps({"socket": daemon.path, "cases": self.cases, "work": str(self.work), **more}))
        return path

    def judge(self, kind: str, line: dict[str, Any], seed: int) -> None:
        """One line of a client."""
        tally = self.tally
        if "sha" in line:
            tally.count("frames", kind)
            if line["sha"] != self.truth[line["case"]]:
                tally.wrong("frames", f"{kind} {seed}: {line['sha'][:16]}, expected {self.truth[line['case']][:16]}: {self.cases[line['case']]}")
        elif "wrong" in line:
            tally.wrong("hostile", f"{line['fault']} (seed {seed}): {line['wrong']}")
        elif "fault" in line:
            tally.count("faults", line["fault"])
            tally.count("ended", line["ended"])
        elif "cancelled" in line:
            tally.count("faults", "cancelled by a client")
        elif line.get("retryable"):
            tally.count("refused", line["error"])
        else:
            tally.wrong("clients", f"{kind} {seed}: {line.get('text', line)}: {self.cases[line['case']]}")


def lines_of(path: Path) -> list[dict[str, Any]]:
    """Whole lines; the last one of a client that was killed may be a part."""
    return [json.loads(line) for line in path.read_text().split("\n")[:-1]]


class Lane:
    """A thread's worth of clients, one after another."""

    def __init__(self, plan: Plan, daemon: Daemon, spec: Path, number: int, seed: int) -> None:
        self.plan, self.daemon, self.spec, self.number = plan, daemon, spec, number
        self.rng = random.Random(f"{seed} lane {number}")
        self.folder = plan.work / f"lane{number}"
        # However slow the machine is, one of each kind runs.
        self.first: Optional[str] = ["command", "node" if plan.node else "hostile", "hostile", "python"][number]

    def run(self, end: float) -> None:
        try:
            while (left := end - time.monotonic()) > 0:
                self.folder.mkdir()
                self.one(min(left, self.rng.uniform(*CLIENT_S)))
                shutil.rmtree(self.folder)
        except Exception as e:  # a fault of this program's own must not look like success
            self.plan.tally.wrong("clients", f"lane {self.number}: {type(e).__name__}: {e}")

    def one(self, seconds: float) -> None:
        kinds = {"python": 30, "command": 25, "hostile": 30, "wall": 5, "node": 20 if self.plan.node else 0}
        kind = self.first or self.rng.choices(list(kinds), list(kinds.values()))[0]
        self.first = None
        seed = self.rng.randrange(1, 2**31)
        if kind == "command":
            self.command(seed)
        elif kind == "wall":
            self.wall(seed, seconds)
        else:
            self.program(kind, seed, seconds)

    # ---- processes ---------------------------------------------------------------------------------

    def spawn(self, args: list[Any]) -> subprocess.Popen[bytes]:
        with open(self.folder / "out", "wb") as out, open(self.folder / "err", "wb") as err:
            return subprocess.Popen([str(a) for a in args], stdout=out, stderr=err, stdin=subprocess.DEVNULL)

    def said(self) -> str:
        return (self.folder / "err").read_text(errors="replace")[-600:]

    def ended(self, what: str, process: subprocess.Popen[bytes], seconds: float) -> int:
        try:
            return process.wait(seconds + STUCK_S)
        except subprocess.TimeoutExpired:
            self.plan.tally.wrong("clients", f"{what} is stuck, {STUCK_S} s after it should have ended: {self.said()}")
            process.kill()
            return process.wait()

    def trouble(self, kind: str, process: subprocess.Popen[bytes], seconds: float, kinds: dict[str, int]) -> str:
        """At a random moment: one of these things, or nothing. Says which it was."""
        what = self.rng.choices(list(kinds), list(kinds.values()))[0]
        if what:
            try:
                process.wait(self.rng.random() * seconds)
                return ""
            except subprocess.TimeoutExpired:
                process.send_signal(getattr(signal, what))
            self.plan.tally.count("faults", f"{what} of {kind}")
            if what == "SIGSTOP":
                time.sleep(self.rng.random() * 2)
                process.send_signal(signal.SIGCONT)
        return what

    # ---- kinds -------------------------------------------------------------------------------------

    def program(self, kind: str, seed: int, seconds: float) -> None:
        plan = self.plan
        arguments = [self.spec, seed, f"{seconds:.2f}"]
        if kind == "node":
            assert plan.node
            args = [plan.node[0], plan.here / "client.mjs", *arguments, *plan.node[1:]]
        else:
            args = [plan.python, plan.here / ("client.py" if kind == "python" else "hostile.py"), *arguments]
        process = self.spawn(args)
        what = self.trouble(kind, process, seconds + 0.5, {"": 6, "SIGKILL": 3, "SIGSTOP": 1})
        status = self.ended(f"{kind} {seed}", process, seconds)
        plan.tally.count("clients", kind)
        for line in lines_of(self.folder / "out"):
            plan.judge(kind, line, seed)
        if status != 0 and (what, status) != ("SIGKILL", -9):
            plan.tally.wrong("clients", f"{kind} {seed}: exit status {status}: {self.said()}")

    def command(self, seed: int) -> None:
        """airy bloom, of a frame or a range; what stands under a final name is right, however it ended."""
        plan, rng = self.plan, random.Random(seed)
        case = rng.choice([c for c in plan.cases if not c["raw"]])
        frames = rng.randint(1, 4 if case["pixels"] < 2**20 else 1)
        (self.folder / "in").mkdir()
        (self.folder / "o").mkdir()
        for i in range(1, frames + 1):
            (self.folder / "in" / f"{i}.exr").symlink_to(case["input"])
        args = [plan.airy, "bloom", f"{self.folder}/in/@.exr", "-o", f"{self.folder}/o/@.exr", "-f", f"1-{frames}", "--json", "-q"]
        process = self.spawn([*args, "--socket", self.daemon.path, *command_options(case), "-j", rng.randint(1, 4)])
        what = self.trouble("command", process, 0.6, {"": 6, "SIGKILL": 2, "SIGINT": 1, "SIGTERM": 1})
        status = self.ended(f"airy {seed}", process, 0)
        plan.tally.count("clients", "command")
        files = sorted(os.listdir(self.folder / "o"))
        for name in files:
            if not name.startswith("."):
                plan.judge("command", {"case": case["id"], "sha": file_digest(self.folder / "o" / name)}, seed)
        hidden = [f for f in files if f.startswith(".")]
        allowed = {"": [0], "SIGKILL": [-9, 0], "SIGINT": [-2, 0], "SIGTERM": [-15, 0]}[what]
        if status not in allowed:
            plan.tally.wrong("clients", f"airy bloom {seed}: exit status {status}, expected {allowed}: {self.said()}")
        if hidden and status != -9:
            plan.tally.wrong("clients", f"airy bloom {seed}: left {hidden} with exit status {status}")
        if status == 0 and len(files) != frames:
            plan.tally.wrong("clients", f"airy bloom {seed}: exit status 0, and {files} of {frames} frames")

    def wall(self, seed: int, seconds: float) -> None:
        """A wall without boards: opened, played on for a while, closed."""
        plan, name = self.plan, f"lane{self.number}"
        yaml = self.folder / "wall.yaml"
        yaml.write_text(
            f"wall: {name}\nrate: 50\nhold: forever\npicture: {{tone map: aces}}\npanels:\n"
            "  - {grid: [2, 1], name: tile, size: [16, 16], wiring: {serpentine: true}}\n"
            f"boards:\n  - {{serial: L{self.number}, panels: [tile]}}\n"
        )
        wall = lambda verb, *more: [plan.airy, "wall", verb, *more, "--socket", self.daemon.path]

        def run(*args: Any) -> int:
            return self.ended(f"airy wall {seed}", self.spawn(list(args)), 0)

        # While another one is being closed the daemon says BUSY, and the command 5.
        if not until(lambda: run(*wall("open", yaml, "--keep")) != 5, 60) or "error" in self.said():
            plan.tally.wrong("clients", f"airy wall open {seed}: {self.said()}")
            return
        case = self.rng.choice([c for c in plan.cases if not c["raw"] and c["pixels"] < 2**20])
        process = self.spawn([*wall("play", case["input"], "--wall", name, "--loop")])
        what = self.rng.choice(["SIGINT", "SIGKILL"])
        time.sleep(seconds)
        process.send_signal(getattr(signal, what))
        status = self.ended(f"airy wall play {seed}", process, 0)
        if status not in ([-9] if what == "SIGKILL" else [0, -2]):
            plan.tally.wrong("clients", f"airy wall play {seed}: exit status {status} after {what}: {self.said()}")
        if (status := run(*wall("close", name))) != 0:
            plan.tally.wrong("clients", f"airy wall close {seed}: exit status {status}: {self.said()}")
        plan.tally.count("clients", "wall")
        plan.tally.count("faults", f"{what} of wall play")


def command_options(case: Case) -> list[str]:
    options = [a for name, value in {**case["exr"], **case["params"]}.items() for a in ("--" + name.replace("_", "-"), str(value))]
    return options + (["--dirt", case["dirt"]] if case["dirt"] else [])


# ---- the whole -------------------------------------------------------------------------------------


class Load:
    def __init__(self, plan: Plan, daemon: Daemon, idle: Sample, seed: int, stall: bool) -> None:
        self.plan, self.daemon, self.idle = plan, daemon, idle
        self.spec = plan.spec("load.json", daemon, stall=stall)
        self.lanes = [Lane(plan, daemon, self.spec, i, seed) for i in range(LANES)]
        self.idle_descriptors = daemon.descriptors()

    def run(self, seconds: float, rests: int) -> None:
        for _ in range(rests):
            self.stretch(seconds / rests)
            if not self.daemon.alive():
                self.plan.tally.wrong("alive", f"airyd ended: {self.daemon.log()}")
                return
            self.rest()

    def stretch(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        threads = [threading.Thread(target=lane.run, args=(end,)) for lane in self.lanes]
        for t in threads:
            t.start()
        while any(t.is_alive() for t in threads) and self.daemon.alive():
            self.plan.tally.loaded.append(self.daemon.sample())
            time.sleep(max(0.2, seconds / 100))
        for t in threads:
            t.join()

    def rest(self) -> None:
        """All clients are gone: so must be all that was theirs."""
        same = lambda: self.daemon.sample()[1:] == self.idle[1:]
        if not until(same, 1 if "idle" in self.plan.tally.failures else REST_S):
            now = self.daemon.sample()
            more = [d for d in self.daemon.descriptors() if d not in self.idle_descriptors]
            self.plan.tally.wrong("idle", f"{now.fds} descriptors, {now.threads} threads {REST_S} s after the last client; idle: {self.idle.fds}, {self.idle.threads}; {more[:8]}")
        self.plan.tally.rested.append(self.daemon.sample())

    def judge_memory(self) -> str:
        tally = self.plan.tally
        first, last = quarters([s.rss_mib for s in tally.rested])
        most = first * RSS_SHARE + RSS_MIB
        if last > most:
            tally.wrong("rss", f"{last:.0f} MiB idle in the last quarter; of {first:.0f} MiB at most {most:.0f} may become; all: {[round(s.rss_mib) for s in tally.rested]}")
        return f"idle memory stays: {first:.0f} MiB, {last:.0f} MiB, at most {most:.0f} (medians of the first and last quarter of {len(tally.rested)} rests after the warm-up; x {RSS_SHARE} + {RSS_MIB} MiB)"
