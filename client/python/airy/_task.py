# SPDX-License-Identifier: Apache-2.0
"""What an engine carries to its one end: a Request (BLOOM, ASSET), with a payload, or a Question (STATUS, WALL), without.

Each knows whether it may be asked again on another connection: what gives the same answer however often it is asked, and whose
input is still at hand. A frame that is shown has its time, and a wall that is opened, closed or tested is not as before.
"""
from __future__ import annotations

from typing import Any, Callable, Optional

from . import payload
from ._wire import Type

ProgressCallback = Callable[[str, float], None]


def _nothing(_: Any) -> None:
    pass


class _Task:
    """`on_end` is called once, from within whatever drives the engine."""

    def __init__(self, kind: Type, body: Any, idempotent: bool) -> None:
        self.kind = kind
        self.body = body
        self.idempotent = idempotent
        self.id = 0
        self.tries = 0  # after BUSY
        self.resent = 0  # after the connection went
        self.not_before = 0.0
        self.received = bytearray()
        self.ended = False
        self.value: Any = None
        self.error: Optional[BaseException] = None
        self.on_end: Callable[[Any], None] = _nothing

    def end(self, error: Optional[BaseException], value: Any = None) -> None:
        self.ended = True
        if self.error is None:
            self.error = error
        self.value = value
        # No cycle may keep a mapped frame alive until somebody collects garbage.
        on_end, self.on_end = self.on_end, _nothing
        on_end(self)


class Request(_Task):
    def __init__(
        self,
        kind: Type,
        body: Any,
        prepared: payload.Prepared,
        plan_only: bool = False,
        progress: Optional[ProgressCallback] = None,
        idempotent: bool = True,
    ) -> None:
        super().__init__(kind, body, idempotent)
        self.prepared = prepared
        self.plan_only = plan_only
        self.progress = progress
        self.fraction = 0.0
        self.sent = False  # at least once
        self.cancelled = False
        self.on_sent: Callable[[Request], None] = _nothing

    @property
    def size(self) -> int:
        return self.prepared.size

    def end(self, error: Optional[BaseException], value: Any = None) -> None:
        self.prepared.close()
        self.on_sent = _nothing
        super().end(error, value)


class Question(_Task):
    """`make` turns the answer's message, and the bytes of DATA before it, into what `value` is."""

    def __init__(
        self,
        kind: Type,
        body: Any,
        answer: Type,
        make: Callable[[Any, bytes], Any],
        idempotent: bool = True,
        data_max: int = 0,
    ) -> None:
        super().__init__(kind, body, idempotent)
        self.answer = answer
        self.make = make
        self.data_max = data_max
