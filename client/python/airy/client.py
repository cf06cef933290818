# SPDX-License-Identifier: Apache-2.0
"""The blocking client. It starts no thread: whoever waits moves all requests of the connection along.

Several threads may share a Client: one of them at a time is the one that moves, for all. Each request ends in a Result or an
exception of airy.errors. When the daemon goes and comes back meanwhile, what may be asked again is, by whoever waits for it.
"""
from __future__ import annotations

import select
import socket
import threading
import time
from types import TracebackType
from typing import Any, Callable, Generic, Optional, TypeVar

from . import _request, _transport, errors, payload, result, walls
from ._engine import Engine
from ._pump import CLOSED, Backoff, Pump, no_answer
from ._request import Definition
from ._task import Question, Request
from ._verbs import Make, Verbs

_T = TypeVar("_T")
_STEP_S = 0.05  # how long a thread may wait for another's step before it looks again
_RECONNECT_S = 15.0
ASK_S = 15.0


class _Connection:
    """An engine and, while a daemon is there, the socket to it."""

    def __init__(self, path: Optional[_transport.PathLike], timeout_s: float, again_s: float) -> None:
        self.engine = Engine(again_s=again_s)
        self.lock = threading.Lock()
        self._path = path
        self._timeout_s = timeout_s
        self._pump = Pump(self.engine)
        self._backoff = Backoff()
        self._open_at = 0.0
        self._greet_by = time.monotonic() + timeout_s
        self._socket: Optional[socket.socket] = _transport.connect(path, timeout_s)
        try:
            self._socket.setblocking(False)
            while self.engine.welcome is None:
                if self.engine.lost is not None:
                    raise self.engine.lost
                self.step(timeout_s)
        except BaseException as e:
            self.close(e if isinstance(e, errors.AiryError) else None)
            raise

    def close(self, why: Optional[errors.AiryError] = None) -> None:
        self.engine.lose(why or errors.ConnectionLost(CLOSED))
        self._hang_up()

    def _hang_up(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def step(self, timeout_s: float) -> None:
        """Waits at most so long, and does what can be done. The caller has the lock."""
        engine = self.engine
        engine.tick()
        if engine.lost is not None or engine.down is not None:
            self._hang_up()
        if engine.lost is not None:
            return
        if self._socket is None:
            if engine.wanted:
                self._reopen(timeout_s)
            return
        self._wait(self._socket, timeout_s)
        engine.tick()
        self._pump.exchange(self._socket)
        if engine.ready:
            self._backoff = Backoff()
        elif engine.down is None and time.monotonic() >= self._greet_by:
            engine.drop(no_answer(self._timeout_s))
        if engine.lost is not None or engine.down is not None:
            self._hang_up()

    def _wait(self, s: socket.socket, timeout_s: float) -> None:
        engine = self.engine
        wake = engine.next_wake()
        if wake is not None:
            timeout_s = min(timeout_s, max(0.0, wake - engine.clock()))
        if not engine.ready:
            timeout_s = min(timeout_s, max(0.0, self._greet_by - time.monotonic()))
        poll = select.poll()
        poll.register(s, select.POLLIN | (select.POLLOUT if engine.outgoing() is not None else 0))
        poll.poll(int(timeout_s * 1000 + 0.999))

    def _reopen(self, timeout_s: float) -> None:
        wait = self._open_at - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout_s))
        if time.monotonic() < self._open_at:
            return
        self._open_at = time.monotonic() + self._backoff.take()
        try:
            self._socket = _transport.connect(self._path, min(self._timeout_s, self.engine.again_s))
        except errors.NoDaemon as e:
            self.engine.refused(e)
            return
        self._socket.setblocking(False)
        self._greet_by = time.monotonic() + self._timeout_s
        self.engine.begin()


class Pending(Generic[_T]):
    """A request in flight: wait for it with result()."""

    def __init__(self, connection: _Connection, request: Request) -> None:
        self._connection = connection
        self._request = request

    def done(self) -> bool:
        return self._request.ended

    def cancel(self) -> None:
        """Asks for an early end; result() then raises Cancelled, or returns as it would have."""
        with self._connection.lock:
            self._connection.engine.cancel(self._request)
            self._connection.step(0)

    def result(self, timeout: Optional[float] = None) -> _T:
        """Waits; raises TimeoutError when it takes longer (the request goes on), or the exception that it ended in."""
        error = self.exception(timeout)
        if error is not None:
            raise error
        value: _T = self._request.value
        return value

    def exception(self, timeout: Optional[float] = None) -> Optional[BaseException]:
        if not _until(self._connection, lambda: self._request.ended, timeout):
            raise TimeoutError(f"request {self._request.id} did not end in {timeout:g} s")
        return self._request.error


def _until(connection: _Connection, done: Callable[[], bool], timeout: Optional[float]) -> bool:
    """Moves the connection along, or lets another thread do so, until it is done or the time is up."""
    deadline = None if timeout is None else time.monotonic() + timeout
    while not done():
        left = None if deadline is None else deadline - time.monotonic()
        if left is not None and left < 0:
            return False
        if not connection.lock.acquire(timeout=_STEP_S):
            continue
        try:
            if not done():
                # Other threads may want to submit: the socket is not waited for without end.
                connection.step(_STEP_S if left is None else min(left, _STEP_S))
        finally:
            connection.lock.release()
    return True


class Client(Verbs[Pending[result.Result], result.Result]):
    """A connection to airyd. path None: $AIRY_SOCKET, else $XDG_RUNTIME_DIR/airyd.sock, else /run/airyd/airyd.sock.

    timeout: seconds for connecting, which may start a daemon. reconnect: seconds for which a daemon that has gone is waited for by
    what is in flight and may be asked again, and by what is asked meanwhile; 0: requests end in ConnectionLost at once, and the next
    call connects anew."""

    def __init__(
        self,
        path: Optional[_transport.PathLike] = None,
        timeout: float = _transport.CONNECT_TIMEOUT_S,
        *,
        reconnect: float = _RECONNECT_S,
    ) -> None:
        self._path = path
        self._timeout = timeout
        self._reconnect = reconnect
        self._closed = False
        self._lock = threading.Lock()
        self._connection = _Connection(path, timeout, reconnect)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: Optional[type[BaseException]], value: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()

    def close(self) -> None:
        """Requests that are still open end in ConnectionLost."""
        self._closed = True
        with self._connection.lock:
            self._connection.close()

    @property
    def daemon(self) -> result.Welcome:
        """Its version, features, limits, device and looks."""
        return _welcome(self._connection)

    # ---- verbs, beside those of Verbs ------------------------------------------------------------

    def bloom(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> result.Result:
        """One frame: a path, EXR bytes, a NumPy array (height, width[, channels]) of float16 or float32, or airy.Raw.
        The options are submit()'s. After `timeout` seconds the request is cancelled, and TimeoutError raised."""
        deadline = None if timeout is None else time.monotonic() + timeout
        pending = self.submit(frame, timeout=timeout, **options)
        return self._finish(pending, None if deadline is None else max(0.0, deadline - time.monotonic()))

    def asset(
        self, source: payload.Source, *, via: Optional[payload.Via] = None, timeout: Optional[float] = None
    ) -> result.Asset:
        """Sends an EXR file to be kept: lens dirt (dirt=asset.digest), a kernel (psf="image:" + asset.digest)."""
        pending: Pending[result.Asset] = self._send(lambda w: _request.asset(w, source, via), None)
        return self._finish(pending, timeout)

    def status(self, timeout: float = ASK_S) -> result.Status:
        """Answered at any load, beside whatever is in flight."""
        status: result.Status = self._ask(_request.status, timeout)
        return status

    def wall_list(self, name: str = "", *, timeout: float = ASK_S) -> walls.Walls:
        """All walls that are open and all controllers that are plugged in, or one wall."""
        found: walls.Walls = self._ask(lambda w: _request.wall_list(w, name), timeout)
        return found

    def wall_open(
        self, definition: Definition, *, calibration: str = "", keep: bool = False, timeout: float = ASK_S
    ) -> walls.WallState:
        """Opens a wall of airy-wall(5): its text, or a pathlib.Path of it. calibration: asset(FILE).digest, when the definition names
        an image. Without keep the wall goes when this connection does, also when it is lost."""
        return self._wall(lambda w: _request.wall_open(w, definition, calibration, keep), timeout)

    def wall_close(self, name: str, *, timeout: float = ASK_S) -> None:
        """Black, then away; whoever opened it."""
        self._ask(lambda w: _request.wall_close(w, name), timeout)

    def wall_pattern(
        self, name: str, pattern: str = "", *, board: str = "", led: int = 0, level: float = 0, timeout: float = ASK_S
    ) -> walls.WallState:
        """A test pattern instead of frames: order panels red green blue white ramp checker led black; "" ends it. level: linear, 0
        to 1, 0: 0.25; board and led: of "led"."""
        return self._wall(lambda w: _request.wall_pattern(w, name, pattern, board, led, level), timeout)

    def wall_preview(self, name: str, *, timeout: float = ASK_S) -> walls.Preview:
        """What was sent to its boards last, as a picture of 8 bits."""
        preview: walls.Preview = self._ask(lambda w: _request.wall_preview(w, name), timeout)
        return preview

    # ---- within --------------------------------------------------------------------------------

    def _live(self) -> _Connection:
        with self._lock:
            if self._closed:
                raise errors.ConnectionLost("the client was closed")
            # What came while nobody waited: a daemon that has gone is seen before anything is sent to it.
            with self._connection.lock:
                self._connection.step(0)
            if self._connection.engine.lost is not None:
                self._connection = _Connection(self._path, self._timeout, self._reconnect)
            return self._connection

    def _submit(self, make: Make, timeout: Optional[float]) -> Pending[result.Result]:
        return self._send(make, timeout)

    def _result(self, make: Make, timeout: Optional[float]) -> result.Result:
        return self._finish(self._submit(make, None), timeout)

    def _send(self, make: Make, timeout: Optional[float]) -> Pending[_T]:
        connection = self._live()
        request = make(_welcome(connection))
        with connection.lock:
            connection.engine.submit(request)
            connection.step(0)
        try:
            if not _until(connection, lambda: request.sent or request.ended, timeout):
                raise TimeoutError(f"no credit for {request.size} bytes in {timeout:g} s")
        except BaseException:
            with connection.lock:
                connection.engine.cancel(request)
            raise
        return Pending(connection, request)

    def _finish(self, pending: Pending[_T], timeout: Optional[float]) -> _T:
        try:
            return pending.result(timeout)
        except BaseException:
            if not pending.done():
                pending.cancel()
            raise

    def _wall(self, make: Callable[[result.Welcome], Question], timeout: float) -> walls.WallState:
        state: walls.WallState = self._ask(make, timeout)
        return state

    def _ask(self, make: Callable[[result.Welcome], Question], timeout: float) -> Any:
        connection = self._live()
        question = make(_welcome(connection))
        with connection.lock:
            connection.engine.ask(question)
            connection.step(0)
        if not _until(connection, lambda: question.ended, timeout):
            with connection.lock:
                connection.engine.forget(question)
            raise TimeoutError(f"the daemon did not answer {question.kind.name} in {timeout:g} s")
        if question.error is not None:
            raise question.error
        return question.value


def _welcome(connection: _Connection) -> result.Welcome:
    welcome = connection.engine.welcome
    assert welcome is not None
    return welcome
