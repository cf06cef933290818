# SPDX-License-Identifier: Apache-2.0
"""Sockets with descriptors: who listens, and one sendmsg, one recvmsg at a time.

No descriptor is ever inherited by a child, and none that came is dropped: truncated sets are handed on as such.
"""
from __future__ import annotations

import array
import os
import socket
import time
from typing import Optional, Sequence, Union

from . import errors

CONNECT_TIMEOUT_S = 30.0  # a daemon may be started by this very connection, and tests its device before it says a word
READ_BYTES = 256 * 1024
SYSTEM_SOCKET = "/run/airyd/airyd.sock"

_FD = array.array("i").itemsize
# Room for every descriptor that Linux lets one message carry (SCM_MAX_FD): with less, the kernel drops some.
_ANCILLARY = socket.CMSG_SPACE(253 * _FD) if hasattr(socket, "CMSG_SPACE") else 0
_CLOEXEC = getattr(socket, "MSG_CMSG_CLOEXEC", 0)

PathLike = Union[str, "os.PathLike[str]"]


def candidates(path: Optional[PathLike]) -> list[str]:
    """Where a daemon may listen; the first that answers is taken."""
    if path is not None:
        return [os.fspath(path)]
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    own = os.environ.get("AIRY_SOCKET")
    return [p for p in (own, runtime and f"{runtime}/airyd.sock", SYSTEM_SOCKET) if p]


def connect(path: Optional[PathLike], timeout_s: float = CONNECT_TIMEOUT_S) -> socket.socket:
    """A connected socket, blocking with what is left of the time; raises NoDaemon."""
    deadline = time.monotonic() + timeout_s
    tried = []
    for name in candidates(path):
        s = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            s.settimeout(max(0.001, deadline - time.monotonic()))
            s.connect(name)
            return s
        except OSError as e:
            s.close()
            tried.append(f"{name}: {e.strerror or e}")
        except BaseException:
            s.close()
            raise
    listen = candidates(path)[0]
    raise errors.NoDaemon(
        f"no daemon answers ({'; '.join(tried)}); start one: airyd --socket {listen}, or systemctl start airyd.socket",
        field="socket",
        retryable=True,
    )


def send(s: socket.socket, buffers: Sequence[memoryview], fds: Sequence[int]) -> int:
    """How many bytes went; 0 when the socket takes none now. The descriptors go with the first byte."""
    ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
    try:
        return s.sendmsg(buffers, ancillary, getattr(socket, "MSG_NOSIGNAL", 0))
    except (BlockingIOError, InterruptedError):
        return 0


def receive(s: socket.socket, into: memoryview) -> Optional[tuple[int, list[int], bool]]:
    """(bytes, descriptors, were some lost?), bytes 0 at the end of the stream; None when nothing is there now."""
    try:
        n, ancillary, flags, _ = s.recvmsg_into([into], _ANCILLARY, _CLOEXEC)
    except (BlockingIOError, InterruptedError):
        return None
    fds = array.array("i")
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            fds.frombytes(data[: len(data) - len(data) % _FD])
    return n, fds.tolist(), bool(flags & socket.MSG_CTRUNC)


def close_all(fds: Sequence[int]) -> None:
    for fd in fds:
        os.close(fd)
