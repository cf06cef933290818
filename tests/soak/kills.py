# SPDX-License-Identifier: Apache-2.0
"""Part two: kill -9 of the daemon, of clients, or of both, at random moments while ranges are written.

After each kill: what stands under a final name is whole and right; the daemon that is started at once serves; every client ends,
with the status that is right for it; the next run leaves no temporary file.
"""
from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import threading
import time

import airy
from cases import Case, digest_of, file_digest, options_of, source_of
from host import START_S, Daemon
from load import STUCK_S, Plan, command_options, lines_of

FRAMES = 16
CASES = 4


class Kills:
    def __init__(self, plan: Plan, daemon: Daemon, seed: int) -> None:
        self.plan, self.daemon = plan, daemon
        self.rng = random.Random(f"{seed} kills")
        # Long enough to be met in the middle.
        files = [c for c in plan.cases if not c["raw"] and c["pixels"] < 2**19]
        self.cases = sorted(files, key=lambda c: c["pixels"])[-CASES:]
        self.whole_s: dict[int, float] = {}
        self.probe = min(plan.cases, key=lambda c: (bool(c["dirt"]), c["pixels"]))
        self.spec = plan.spec("kills.json", daemon, reconnect=True)
        self.folder = plan.work / "kills"

    def run(self, rounds: int) -> None:
        self.measure()
        for number in range(rounds):
            try:
                self.round(number)
            except Exception as e:
                self.wrong(number, f"{type(e).__name__}: {e}")

    def wrong(self, number: int, text: str) -> None:
        self.plan.tally.wrong("kills", f"round {number}: {text}")

    # ---- pieces ------------------------------------------------------------------------------------

    def fresh(self, case: Case) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        for sub in ("in", "o"):
            (self.folder / sub).mkdir(parents=True)
        for i in range(1, FRAMES + 1):
            (self.folder / "in" / f"{i}.exr").symlink_to(case["input"])

    def range(self, case: Case) -> subprocess.Popen[bytes]:
        args = [self.plan.airy, "bloom", f"{self.folder}/in/@.exr", "-o", f"{self.folder}/o/@.exr", "-f", f"1-{FRAMES}", "--json", "-q"]
        with open(self.folder / "json", "ab") as out, open(self.folder / "err", "wb") as err:
            return subprocess.Popen([*args, "--socket", self.daemon.path, *command_options(case)], stdout=out, stderr=err, stdin=subprocess.DEVNULL)

    def other(self, number: int) -> tuple[str, subprocess.Popen[bytes]]:
        """A client in another language beside it, which nobody kills."""
        plan = self.plan
        seed, seconds = str(self.rng.randrange(1, 2**31)), "1.0"
        kind = "node" if plan.node and number % 2 else "python"
        args = [plan.node[0], plan.here / "client.mjs"] if plan.node and kind == "node" else [plan.python, plan.here / "client.py"]
        more = plan.node[1:] if plan.node and kind == "node" else []
        with open(self.folder / "lines", "wb") as out, open(self.folder / "other", "wb") as err:
            return kind, subprocess.Popen([str(a) for a in [*args, self.spec, seed, seconds, *more]], stdout=out, stderr=err, stdin=subprocess.DEVNULL)

    def status_of(self, number: int, what: str, process: subprocess.Popen[bytes]) -> int:
        try:
            return process.wait(STUCK_S)
        except subprocess.TimeoutExpired:
            self.wrong(number, f"{what} is stuck for {STUCK_S} s: {self.err()}")
            process.kill()
            return process.wait()

    def err(self) -> str:
        return (self.folder / "err").read_text(errors="replace")[-400:]

    def finals_are_right(self, number: int, case: Case, when: str) -> set[str]:
        names = set(os.listdir(self.folder / "o"))
        for name in sorted(names):
            if not name.startswith("."):
                self.plan.tally.count("frames", "files under kills")
                if file_digest(self.folder / "o" / name) != self.plan.truth[case["id"]]:
                    self.wrong(number, f"{name} is wrong {when}, {(self.folder / 'o' / name).stat().st_size} bytes: {case}")
        return names

    def is_whole(self, number: int, case: Case) -> None:
        names = self.finals_are_right(number, case, "at the end")
        if names != (wanted := {f"{i}.exr" for i in range(1, FRAMES + 1)}):
            self.wrong(number, f"more: {sorted(names - wanted)}, missing: {sorted(wanted - names)}")

    def measure(self) -> None:
        """How long each range takes that nobody disturbs, and that it ends well."""
        for case in self.cases:
            self.fresh(case)
            start = time.monotonic()
            if (status := self.status_of(-1, "airy bloom", self.range(case))) != 0:
                self.wrong(-1, f"undisturbed, airy bloom ends with {status}: {self.err()}")
            self.whole_s[case["id"]] = time.monotonic() - start
            self.is_whole(-1, case)

    def serves(self, number: int, since: float) -> None:
        """Asks until the daemon has done a frame; how long after the kill that was."""
        last: Exception | None = None
        while time.monotonic() < since + START_S:
            try:
                with airy.Client(self.daemon.path, timeout=START_S) as client:
                    dirt = client.asset(self.probe["dirt"]).digest if self.probe["dirt"] else None
                    got = digest_of(client.bloom(source_of(self.probe), **options_of(self.probe, dirt), timeout=START_S).data)
                self.plan.tally.back_s.append(time.monotonic() - since)
                if got != self.plan.truth[self.probe["id"]]:
                    self.wrong(number, f"the first frame of the new daemon is wrong: {self.probe}")
                return
            except (airy.AiryError, TimeoutError) as e:
                last = e
                time.sleep(0.005)
        self.wrong(number, f"no frame {START_S} s after the kill: {last}")

    # ---- a round -----------------------------------------------------------------------------------

    def round(self, number: int) -> None:
        case = self.rng.choice(self.cases)
        victims = self.rng.choices(["daemon", "client", "both"], [3, 1, 1])[0]
        self.fresh(case)
        kind, other = self.other(number)
        run = self.range(case)
        try:
            run.wait(self.rng.random() * self.whole_s[case["id"]])
            self.plan.tally.count("kills", "after the range's end")
        except subprocess.TimeoutExpired:
            pass
        if victims != "daemon":
            run.kill()
            self.plan.tally.count("kills", "client")
        probe = self.kill_daemon(number) if victims != "client" else None
        self.finals_are_right(number, case, "right after the kill")
        self.judge_range(number, case, run, victims)
        self.judge_other(number, kind, other)
        if probe:
            probe.join()
        self.is_whole(number, case)

    def kill_daemon(self, number: int) -> threading.Thread:
        since = time.monotonic()
        self.daemon.kill()
        self.daemon.start()
        self.plan.tally.count("kills", "daemon")
        probe = threading.Thread(target=self.serves, args=(number, since))
        probe.start()
        return probe

    def judge_range(self, number: int, case: Case, run: subprocess.Popen[bytes], victims: str) -> None:
        status = self.status_of(number, "airy bloom", run)
        allowed = [0] if victims == "daemon" else [-signal.SIGKILL, 0]
        # Of a daemon that was killed before the run had connected it says so; nothing was done then.
        said = any(words in self.err() for words in ("no daemon answers", "the daemon closed the connection"))
        unmet = status == 5 and victims == "daemon" and said and not os.listdir(self.folder / "o")
        if status not in allowed and not unmet:
            self.wrong(number, f"airy bloom ends with {status}, {victims} killed, expected {allowed}: {self.err()}")
        if status == 0:
            return
        self.plan.tally.count("kills", "runs begun again")
        self.plan.tally.count("kills", "temporaries found", sum(f.startswith(".") for f in os.listdir(self.folder / "o")))
        self.daemon.wait_ready()
        if (status := self.status_of(number, "airy bloom", self.range(case))) != 0:
            self.wrong(number, f"the next airy bloom ends with {status}: {self.err()}")

    def judge_other(self, number: int, kind: str, other: subprocess.Popen[bytes]) -> None:
        """Python may lose its connection, and must then say so; Node finds the next daemon by itself. What they got is right."""
        status = self.status_of(number, f"the {kind} client", other)
        said = (self.folder / "other").read_text(errors="replace")
        if status != 0 and not (status == 1 and any(w in said for w in ("ConnectionLost", "NoDaemon", "CONNECT"))):
            self.wrong(number, f"the {kind} client ends with {status}: {said[-400:]}")
        for line in lines_of(self.folder / "lines"):
            if kind == "python" and line.get("error") == "LOCAL":
                self.plan.tally.count("kills", "requests lost by python")
            else:
                self.plan.judge(kind, line, number)
