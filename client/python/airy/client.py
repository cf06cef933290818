# SPDX-License-Identifier: Apache-2.0
"""The blocking client. It starts no thread: whoever waits moves all requests of the connection along.

Several threads may share a Client: one of them at a time is the one that moves, for all. Each request ends in a Result or an
exception of airy.errors. When the daemon was restarted, the next call connects anew.
"""
from __future__ import annotations

import select
import socket
import threading
import time
from types import TracebackType
from typing import Any, Callable, Generic, Optional, Sequence, TypeVar, Union

from . import _request, _transport, errors, payload, result
from ._engine import Engine, ProgressCallback, Request
from ._request import Output, Param
from ._wire import Type

_T = TypeVar("_T")
_STEP_S = 0.05  # how long a thread may wait for another's step before it looks again


class _Connection:
    """A socket and its engine."""

    def __init__(self, s: socket.socket, timeout_s: float) -> None:
        self.socket = s
        self.engine = Engine()
        self.lock = threading.Lock()
        self._buffer = memoryview(bytearray(_transport.READ_BYTES))
        s.setblocking(False)
        deadline = time.monotonic() + timeout_s
        try:
            while self.engine.welcome is None:
                if self.engine.lost is not None:
                    raise self.engine.lost
                left = deadline - time.monotonic()
                if left <= 0:
                    raise errors.ConnectionLost(f"the daemon did not answer HELLO in {timeout_s:g} s", field="socket")
                self.step(left)
        except BaseException as e:
            self.close(e if isinstance(e, errors.AiryError) else None)
            raise

    def close(self, why: Optional[errors.AiryError] = None) -> None:
        self.engine.lose(why or errors.ConnectionLost("the connection was closed by close()"))
        self.socket.close()

    def step(self, timeout_s: Optional[float]) -> None:
        """Waits for the socket at most so long, and does what can be done. The caller has the lock."""
        engine = self.engine
        if engine.lost is not None:
            return
        wake = engine.next_wake()
        if wake is not None:
            until_wake = max(0.0, wake - engine.clock())
            timeout_s = until_wake if timeout_s is None else min(timeout_s, until_wake)
        poll = select.poll()
        poll.register(self.socket, select.POLLIN | (select.POLLOUT if engine.outgoing() is not None else 0))
        poll.poll(None if timeout_s is None else max(0, int(timeout_s * 1000 + 0.999)))
        engine.tick()
        # A daemon that refuses our bytes may have sent the reason first: read before giving up.
        refused = self._write()
        ended = self._read()
        if engine.lost is None and (ended is not None or refused is not None):
            self.close(ended or refused)
        elif engine.lost is not None:
            self.socket.close()

    def _write(self) -> Optional[errors.AiryError]:
        # Not without end: the daemon may be sending too.
        for _ in range(8):
            piece = self.engine.outgoing()
            if piece is None:
                return None
            try:
                n = _transport.send(self.socket, piece.buffers, piece.fds)
            except OSError as e:
                return lost(e)
            if not n:
                return None
            self.engine.went(n)
        return None

    def _read(self) -> Optional[errors.AiryError]:
        for _ in range(16):
            try:
                came = _transport.receive(self.socket, self._buffer)
            except OSError as e:
                return lost(e)
            if came is None:
                return None
            n, fds, truncated = came
            if not n:
                _transport.close_all(fds)
                return lost(None)
            self.engine.incoming(self._buffer[:n], fds, truncated)
            if self.engine.lost is not None:
                return None
        return None


def lost(e: Optional[OSError]) -> errors.ConnectionLost:
    if e is None or isinstance(e, (BrokenPipeError, ConnectionResetError)):
        return errors.ConnectionLost("the daemon closed the connection", retryable=True)
    return errors.ConnectionLost(f"the connection failed: {e.strerror}", retryable=True)


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
        if not _until(self._connection, lambda: self._request.ended, timeout):
            raise TimeoutError(f"request {self._request.id} did not end in {timeout:g} s")
        if self._request.error is not None:
            raise self._request.error
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


class Client:
    """A connection to airyd. path None: $AIRY_SOCKET, else $XDG_RUNTIME_DIR/airyd.sock, else /run/airyd/airyd.sock."""

    def __init__(self, path: Optional[_transport.PathLike] = None, timeout: float = _transport.CONNECT_TIMEOUT_S) -> None:
        self._path = path
        self._timeout = timeout
        self._closed = False
        self._lock = threading.Lock()
        self._connection = self._connect()

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
        welcome = self._connection.engine.welcome
        assert welcome is not None
        return welcome

    # ---- verbs ---------------------------------------------------------------------------------

    def bloom(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> result.Result:
        """One frame: a path, EXR bytes, a NumPy array (height, width[, channels]) of float16 or float32, or airy.Raw.
        The options are submit()'s. After `timeout` seconds the request is cancelled, and TimeoutError raised."""
        deadline = None if timeout is None else time.monotonic() + timeout
        pending = self.submit(frame, timeout=timeout, **options)
        return self._finish(pending, None if deadline is None else max(0.0, deadline - time.monotonic()))

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
        timeout: Optional[float] = None,
        **params: Param,
    ) -> Pending[result.Result]:
        """Sends a frame and returns at once, or as soon as the connection's credit allows, within `timeout` seconds (else
        TimeoutError, and nothing was sent); wait with .result().

        part, layer, view (a stereo view), pixels, compression: of an EXR file, as `airy bloom` has them. show is the
        parameter `view`: what the picture shows. via: "inline", "memfd" or "file"; output: "inline", "memfd", or "buffer" (of raw
        pixels and arrays: memory of this side's own, and the result's array is writable). progress(stage, fraction) is called
        from within the waits. Everything else is a parameter of PROTOCOL.md section 9: threshold=1.5, psf="eye:weight=.1"."""
        return self._submit(
            lambda engine: _request.bloom(
                engine,
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
            ),
            timeout,
        )

    def plan(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> result.Result:
        """What would run, its bound and its time: nothing is bloomed. Takes submit()'s options, but output and progress."""
        extra = {k: options.pop(k) for k in _PLAN_OPTIONS & options.keys()}
        pending: Pending[result.Result] = self._submit(
            lambda engine: _request.bloom(engine, frame, options, plan_only=True, **extra)
        )
        return self._finish(pending, timeout)

    def asset(
        self, source: payload.Source, *, via: Optional[payload.Via] = None, timeout: Optional[float] = None
    ) -> result.Asset:
        """Sends an EXR file to be kept: lens dirt (dirt=asset.digest), a kernel (psf="image:" + asset.digest)."""
        pending: Pending[result.Asset] = self._submit(lambda engine: _request.asset(engine, source, via))
        return self._finish(pending, timeout)

    def status(self, timeout: float = 5.0) -> result.Status:
        """Answered at any load, beside whatever is in flight."""
        return result.status(self._ask(Type.STATUS, None, Type.STATUS_REPLY, timeout))

    def wall_list(self, name: str = "", timeout: float = 5.0) -> Any:
        """The WallReply message: all walls and controllers, or one wall's. For daemons with the feature "wall"."""
        connection = self._live()
        assert connection.engine.welcome is not None
        if "wall" not in connection.engine.welcome.features:
            raise errors.InvalidRequest("the daemon has no walls", field="wall")
        return self._ask(Type.WALL, _request.wall_list(name), Type.WALL_REPLY, timeout)

    # ---- within --------------------------------------------------------------------------------

    def _connect(self) -> _Connection:
        deadline = time.monotonic() + self._timeout
        s = _transport.connect(self._path, self._timeout)
        return _Connection(s, max(0.001, deadline - time.monotonic()))

    def _live(self) -> _Connection:
        with self._lock:
            if self._closed:
                raise errors.ConnectionLost("the client was closed")
            # What came while nobody waited: a daemon that has gone is seen before anything is sent to it.
            with self._connection.lock:
                self._connection.step(0)
            if self._connection.engine.lost is not None:
                self._connection = self._connect()
            return self._connection

    def _submit(self, make: Callable[[Engine], Request], timeout: Optional[float] = None) -> Pending[_T]:
        connection = self._live()
        request = make(connection.engine)
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

    def _ask(self, kind: Type, body: Any, answer: Type, timeout: float) -> Any:
        connection = self._live()
        got: list[Any] = []
        with connection.lock:
            id = connection.engine.ask(kind, body, answer, got.append)
            connection.step(0)
        if not _until(connection, lambda: bool(got), timeout):
            with connection.lock:
                connection.engine.forget(id)
            raise TimeoutError(f"the daemon did not answer {kind.name} in {timeout:g} s")
        return answered(got[0], connection.engine)


def answered(got: Any, engine: Engine) -> Any:
    """What ask() was told: None when the connection went."""
    if got is None:
        assert engine.lost is not None
        raise engine.lost
    if isinstance(got, BaseException):
        raise got
    return got


_PLAN_OPTIONS = {"part", "layer", "view", "show", "pixels", "compression", "via", "channels"}
