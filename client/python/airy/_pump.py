# SPDX-License-Identifier: Apache-2.0
"""Between a socket and an engine, for both clients: what can be written is, what is there is read, and neither waits. Who
waits, and for what, is theirs; so is when a daemon that has gone is looked for again, at the pace of Backoff."""
from __future__ import annotations

import socket
from typing import Optional

from . import _transport, errors
from ._engine import Engine

WRITES_AT_ONCE = 8  # not without end: the daemon may be sending too
READS_AT_ONCE = 16


class Backoff:
    FIRST_S, MOST_S = 0.02, 1.0

    def __init__(self) -> None:
        self.next_s = self.FIRST_S

    def take(self) -> float:
        now, self.next_s = self.next_s, min(2 * self.next_s, self.MOST_S)
        return now


class Pump:
    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._buffer = memoryview(bytearray(_transport.READ_BYTES))

    def exchange(self, s: socket.socket) -> None:
        """Writes, then reads; the engine hears of the stream's end."""
        refused = self._write(s)
        # A daemon that refuses our bytes may have sent the reason first: read before giving up.
        ended = self.read(s)
        if ended is None and refused is not None:
            self.engine.drop(refused)

    def read(self, s: socket.socket) -> Optional[errors.AiryError]:
        """Why the stream is over, which the engine knows then."""
        ended = self._read(s)
        if ended is not None:
            self.engine.drop(ended)
        return ended

    def _over(self) -> bool:
        return self.engine.lost is not None or self.engine.down is not None

    def _write(self, s: socket.socket) -> Optional[errors.AiryError]:
        for _ in range(WRITES_AT_ONCE):
            piece = self.engine.outgoing()
            if piece is None:
                return None
            try:
                n = _transport.send(s, piece.buffers, piece.fds)
            except OSError as e:
                return lost(e)
            if not n:
                return None
            self.engine.went(n)
        return None

    def _read(self, s: socket.socket) -> Optional[errors.AiryError]:
        for _ in range(READS_AT_ONCE):
            if self._over():
                return None
            try:
                came = _transport.receive(s, self._buffer)
            except OSError as e:
                return lost(e)
            if came is None:
                return None
            n, fds, truncated = came
            if not n:
                _transport.close_all(fds)
                return lost(None)
            self.engine.incoming(self._buffer[:n], fds, truncated)
        return None


def lost(e: Optional[OSError]) -> errors.ConnectionLost:
    if e is None or isinstance(e, (BrokenPipeError, ConnectionResetError)):
        return errors.ConnectionLost("the daemon closed the connection", retryable=True)
    return errors.ConnectionLost(f"the connection failed: {e.strerror}", retryable=True)


def no_answer(timeout_s: float) -> errors.ConnectionLost:
    return errors.ConnectionLost(f"the daemon did not answer HELLO in {timeout_s:g} s", field="socket", retryable=True)


CLOSED = "the connection was closed by close()"
