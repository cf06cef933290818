# SPDX-License-Identifier: Apache-2.0
"""What comes back: the frame, and its account, as dataclasses named as airy.proto names its fields.

A frame in a memfd is mapped, not copied: `data` and `array` look into the mapping, and keep it for as long as they live. It is
mapped only when it is sealed against shrinking and as long as it is said to be, so that nobody can take the pages away.
"""
from __future__ import annotations

import math
import mmap
import os
import secrets
from dataclasses import dataclass, field
from typing import Any, Optional, Union

from . import errors


@dataclass(frozen=True)
class Energy:
    """Sums over R+G+B of all pixels, scene-linear."""

    input: float = 0.0
    bright: float = 0.0
    bloomed: float = 0.0
    lost: float = 0.0
    clamped: float = 0.0
    suppressed: float = 0.0


@dataclass(frozen=True)
class NonFinite:
    """Samples; first_* is the first NaN or infinity in row order, when `any` is set."""

    nan: int = 0
    positive_inf: int = 0
    negative_inf: int = 0
    negative: int = 0
    any: bool = False
    first_x: int = 0
    first_y: int = 0
    first_channel: str = ""


@dataclass(frozen=True)
class Times:
    """Milliseconds."""

    queue: float = 0.0
    load: float = 0.0
    decode: float = 0.0
    bloom: float = 0.0
    encode: float = 0.0
    total: float = 0.0


@dataclass(frozen=True)
class Target:
    """One bloomed layer: a part, a view."""

    name: str
    min_x: int
    min_y: int
    width: int
    height: int
    untouched: bool
    plan: str
    rule: str
    levels: int
    error_bound: float
    max_bright: float
    energy: Energy
    nonfinite: NonFinite
    saturated: int
    tiles: int
    tiles_bright: int
    skipped: str
    storage: str
    exposure: float
    predicted_ms: float


@dataclass(frozen=True)
class Asset:
    """An image that the daemon keeps: name it as dirt=asset.digest, or psf="image:" + asset.digest."""

    digest: str
    width: int
    height: int


@dataclass(frozen=True)
class Device:
    name: str
    kind: str
    driver: str


@dataclass(frozen=True)
class Limits:
    max_frame_bytes: int
    max_width: int
    max_height: int
    max_pixels: int
    credit_bytes: int
    max_requests: int
    max_body_bytes: int


@dataclass(frozen=True)
class Welcome:
    """What the daemon is and can."""

    server: str
    features: frozenset[str]
    limits: Limits
    device: Device
    looks: tuple[str, ...]


@dataclass(frozen=True)
class Status:
    server: str
    device: Device
    uptime_s: float
    clients: int
    queued: int
    running: int
    done: int
    failed: int
    cancelled: int
    pixels: int
    bytes_in: int
    bytes_out: int
    rss_bytes: int
    mean_ms: Times
    draining: bool


@dataclass(frozen=True)
class Shape:
    """How the output's bytes become an array again: the input's shape and NumPy type."""

    shape: tuple[int, ...]
    dtype: str

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * int(self.dtype[-1])


@dataclass(frozen=True)
class Region:
    """Pixels of the display window, from its corner."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True)
class Result:
    """data is None after plan() and show(); the first target's figures are at hand as plan, bound, energy and nonfinite. need:
    with a wall, what of the frame its panels' light comes from. stamp: of an EXR file, the attribute "airy" that the output has."""

    id: int
    data: Optional[memoryview]
    targets: tuple[Target, ...]
    ms: Times
    device: str
    chunks: int
    chunks_copied: int
    notes: tuple[str, ...]
    exposure: float
    need: Optional[Region] = None
    stamp: str = ""
    shape: Optional[Shape] = field(default=None, repr=False)

    @property
    def plan(self) -> str:
        return self.targets[0].plan if self.targets else ""

    @property
    def bound(self) -> float:
        """|glow - exact| <= bound * intensity * max_bright, of every target."""
        return max((t.error_bound for t in self.targets), default=0.0)

    @property
    def energy(self) -> Energy:
        return self.targets[0].energy if self.targets else Energy()

    @property
    def nonfinite(self) -> NonFinite:
        return self.targets[0].nonfinite if self.targets else NonFinite()

    @property
    def array(self) -> Any:
        """The picture as a NumPy array of the input array's shape and type; of a wall, its linear drive, (height, width, 3)
        float32. No copy. Read-only, but of output="buffer"."""
        if self.shape is None or self.data is None:
            raise errors.InvalidRequest(
                "there is an array when one went in, and of a wall's drive; this has .data", field="array"
            )
        import numpy

        return numpy.frombuffer(self.data, dtype=self.shape.dtype).reshape(self.shape.shape)

    def tobytes(self) -> bytes:
        return bytes(self._some())

    def save(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Writes the output whole or not at all: beside it, synced, then renamed over it."""
        data = self._some()
        name = os.fspath(path)
        beside = os.path.join(os.path.dirname(name), f".{os.path.basename(name)}.airy-{secrets.token_hex(8)}")
        fd = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            with open(fd, "wb") as f:
                f.write(data)
                f.flush()
                os.fsync(f.fileno())
            os.replace(beside, name)
        except BaseException:
            os.unlink(beside)
            raise

    def _some(self) -> memoryview:
        if self.data is None:
            raise errors.InvalidRequest("a plan, or a frame that is on a wall, has no picture", field="data")
        return self.data


# ---- from protobuf ---------------------------------------------------------------------------------


def times(m: Any) -> Times:
    return Times(m.queue, m.load, m.decode, m.bloom, m.encode, m.total)


def device(m: Any) -> Device:
    return Device(m.name, m.kind, m.driver)


def _fields(cls: Any, m: Any) -> Any:
    return cls(**{name: getattr(m, name) for name in cls.__dataclass_fields__})


def target(m: Any) -> Target:
    values = {name: getattr(m, name) for name in Target.__dataclass_fields__}
    values["energy"] = _fields(Energy, m.energy)
    values["nonfinite"] = _fields(NonFinite, m.nonfinite)
    return Target(**values)


def welcome(m: Any) -> Welcome:
    limits: Limits = _fields(Limits, m.limits)
    for name in Limits.__dataclass_fields__:
        if not getattr(limits, name):
            raise errors.PeerFault(f"the daemon's WELCOME states 0 as {name}, expected more", field=f"limits.{name}")
    return Welcome(m.server, frozenset(m.features), limits, device(m.device), tuple(m.looks))


def status(m: Any) -> Status:
    values = {name: getattr(m, name) for name in Status.__dataclass_fields__}
    values["device"] = device(m.device)
    values["mean_ms"] = times(m.mean_ms)
    return Status(**values)


def result(m: Any, id: int, data: Optional[memoryview], shape: Optional[Shape]) -> Result:
    return Result(
        id=id,
        data=data,
        targets=tuple(target(t) for t in m.targets),
        ms=times(m.ms),
        device=m.device,
        chunks=m.chunks,
        chunks_copied=m.chunks_copied,
        notes=tuple(m.notes),
        exposure=m.exposure,
        need=_fields(Region, m.need) if m.HasField("need") else None,
        stamp=m.stamp,
        shape=shape,
    )


def map_output(fd: int, offset: int, size: int) -> memoryview:
    """These bytes of a memfd that came; the descriptor stays the caller's."""
    import fcntl

    try:
        seals = fcntl.fcntl(fd, fcntl.F_GET_SEALS)
    except OSError:
        seals = 0
    if not seals & fcntl.F_SEAL_SHRINK:
        raise errors.PeerFault("the result's descriptor is not a memfd sealed with F_SEAL_SHRINK", field="output")
    there = os.fstat(fd).st_size
    if offset > there or size > there - offset:
        raise errors.PeerFault(
            f"the result is said to be {size} bytes from {offset} on; its memfd has {there} bytes", field="output.size"
        )
    if not size:
        return memoryview(b"")
    skip = offset % mmap.ALLOCATIONGRANULARITY
    # Private: kernels before 6.7 refuse shared maps of a memfd that is sealed against writing.
    mapped = mmap.mmap(fd, size + skip, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ, offset=offset - skip)
    return memoryview(mapped)[skip : skip + size]
