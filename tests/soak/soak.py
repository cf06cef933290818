# SPDX-License-Identifier: Apache-2.0
"""soak.py - a real airyd under mixed clients and faults for long, and then killed again and again; see load.py and kills.py. Prints TAP and
one table; the exit status is 1 when anything was wrong.

    MINUTES or LOAD_SECONDS   of load        ROUNDS   of kills        SEED    of all that is chosen (not of the machine's timing)
    LARGE=0              no frames beyond 320 x 180              AIRY, AIRYD, SCENE, NODE, NODE_PACKAGE, WORK   where things are
"""
from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from cases import Inputs, make_cases, truths
from host import Daemon, until
from hostile import Session, first_of_each_kind
from kills import Kills
from load import Load, Plan
from tally import Tally, Tap, percentile, quarters

TIMEOUT_S = 20  # of the daemon: for a stalled upload, a reply not read
LARGE_CASES, SMALL_CASES = 48, 12
# Two frames of 4K at work and no more: admission is a part of the test.
DAEMON_OPTIONS = ["--warm", "common", "--threads", "2", "--timeout-s", str(TIMEOUT_S), "--memory-bytes", "6G"]


def settle(daemon: Daemon) -> None:
    """Nothing changes any more: twice the same, half a second apart."""
    last = [daemon.sample()[1:]]

    def same() -> bool:
        time.sleep(0.5)
        last.append(daemon.sample()[1:])
        return last[-1] == last[-2]

    if not until(same, 60):
        raise SystemExit(f"soak: an idle daemon's descriptors and threads change: {last}")


def make_plan(work: Path, seed: int, large: bool) -> Plan:
    node, package = os.environ.get("NODE"), os.environ.get("NODE_PACKAGE")
    (work / "inputs").mkdir()
    inputs = Inputs(work / "inputs", os.environ["SCENE"], seed)
    return Plan(
        work=work,
        airy=os.environ["AIRY"],
        python=sys.executable,
        node=[node, package] if node and package else None,
        here=Path(__file__).resolve().parent,
        cases=make_cases(seed, inputs, LARGE_CASES if large else SMALL_CASES, large),
        truth={},
        tally=Tally(),
    )


def loaded(plan: Plan, tap: Tap, seed: int, seconds: float, rests: int, large: bool) -> None:
    tally = plan.tally
    daemon = Daemon(os.environ["AIRYD"], plan.work, "load", *DAEMON_OPTIONS)
    daemon.start()
    daemon.wait_ready()
    start = time.monotonic()
    plan.truth = truths(daemon.path, plan.cases)
    for _ in range(2):
        first_of_each_kind(Session({"socket": daemon.path, "cases": plan.cases}, random.Random(seed), plan.work))
        settle(daemon)
    idle = daemon.sample()
    print(f"# {len(plan.cases)} cases, {len(set(plan.truth.values()))} different, in {time.monotonic() - start:.1f} s; idle: {idle.fds} descriptors, {idle.threads} threads, {idle.rss_mib:.0f} MiB", flush=True)
    load = Load(plan, daemon, idle, seed, large)
    load.run(seconds, rests)
    for kind in ["python", "command", "hostile"] + ["node"] * bool(plan.node):
        if not tally.counts["clients", kind]:
            tally.wrong("clients", f"no client of kind {kind} ran")
    if (again := truths(daemon.path, plan.cases) if daemon.alive() else {}) != plan.truth:
        tally.wrong("frames", f"after the load other frames come than before it, of cases {[i for i in again if again[i] != plan.truth[i]]}")
    tap.check("frames", f"no frame is wrong: {tally.total('frames')} were as in a calm daemon")
    tap.check("clients", f"{tally.total('clients')} clients ended as they should: {tally.of('clients')}")
    tap.check("hostile", f"{tally.total('ended')} hostile sessions were answered by the protocol")
    tap.check("idle", f"{idle.fds} descriptors and {idle.threads} threads after every one of {len(tally.rested)} rests")
    tap.check("rss", load.judge_memory())
    status = daemon.stop() if daemon.alive() else daemon.process and daemon.process.returncode
    if status != 0:
        tally.wrong("alive", f"airyd ended with status {status}: {daemon.log()}")
    tap.check("alive", "the daemon lived, and ended well")


def killed(plan: Plan, tap: Tap, seed: int, rounds: int) -> None:
    daemon = Daemon(os.environ["AIRYD"], plan.work, "kills", *DAEMON_OPTIONS)
    daemon.start()
    daemon.wait_ready()
    kills = Kills(plan, daemon, seed)
    kills.run(rounds)
    counts = plan.tally.counts
    if rounds and not counts["kills", "daemon"]:
        plan.tally.wrong("kills", "no daemon was killed")
    if len(plan.tally.back_s) != counts["kills", "daemon"]:
        plan.tally.wrong("kills", f"{len(plan.tally.back_s)} of {counts['kills', 'daemon']} new daemons did a frame")
    tap.check("kills", f"kill -9 in {rounds} rounds: no half file, nothing left, no client stuck, the next daemon serves")
    tap.check("frames", "no frame is wrong, those under kills included")
    if (status := daemon.stop()) != 0:
        plan.tally.wrong("last", f"the last airyd ended with status {status}: {daemon.log()}")
    tap.check("last", "the last daemon ended well")


def table(plan: Plan) -> None:
    t = plan.tally
    rows = [
        ("frames", f"{t.total('frames')} ({t.of('frames')})"),
        ("wrong", str(len(t.failures.get("frames", [])))),
        ("clients", f"{t.total('clients')} ({t.of('clients')})"),
        ("faults", f"{t.total('faults')} ({t.of('faults')})"),
        ("ended in", t.of("ended")),
        ("refused", t.of("refused")),
        ("kills", t.of("kills")),
    ]
    if t.rested:
        first, last = t.rested[0], t.rested[-1]
        under = quarters([s.rss_mib for s in t.loaded]) if t.loaded else (0.0, 0.0)
        rows += [
            ("at rest", f"RSS {first.rss_mib:.0f} -> {last.rss_mib:.0f} MiB, descriptors {first.fds} -> {last.fds}, threads {first.threads} -> {last.threads}"),
            ("... RSS MiB", " ".join(f"{s.rss_mib:.0f}" for s in t.rested)),
            ("under load", f"RSS {under[0]:.0f} -> {under[1]:.0f} MiB, most {max(s.rss_mib for s in t.loaded):.0f}; descriptors at most {max(s.fds for s in t.loaded)}, threads {max(s.threads for s in t.loaded)}"),
        ]
    if t.back_s:
        rows.append(("kill -9 to the next frame", f"p50 {percentile(t.back_s, 0.5):.2f} s, p99 {percentile(t.back_s, 0.99):.2f} s of {len(t.back_s)}"))
    for name, text in rows:
        print(f"# {name:26} {text}", flush=True)


def main() -> int:
    number = lambda name, default: float(os.environ.get(name) or default)
    seed = int(number("SEED", time.time()))
    seconds = number("LOAD_SECONDS", 60 * number("MINUTES", 30))
    rounds, large = int(number("ROUNDS", 200)), number("LARGE", 1) != 0
    print(f"# SEED={seed}: {seconds:g} s of load, {rounds} rounds of kills{'' if os.environ.get('NODE') else '; no node, so no Node client'}", flush=True)
    plan = make_plan(Path(os.environ["WORK"]), seed, large)
    tap = Tap(plan.tally)
    # A shell's background job ignores SIGINT, and so would all that is started here.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    loaded(plan, tap, seed, seconds, max(3, min(20, int(seconds // 30))), large)
    if rounds:
        killed(plan, tap, seed, rounds)
    table(plan)
    return tap.end()


if __name__ == "__main__":
    sys.exit(main())
