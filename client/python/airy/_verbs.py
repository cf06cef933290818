# SPDX-License-Identifier: Apache-2.0
"""submit() and the verbs that are made of it, said once for the blocking and the asyncio client. Pending is what the one's submit()
gives, and what the other's gives when it is awaited; Done a result, or what gives it when it is awaited."""
from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Callable, Generic, Optional, Sequence, TypeVar, Union

from . import _request, payload, result
from ._request import Output, Param, Part
from ._task import ProgressCallback, Request

Pending = TypeVar("Pending")
Done = TypeVar("Done")
Make = Callable[[result.Welcome], Request]

_PLAN_OPTIONS = {"part", "layer", "view", "show", "pixels", "compression", "via", "channels", "wall", "part_of"}


class Verbs(ABC, Generic[Pending, Done]):
    @abstractmethod
    def _submit(self, make: Make, timeout: Optional[float]) -> Pending:
        """Sends what `make` makes."""

    @abstractmethod
    def _result(self, make: Make, timeout: Optional[float]) -> Done:
        """Sends it, and waits for its result; both within the time."""

    def submit(
        self,
        frame: payload.Source,
        /,
        *,
        part: Union[str, int, None] = None,
        layer: Optional[str] = None,
        view: Optional[str] = None,
        show: Optional[str] = None,
        pixels: Optional[str] = None,
        compression: Optional[str] = None,
        via: Optional[payload.Via] = None,
        output: Optional[Output] = None,
        channels: Optional[Sequence[str]] = None,
        progress: Optional[ProgressCallback] = None,
        wall: Optional[str] = None,
        present_ns: int = 0,
        part_of: Optional[Part] = None,
        priority: int = 0,
        deadline_ms: int = 0,
        timeout: Optional[float] = None,
        **params: Param,
    ) -> Pending:
        """Sends a frame and returns at once, or as soon as the connection's credit allows, within `timeout` seconds (else
        TimeoutError, and nothing was sent); wait with .result().

        part, layer, view (a stereo view), pixels, compression: of an EXR file, as `airy bloom` has them. show is the
        parameter `view`: what the picture shows. via: "inline", "memfd" or "file"; output: "inline", "memfd", "buffer" (of raw
        pixels and arrays: memory of this side's own, and the result's array is writable), or "wall". progress(stage, fraction) is
        called from within the waits. Everything else is a parameter of PROTOCOL.md section 9: threshold=1.5, psf="eye:weight=.1".

        wall: the name of an open wall. The frame then becomes its picture: the result is the wall's linear drive, or, with
        output="wall", nothing, for it is on the wall at the first tick at or after present_ns of time.monotonic_ns(), 0: the next one.
        part_of: the picture is a part of a frame, airy.Part(frame_width, frame_height, x, y).

        priority, -10 to 10, orders what this user has waiting. deadline_ms: a frame that has not had its turn by then ends in
        airy.errors.DeadlineExceeded."""
        return self._submit(
            lambda welcome: _request.bloom(
                welcome,
                frame,
                params,
                part=part,
                layer=layer,
                view=view,
                show=show,
                pixels=pixels,
                compression=compression,
                via=via,
                output=output,
                channels=channels,
                progress=progress,
                wall=wall,
                present_ns=present_ns,
                part_of=part_of,
                priority=priority,
                deadline_ms=deadline_ms,
            ),
            timeout,
        )

    def show(self, frame: payload.Source, wall: str, /, *, timeout: Optional[float] = None, **options: Any) -> Done:
        """Puts a frame on a wall: bloom(frame, wall=wall, output="wall"). Ends when the picture waits for its tick. What is lost
        with its connection is not sent again: its time has gone."""
        return self.bloom(frame, timeout=timeout, wall=wall, output="wall", **options)

    @abstractmethod
    def bloom(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> Done:
        """submit(), and the result."""

    def plan(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> Done:
        """What would run, its bound and its time: nothing is bloomed. Takes submit()'s options, but output and progress. With
        wall=, its result's `need` says what of the frame the wall shows."""
        extra = {k: options.pop(k) for k in _PLAN_OPTIONS & options.keys()}
        return self._result(lambda w: _request.bloom(w, frame, options, plan_only=True, **extra), timeout)
