# SPDX-License-Identifier: Apache-2.0
"""client.py SPEC SEED SECONDS - a well-behaved client in Python: frames by every way in and out, several in flight, some cancelled,
blocking or asyncio. One JSON line a frame: {"case", "sha"} or {"case", "error"}, or {"cancelled"}. Whether they are right is its
starter's to say; it may be killed or stopped at any moment.
"""
from __future__ import annotations

import asyncio
import json
import random
import sys
import time
from typing import Any

import airy
from cases import Case, digest_of, options_of, source_of


def say(**line: Any) -> None:
    print(json.dumps(line), flush=True)


def told(case: Case, error: BaseException | None, data: Any) -> None:
    if isinstance(error, airy.Cancelled):
        say(cancelled=case["id"])
    elif isinstance(error, airy.AiryError):
        say(case=case["id"], error=error.symbol, text=str(error), retryable=isinstance(error, airy.DaemonError) and error.retryable)
    elif error is not None:
        raise error
    else:
        say(case=case["id"], sha=digest_of(data))


def ways(rng: random.Random, case: Case) -> dict[str, str]:
    return {"via": rng.choice(["inline", "memfd", "file"]), "output": rng.choice(["inline", "memfd"] + ["buffer"] * bool(case["raw"]))}


def pick(rng: random.Random, cases: list[Case]) -> list[Case]:
    """Few at once when they are large."""
    first = rng.choice(cases)
    return [first] if first["pixels"] > 2**20 else [first, *rng.choices([c for c in cases if c["pixels"] <= 2**20], k=rng.randint(0, 4))]


def blocking(socket: str, cases: list[Case], rng: random.Random, end: float) -> None:
    with airy.Client(socket, timeout=120) as client:
        while time.monotonic() < end:
            flying = []
            for case in pick(rng, cases):
                dirt = client.asset(case["dirt"]).digest if case["dirt"] else None
                flying.append((case, client.submit(source_of(case), **ways(rng, case), **options_of(case, dirt))))
                if rng.random() < 0.1:
                    flying[-1][1].cancel()
            if rng.random() < 0.2:
                client.status(timeout=60)
            for case, pending in flying:
                error = pending.exception()
                told(case, error, None if error else pending.result().data)


async def waiting(socket: str, cases: list[Case], rng: random.Random, end: float) -> None:
    async with airy.aio.Client(socket, timeout=120) as client:

        async def one(case: Case) -> None:
            try:
                dirt = (await client.asset(case["dirt"])).digest if case["dirt"] else None
                result = await client.bloom(source_of(case), **ways(rng, case), **options_of(case, dirt))
            except asyncio.CancelledError:
                say(cancelled=case["id"])
                raise
            except airy.AiryError as e:
                told(case, e, None)
            else:
                told(case, None, result.data)

        while time.monotonic() < end:
            tasks = [asyncio.create_task(one(case)) for case in pick(rng, cases)]
            if rng.random() < 0.2:
                await asyncio.sleep(rng.random() * 0.05)
                tasks[-1].cancel()
            for ended in await asyncio.gather(*tasks, return_exceptions=True):
                if ended is not None and not isinstance(ended, asyncio.CancelledError):
                    raise ended


def main() -> None:
    with open(sys.argv[1]) as f:
        spec = json.load(f)
    rng = random.Random(int(sys.argv[2]))
    end = time.monotonic() + float(sys.argv[3])
    if rng.random() < 0.4:
        asyncio.run(waiting(spec["socket"], spec["cases"], rng, end))
    else:
        blocking(spec["socket"], spec["cases"], rng, end)


main()
