# SPDX-License-Identifier: Apache-2.0
"""What a soak counts and what it finds wrong. Any thread."""
from __future__ import annotations

import threading
from collections import Counter
from statistics import median
from typing import Sequence

from host import Sample

SHOWN_MAX = 20  # of the failures of one check


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def quarters(values: Sequence[float]) -> tuple[float, float]:
    """Medians of the first and the last quarter, after the first quarter, the warm-up, has been left out."""
    warm = values[max(1, len(values) // 4) :] if len(values) > 1 else values
    n = max(1, len(warm) // 4)
    return median(warm[:n]), median(warm[-n:])


class Tally:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.counts: Counter[tuple[str, str]] = Counter()
        self.failures: dict[str, list[str]] = {}
        self.loaded: list[Sample] = []
        self.rested: list[Sample] = []
        self.back_s: list[float] = []

    def count(self, table: str, name: str, n: int = 1) -> None:
        with self._lock:
            self.counts[table, name] += n

    def wrong(self, check: str, text: str) -> None:
        with self._lock:
            self.failures.setdefault(check, []).append(text)

    def total(self, table: str) -> int:
        return sum(n for (t, _), n in self.counts.items() if t == table)

    def of(self, table: str) -> str:
        return ", ".join(f"{name} {n}" for (t, name), n in sorted(self.counts.items()) if t == table) or "none"


class Tap:
    """Lines of TAP, from what a tally found."""

    def __init__(self, tally: Tally) -> None:
        self.tally, self.n, self.failed = tally, 0, 0

    def check(self, name: str, text: str) -> None:
        self.n += 1
        why = self.tally.failures.get(name, [])
        print(f"{'not ok' if why else 'ok'} {self.n} - {text}", flush=True)
        for line in why[:SHOWN_MAX]:
            print("# " + line.replace("\n", "\n# "), flush=True)
        if len(why) > SHOWN_MAX:
            print(f"# and {len(why) - SHOWN_MAX} more", flush=True)
        self.failed += bool(why)

    def end(self) -> int:
        print(f"1..{self.n}", flush=True)
        return 1 if self.failed else 0
