# SPDX-License-Identifier: Apache-2.0
"""What a daemon says of LED walls, as dataclasses named as airy.proto names its fields; airy-wall(5) is how one is described."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from . import errors


@dataclass(frozen=True)
class Percentiles:
    """Milliseconds, over the last 4096."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class WallBoard:
    """A controller of the wall; state is "ready", "absent", "opening" or "failed"."""

    name: str
    kind: str
    serial: str
    state: str
    problem: str
    path: str
    sent: int
    dropped: int
    missed: int
    stalls: int
    timeouts: int
    errors: int
    losses: int
    rendered: int
    received: int
    latency_ms: Percentiles
    amps: float
    amps_wanted: float


@dataclass(frozen=True)
class WallSupply:
    """amps_limit 0: it has none."""

    name: str
    amps: float
    amps_wanted: float
    amps_limit: float


@dataclass(frozen=True)
class WallState:
    """source is "none", "live", "held", "fading", "black" or "pattern"; counters begin when the wall is opened."""

    name: str
    width: int
    height: int
    rate: float
    leds: int
    source: str
    fps: float
    frames_per_second: float
    ticks: int
    ticks_missed: int
    late_ms: Percentiles
    skew_ms: Percentiles
    frames: int
    shown: int
    dropped: int
    exposure: float
    realtime: bool
    boards: tuple[WallBoard, ...]
    supplies: tuple[WallSupply, ...]


@dataclass(frozen=True)
class Controller:
    """Plugged in, of a kind that can be driven; wall: the one that uses it. reading: its serial is not known yet, ask again."""

    kind: str
    serial: str
    path: str
    wall: str
    problem: str
    reading: bool


@dataclass(frozen=True)
class Walls:
    """usb: why there is no USB at all, or empty."""

    walls: tuple[WallState, ...]
    controllers: tuple[Controller, ...]
    usb: str


@dataclass(frozen=True)
class Preview:
    """What was sent to the boards last: `data` is rows of R, G, B bytes of sRGB; pixels without an LED are 0."""

    wall: WallState
    data: bytes = field(repr=False)

    @property
    def array(self) -> Any:
        """(height, width, 3) uint8."""
        import numpy

        return numpy.frombuffer(self.data, numpy.uint8).reshape(self.wall.height, self.wall.width, 3)


# ---- from protobuf ---------------------------------------------------------------------------------

_NESTED: dict[str, Any] = {
    "late_ms": lambda m: _fields(Percentiles, m),
    "skew_ms": lambda m: _fields(Percentiles, m),
    "latency_ms": lambda m: _fields(Percentiles, m),
    "boards": lambda list: tuple(_fields(WallBoard, b) for b in list),
    "supplies": lambda list: tuple(_fields(WallSupply, s) for s in list),
}


def _fields(cls: Any, m: Any) -> Any:
    return cls(**{name: _NESTED.get(name, lambda v: v)(getattr(m, name)) for name in cls.__dataclass_fields__})


def _no_preview(m: Any, data: bytes) -> None:
    if m.preview.kind or m.preview.size or data:
        raise errors.PeerFault(f"a preview of {m.preview.size} bytes came, and none was asked for", field="preview.kind")


def listed(m: Any, data: bytes) -> Walls:
    _no_preview(m, data)
    return Walls(
        tuple(_fields(WallState, w) for w in m.walls), tuple(_fields(Controller, c) for c in m.controllers), m.usb
    )


def one(m: Any, data: bytes) -> WallState:
    _no_preview(m, data)
    return _one(m)


def none(m: Any, data: bytes) -> None:
    _no_preview(m, data)


def _one(m: Any) -> WallState:
    if len(m.walls) != 1:
        raise errors.PeerFault(f"{len(m.walls)} walls came, expected the one that was named", field="walls")
    state: WallState = _fields(WallState, m.walls[0])
    return state


def preview(m: Any, data: bytes) -> Preview:
    """Exactly the pixels of the one wall, or nothing."""
    state = _one(m)
    want = state.width * state.height * 3
    if m.preview.kind != INLINE or m.preview.size != len(data) or len(data) != want:
        raise errors.PeerFault(
            f"a preview of {want} bytes is said to be kind {m.preview.kind} of {m.preview.size}, {len(data)} came",
            field="preview.size",
        )
    return Preview(state, data)


INLINE = 1  # of Payload.Kind
