# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, typed: catch the class, or switch on `code` or `symbol`.

Every exception of this package is an AiryError. Those of the daemon are DaemonErrors, one class a code of PROTOCOL.md's
table, under a few families; a code that this version does not know is a plain DaemonError. Those of this side are LocalErrors.
"""
from __future__ import annotations

from typing import Iterator, Optional


class AiryError(Exception):
    """code and symbol are stable; field says what it is about; text is for people."""

    code: int = 0
    symbol: str = "LOCAL"

    def __init__(
        self,
        text: str,
        *,
        field: str = "",
        code: Optional[int] = None,
        symbol: Optional[str] = None,
        retryable: bool = False,
        retry_after_ms: int = 0,
        queue_position: int = 0,
    ) -> None:
        super().__init__(text)
        self.text = text
        self.field = field
        if code is not None:
            self.code = code
        if symbol is not None:
            self.symbol = symbol
        self.retryable = retryable
        self.retry_after_ms = retry_after_ms
        self.queue_position = queue_position

    def __str__(self) -> str:
        where = f" ({self.field})" if self.field else ""
        return f"{self.symbol}{where}: {self.text}"


class LocalError(AiryError):
    """From this side of the socket."""


class InvalidRequest(LocalError, ValueError):
    """The request cannot be put together; nothing was sent."""


class NoDaemon(LocalError, ConnectionError):
    """Nobody listens."""


class ConnectionLost(LocalError, ConnectionError):
    """The connection went while it was needed."""


class PeerFault(ConnectionLost):
    """What came is not what a daemon may send."""


class Cancelled(AiryError):
    """The request ended as cancel() asked."""

    symbol = "CANCELLED"


class DaemonError(AiryError):
    """The daemon's answer."""


class ProtocolError(DaemonError):
    """Codes 1xx: the conversation went wrong."""


class RequestError(DaemonError):
    """Codes 2xx: the request is wrong; the same one will be wrong again."""


class FileError(DaemonError):
    """Codes 3xx: the frame is wrong."""


class ResourceError(DaemonError):
    """Codes 4xx: too much."""


class ServerError(DaemonError):
    """Codes 5xx: the daemon's fault."""


class BadMagic(ProtocolError):
    code, symbol = 100, "BAD_MAGIC"


class BadVersion(ProtocolError):
    code, symbol = 101, "BAD_VERSION"


class Unexpected(ProtocolError):
    code, symbol = 102, "UNEXPECTED"


class TooLong(ProtocolError):
    code, symbol = 103, "TOO_LONG"


class BadBody(ProtocolError):
    code, symbol = 104, "BAD_BODY"


class BadFds(ProtocolError):
    code, symbol = 105, "BAD_FDS"


class DuplicateId(ProtocolError):
    code, symbol = 106, "DUPLICATE_ID"


class ParamError(RequestError):
    """A parameter; field is "params.NAME"."""


class ParamUnknown(ParamError):
    code, symbol = 200, "PARAM_UNKNOWN"


class ParamRange(ParamError):
    code, symbol = 201, "PARAM_RANGE"


class ParamSyntax(ParamError):
    code, symbol = 202, "PARAM_SYNTAX"


class ParamConflict(ParamError):
    code, symbol = 203, "PARAM_CONFLICT"


class PayloadError(RequestError):
    code, symbol = 210, "PAYLOAD"


class PayloadSeals(RequestError):
    code, symbol = 211, "PAYLOAD_SEALS"


class LayoutError(RequestError):
    code, symbol = 212, "LAYOUT"


class NoPart(RequestError):
    code, symbol = 220, "NO_PART"


class NoLayer(RequestError):
    code, symbol = 221, "NO_LAYER"


class NoView(RequestError):
    code, symbol = 222, "NO_VIEW"


class NoAsset(RequestError):
    code, symbol = 223, "NO_ASSET"


class NoWall(RequestError):
    code, symbol = 224, "NO_WALL"


class NotExr(FileError):
    code, symbol = 300, "NOT_EXR"


class ExrDamaged(FileError):
    code, symbol = 301, "EXR_DAMAGED"


class ExrTooLarge(FileError):
    code, symbol = 302, "EXR_TOO_LARGE"


class ExrUnsupported(FileError):
    code, symbol = 303, "EXR_UNSUPPORTED"


class NonFiniteFrame(FileError):
    code, symbol = 304, "NONFINITE"


class WallError(FileError):
    code, symbol = 305, "WALL"


class Busy(ResourceError):
    """Still busy after all tries; retry_after_ms and queue_position are the last answer's."""

    code, symbol = 400, "BUSY"


class LimitError(ResourceError):
    code, symbol = 401, "LIMIT"


class NoMemory(ResourceError):
    code, symbol = 402, "NO_MEMORY"


class WallBusy(ResourceError):
    code, symbol = 403, "WALL_BUSY"


class DeadlineExceeded(ResourceError):
    """The request waited for its turn for longer than its deadline_ms."""

    code, symbol = 404, "DEADLINE"


class InternalError(ServerError):
    code, symbol = 500, "INTERNAL"


class DeviceLost(ServerError):
    code, symbol = 501, "DEVICE_LOST"


class ShuttingDown(ServerError):
    code, symbol = 502, "SHUTTING_DOWN"


def _leaves(of: type[DaemonError]) -> Iterator[type[DaemonError]]:
    for cls in of.__subclasses__():
        if cls.code:
            yield cls
        yield from _leaves(cls)


BY_CODE: dict[int, type[DaemonError]] = {cls.code: cls for cls in _leaves(DaemonError)}


def closes(code: int) -> bool:
    """Is an ERROR of this code the connection's last message? (PROTOCOL.md section 8.)"""
    return 100 <= code <= 105


def from_daemon(
    code: int, symbol: str, text: str, field: str, retryable: bool, retry_after_ms: int, queue_position: int
) -> DaemonError:
    return BY_CODE.get(code, DaemonError)(
        text,
        field=field,
        code=code,
        symbol=symbol,
        retryable=retryable,
        retry_after_ms=retry_after_ms,
        queue_position=queue_position,
    )
