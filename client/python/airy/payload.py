# SPDX-License-Identifier: Apache-2.0
"""What a request sends: EXR files and bytes, raw pixels, NumPy arrays, as a payload that the daemon takes.

A path goes as an open file. Bytes and arrays are written once into a memfd that is sealed against shrinking and growing, which
the daemon maps; where there is no memfd they go inline, which every system and language can. NumPy is asked for only when
an array comes.
"""
from __future__ import annotations

import mmap
import os
import stat
import sys
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Optional, Sequence, Union

from . import _transport, errors
from . import airy_pb2 as pb
from .result import Shape

Via = Literal["inline", "memfd", "file"]
Buffer = Union[bytes, bytearray, memoryview, mmap.mmap]

HAS_MEMFD = hasattr(os, "memfd_create")
_NAMES = {1: ("Y",), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
_SAMPLE = {"half": (2, "PIXEL_HALF"), "float": (4, "PIXEL_FLOAT")}


class RawChannel(NamedTuple):
    """Sample (x, y) is at byte offset + y * row_stride + x * pixel_stride of the payload."""

    name: str
    offset: int
    row_stride: int
    pixel_stride: int


@dataclass(frozen=True)
class Raw:
    """Pixels without a file: little-endian samples, row 0 at the top. `channels` is the interleaved order of the names, such
    as "RGBA", for rows without padding; or RawChannels, for any other layout. R, G and B, or Y alone, are bloomed."""

    data: Union[Buffer, str, "os.PathLike[str]"]
    width: int
    height: int
    type: Literal["half", "float"] = "half"
    channels: Sequence[Union[str, RawChannel]] = "RGB"

    def layout(self) -> Any:
        if self.type not in _SAMPLE:
            raise errors.InvalidRequest(f'pixel type {self.type!r}; expected "half" or "float"', field="raw.type")
        size, number = _SAMPLE[self.type]
        layout = pb.RawLayout(type=getattr(pb, number))
        channels: list[RawChannel] = []
        step = size * len(self.channels)
        c: Union[str, RawChannel]
        for i, c in enumerate(self.channels):
            channels.append(c if isinstance(c, RawChannel) else RawChannel(c, i * size, self.width * step, step))
        try:
            layout.width, layout.height = self.width, self.height
            for c in channels:
                layout.channels.add(
                    name=c.name, offset=c.offset, row_stride=c.row_stride, pixel_stride=c.pixel_stride
                )
        except (TypeError, ValueError) as e:
            raise errors.InvalidRequest(f"the layout cannot be sent: {e}", field="raw") from None
        return layout


Source = Union[Buffer, str, "os.PathLike[str]", Raw, Any]


@dataclass
class Prepared:
    """A payload with its descriptors and memory, which are this object's until close()."""

    kind: int  # of pb.Payload
    size: int
    data: Optional[memoryview] = None  # inline
    fds: list[int] = field(default_factory=list)
    raw: Any = None
    shape: Optional[Shape] = None
    output: Optional[mmap.mmap] = None  # the client's own, for output="buffer"

    def close(self) -> None:
        fds, self.fds = self.fds, []
        _transport.close_all(fds)
        self.data = self.output = None

    def message(self) -> Any:
        return pb.Payload(kind=self.kind, fd=0, offset=0, size=self.size)


def make_memfd(size: int) -> tuple[int, mmap.mmap]:
    """Anonymous memory of this size, mapped for writing, sealed against shrinking and growing."""
    import fcntl

    fd = os.memfd_create("airy", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, size)
        mapped = mmap.mmap(fd, size)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    except BaseException:
        os.close(fd)
        raise
    return fd, mapped


def is_array(source: Any) -> bool:
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(source, numpy.ndarray)


def _array_raw(a: Any, channels: Optional[Sequence[str]]) -> tuple[Raw, Shape]:
    if a.dtype.kind != "f" or a.dtype.itemsize not in (2, 4):
        raise errors.InvalidRequest(
            f"the array's type is {a.dtype}; expected float16 or float32 (array.astype(numpy.float16))", field="dtype"
        )
    if a.ndim not in (2, 3) or 0 in a.shape:
        raise errors.InvalidRequest(
            f"the array's shape is {a.shape}; expected (height, width) or (height, width, channels)", field="shape"
        )
    count = 1 if a.ndim == 2 else a.shape[2]
    names = channels if channels is not None else _NAMES.get(count)
    if names is None or len(names) != count:
        said = "none are named" if channels is None else f"{len(channels)} are named"
        raise errors.InvalidRequest(
            f'the array has {count} channels, {said}; expected channels="RGBA" or so', field="channels"
        )
    kind: Literal["half", "float"] = "half" if a.dtype.itemsize == 2 else "float"
    shape = Shape(tuple(a.shape), "<f2" if kind == "half" else "<f4")
    return Raw(b"", a.shape[1], a.shape[0], kind, names), shape


def _open(path: Union[str, "os.PathLike[str]"]) -> tuple[int, int]:
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as e:
        raise errors.InvalidRequest(f"{os.fspath(path)}: {e.strerror}", field="input") from e
    try:
        st = os.fstat(fd)
        if not stat.S_ISREG(st.st_mode):
            raise errors.InvalidRequest(f"{os.fspath(path)} is not a regular file", field="input")
        if not st.st_size:
            raise errors.InvalidRequest(f"{os.fspath(path)} is empty", field="input")
        return fd, st.st_size
    except BaseException:
        os.close(fd)
        raise


def _flat(data: Buffer) -> memoryview:
    try:
        return memoryview(data).cast("B")
    except TypeError as e:
        raise errors.InvalidRequest(
            f"the input is a {type(data).__name__}: {e}; expected a path, bytes, a NumPy array, or airy.Raw",
            field="input",
        ) from None


def _from_path(path: Union[str, "os.PathLike[str]"], via: Via) -> Prepared:
    fd, size = _open(path)
    if via == "file":
        return Prepared(pb.Payload.FILE, size, fds=[fd])
    with open(fd, "rb") as f:
        return _from_bytes(memoryview(f.read()), via)


def _from_bytes(data: memoryview, via: Via) -> Prepared:
    if not data.nbytes:
        raise errors.InvalidRequest("the input has 0 bytes, expected at least 1", field="input")
    if via == "inline":
        return Prepared(pb.Payload.INLINE, data.nbytes, data=data)
    fd, mapped = make_memfd(data.nbytes)
    with mapped:
        mapped[:] = data
    return Prepared(pb.Payload.MEMFD, data.nbytes, fds=[fd])


def _from_array(a: Any, via: Via, shape: Shape) -> Prepared:
    import numpy

    if via == "inline":
        flat: Any = numpy.ascontiguousarray(a, dtype=shape.dtype)
        return _from_bytes(memoryview(flat).cast("B"), via)
    # Written once, whatever its strides and byte order are.
    fd, mapped = make_memfd(a.size * a.dtype.itemsize)
    numpy.copyto(numpy.frombuffer(mapped, dtype=shape.dtype).reshape(a.shape), a)
    return Prepared(pb.Payload.MEMFD, a.size * a.dtype.itemsize, fds=[fd])


def prepare(
    source: Source, features: frozenset[str], via: Optional[Via] = None, channels: Optional[Sequence[str]] = None
) -> Prepared:
    """A payload of this source, in the given way or the best one; raises InvalidRequest."""
    if via is not None and via not in ("inline", "memfd", "file"):
        raise errors.InvalidRequest(f'via is {via!r}; expected "inline", "memfd" or "file"', field="via")
    bytes_via: Via = "memfd" if HAS_MEMFD and "memfd" in features else "inline"
    layout = shape = None
    held: Any = source
    if is_array(source):
        raw, shape = _array_raw(source, channels)
        layout = raw.layout()
    elif isinstance(source, Raw):
        held, layout = source.data, source.layout()
    path = isinstance(held, (str, os.PathLike))
    way = via or ("file" if path and "file" in features else bytes_via)
    if way not in features:
        raise errors.InvalidRequest(f"the daemon does not take input by {way}", field="via")
    if way == "memfd" and not HAS_MEMFD:
        raise errors.InvalidRequest("this system has no memfd", field="via")
    if way == "file" and not path:
        raise errors.InvalidRequest("only a path goes as a file", field="via")
    if shape is not None:
        prepared = _from_array(source, way, shape)
    elif path:
        prepared = _from_path(held, way)
    else:
        prepared = _from_bytes(_flat(held), way)
    prepared.raw, prepared.shape = layout, shape
    return prepared
