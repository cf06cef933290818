# SPDX-License-Identifier: Apache-2.0
"""The frame around every message (PROTOCOL.md section 2): encode, decode, check. No sockets.

Both directions are here, though a client decodes only what a daemon sends: the golden vectors are of both.
"""
from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, NamedTuple, Optional

from google.protobuf.message import DecodeError

from . import airy_pb2 as pb
from . import errors

MAGIC = 0x59524941
VERSION = 1
HEADER_BYTES = 24
CONTROL_BYTES_MAX = 64 * 1024
DATA_BYTES_MAX = 1024 * 1024
FDS_MAX = 2

_HEADER = struct.Struct("<IBBBBIIQ")


class Type(IntEnum):
    HELLO = 1
    WELCOME = 2
    BLOOM = 3
    DATA = 4
    RESULT = 5
    ERROR = 6
    CANCEL = 7
    CANCELLED = 8
    STATUS = 9
    STATUS_REPLY = 10
    CREDIT = 11
    PROGRESS = 12
    ASSET = 13
    ASSET_KEPT = 14
    WALL = 15
    WALL_REPLY = 16


class _Row(NamedTuple):
    who: str  # C client, D daemon, B both
    fds: int
    body: Optional[str]  # None: bytes, or nothing


_ROWS: dict[int, _Row] = {
    Type.HELLO: _Row("C", 0, "Hello"),
    Type.WELCOME: _Row("D", 0, "Welcome"),
    Type.BLOOM: _Row("C", 2, "Bloom"),
    Type.DATA: _Row("B", 0, None),
    Type.RESULT: _Row("D", 1, "Result"),
    Type.ERROR: _Row("D", 0, "Error"),
    Type.CANCEL: _Row("C", 0, None),
    Type.CANCELLED: _Row("D", 0, None),
    Type.STATUS: _Row("C", 0, None),
    Type.STATUS_REPLY: _Row("D", 0, "StatusReply"),
    Type.CREDIT: _Row("D", 0, "Credit"),
    Type.PROGRESS: _Row("D", 0, "Progress"),
    Type.ASSET: _Row("C", 1, "Asset"),
    Type.ASSET_KEPT: _Row("D", 0, "AssetKept"),
}
# A schema without walls has no bodies for these, and a message that cannot be read is not known.
if hasattr(pb, "Wall"):
    _ROWS[Type.WALL] = _Row("C", 0, "Wall")
    _ROWS[Type.WALL_REPLY] = _Row("D", 0, "WallReply")


class Header(NamedTuple):
    type: Type
    n_fds: int
    body_bytes: int
    id: int


def encode(type: int, id: int, body_bytes: int, n_fds: int = 0) -> bytes:
    return _HEADER.pack(MAGIC, VERSION, type, n_fds, 0, body_bytes, 0, id)


def decode(header: bytes, sender: str) -> Header:
    """Checks a header that `sender` ("client" or "daemon") sent, in the order of PROTOCOL.md; raises a ProtocolError."""
    magic, version, type, n_fds, flags, body_bytes, reserved, id = _HEADER.unpack(header)
    if magic != MAGIC:
        raise errors.BadMagic(f"the header starts with {magic:#010x}, expected {MAGIC:#010x}", field="header.magic")
    if version != VERSION:
        raise errors.BadVersion(f"the header's version is {version}, this end speaks {VERSION}", field="header.version")
    row = _ROWS.get(type)
    if row is None:
        raise errors.Unexpected(f"no message has type {type}", field="header.type")
    name = Type(type).name
    if row.who != "B" and row.who != sender[0].upper():
        raise errors.Unexpected(f"{name} is not a {sender}'s to send", field="header.type")
    most = DATA_BYTES_MAX if type == Type.DATA else CONTROL_BYTES_MAX
    if body_bytes > most:
        raise errors.TooLong(
            f"the body of {name} is {body_bytes} bytes, at most {most} are allowed", field="header.body_bytes"
        )
    if n_fds > row.fds:
        raise errors.BadFds(
            f"{name} says that it brings {n_fds} descriptors, at most {row.fds} are allowed", field="header.n_fds"
        )
    if flags:
        raise errors.BadBody(f"flags are {flags:#04x}, expected 0", field="header.flags")
    if reserved:
        raise errors.BadBody(f"the reserved bytes are {reserved:#010x}, expected 0", field="header.reserved")
    return Header(Type(type), n_fds, body_bytes, id)


def message_class(type: int) -> Any:
    """The body's class, or None: raw bytes (DATA), or nothing at all."""
    name = _ROWS[type].body
    return None if name is None else getattr(pb, name)


def _check_fields(body: bytes, descriptor: Any) -> None:
    """The fields follow one another to the end, and none is a group, which proto3 does not have: one of protobuf's Python
    runtimes stops at the end of a group and returns what it has, with no more than a warning."""
    at = 0
    while at < len(body):
        tag, at = _varint(body, at)
        kind = tag & 7
        if kind == 0:
            _, at = _varint(body, at)
        elif kind == 1:
            at += 8
        elif kind == 2:
            n, at = _varint(body, at)
            field = descriptor.fields_by_number.get(tag >> 3)
            if field is not None and field.message_type is not None and at + n <= len(body):
                _check_fields(body[at : at + n], field.message_type)
            at += n
        elif kind == 5:
            at += 4
        else:
            raise ValueError(f"field {tag >> 3} has wire type {kind}")
        if not 0 < tag >> 3 < 1 << 29:
            raise ValueError(f"there is no field {tag >> 3}")
    if at != len(body):
        raise ValueError(f"its last field ends at byte {at} of {len(body)}")


def _varint(body: bytes, at: int) -> tuple[int, int]:
    value = 0
    for i, byte in enumerate(body[at : at + 10]):
        value |= (byte & 127) << 7 * i
        if byte < 128:
            return value, at + i + 1
    raise ValueError(f"the number at byte {at} has no end")


def parse(type: int, body: bytes) -> Any:
    """The body as a message; raises BadBody."""
    cls = message_class(type)
    if cls is None:
        return None
    try:
        _check_fields(body, cls.DESCRIPTOR)
        return cls.FromString(body)
    except (DecodeError, ValueError, RecursionError) as e:
        raise errors.BadBody(f"the body of {Type(type).name} cannot be decoded: {e}", field="body") from None


def pack(type: int, id: int, body: Any = None, n_fds: int = 0) -> bytes:
    """A whole message. The fields are in the order of their numbers, so that equal messages are equal bytes."""
    data: bytes = b"" if body is None else body.SerializeToString(deterministic=True)
    most = DATA_BYTES_MAX if type == Type.DATA else CONTROL_BYTES_MAX
    if len(data) > most:
        raise errors.InvalidRequest(
            f"the request's texts make a message of {len(data)} bytes, at most {most} are allowed", field="params"
        )
    return encode(type, id, len(data), n_fds) + data
