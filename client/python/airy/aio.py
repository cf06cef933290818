# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: the verbs of airy.Client, to be awaited.

    async with airy.aio.Client() as c:
        results = await asyncio.gather(*(c.bloom(f) for f in frames))

Cancelling a task that waits for a frame cancels the frame. Payloads are put together on the loop: an array is copied once.
"""
from __future__ import annotations

import asyncio
import socket
from types import TracebackType
from typing import Any, Callable, Coroutine, Generic, Optional, TypeVar

from . import _request, _transport, errors, payload, result, walls
from ._engine import Engine
from ._pump import CLOSED, Backoff, Pump, no_answer
from ._request import Definition
from ._task import Question, Request
from ._verbs import Make, Verbs
from .client import _RECONNECT_S, ASK_S

_T = TypeVar("_T")


class _Connection:
    """An engine on the running loop and, while a daemon is there, the socket to it."""

    def __init__(self, path: Optional[_transport.PathLike], timeout_s: float, again_s: float) -> None:
        self.engine = Engine(again_s=again_s)
        self._path = path
        self._timeout_s = timeout_s
        self._loop = asyncio.get_running_loop()
        self._pump = Pump(self.engine)
        self._socket: Optional[socket.socket] = None
        self._writing = False
        self._timer: Optional[asyncio.TimerHandle] = None
        self._reopening: Optional[asyncio.Task[None]] = None
        self._greeted: asyncio.Future[None] = self._loop.create_future()

    async def open(self) -> None:
        try:
            await self._connect(self._timeout_s)
            try:
                await asyncio.wait_for(self._greeted, self._timeout_s)
            except asyncio.TimeoutError:
                raise no_answer(self._timeout_s) from None
        except BaseException:
            self.close()
            raise

    async def _connect(self, timeout_s: float) -> None:
        # A Unix socket connects at once, unless the backlog is full: not the loop's to wait for.
        s = await asyncio.to_thread(_transport.connect, self._path, timeout_s)
        if self.engine.lost is not None:  # closed meanwhile
            s.close()
            return
        s.setblocking(False)
        if self.engine.down is not None:
            self.engine.begin()
        self._socket = s
        self._writing = False
        self._loop.add_reader(s, self.move)
        self.move()

    def close(self, why: Optional[errors.AiryError] = None) -> None:
        self.engine.lose(why or errors.ConnectionLost(CLOSED))
        self._settle()

    def _hang_up(self) -> None:
        if self._socket is not None:
            self._loop.remove_reader(self._socket)
            self._loop.remove_writer(self._socket)
            self._socket.close()
            self._socket = None

    def move(self) -> None:
        """Sends what can be sent, takes what is there, and asks the loop for the rest."""
        self.engine.tick()
        if self._socket is not None and self.engine.lost is None and self.engine.down is None:
            self._pump.exchange(self._socket)
        self._settle()

    def _settle(self) -> None:
        """What follows from how the engine is now."""
        engine = self.engine
        if engine.lost is not None or engine.down is not None:
            self._hang_up()
        if not self._greeted.done():
            if engine.lost is not None:
                self._greeted.set_exception(engine.lost)
                self._greeted.exception()  # heard: nobody may be waiting
            elif engine.ready:
                self._greeted.set_result(None)
        if engine.lost is not None and self._reopening is not None:
            self._reopening.cancel()
        if engine.lost is None and engine.down is not None and engine.wanted and self._reopening is None:
            self._reopening = asyncio.create_task(self._reopen())
        if self._socket is not None:
            want = engine.outgoing() is not None
            if want != self._writing:
                self._writing = want
                if want:
                    self._loop.add_writer(self._socket, self.move)
                else:
                    self._loop.remove_writer(self._socket)
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        wake = self.engine.next_wake() if self.engine.lost is None else None
        if wake is not None:
            self._timer = self._loop.call_later(max(0.0, wake - self.engine.clock()), self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self.move()

    async def _reopen(self) -> None:
        """Until a daemon has greeted, or nobody wants one any more; the engine knows when that is."""
        engine, backoff = self.engine, Backoff()
        try:
            while engine.lost is None and engine.wanted and not engine.ready:
                try:
                    await self._connect(min(self._timeout_s, engine.again_s))
                    await self._await_welcome()
                except errors.NoDaemon as e:
                    engine.refused(e)
                if not engine.ready:
                    await asyncio.sleep(backoff.take())
                    engine.tick()
        finally:
            self._reopening = None
            self._settle()

    async def _await_welcome(self) -> None:
        engine, end = self.engine, self._loop.time() + self._timeout_s
        while not engine.ready and engine.lost is None and engine.down is None:
            if self._loop.time() >= end:
                engine.drop(no_answer(self._timeout_s))
                self._hang_up()
                return
            await asyncio.sleep(0.01)


class Pending(Generic[_T]):
    """A request in flight: await it."""

    def __init__(self, connection: _Connection, request: Request) -> None:
        self._connection = connection
        self._request = request
        self._ended = asyncio.Event()
        self._sent = asyncio.Event()
        request.on_sent = lambda _: self._sent.set()
        request.on_end = self._on_end

    def _on_end(self, _: Request) -> None:
        self._ended.set()
        self._sent.set()

    def done(self) -> bool:
        return self._request.ended

    def cancel(self) -> None:
        """Asks for an early end; result() then raises Cancelled, or returns as it would have."""
        self._connection.engine.cancel(self._request)
        self._connection.move()

    async def sent(self) -> None:
        try:
            await self._sent.wait()
        except BaseException:
            self.cancel()
            raise

    async def result(self) -> _T:
        """A task that is cancelled here cancels the request."""
        try:
            await self._ended.wait()
        except BaseException:
            self.cancel()
            raise
        if self._request.error is not None:
            raise self._request.error
        value: _T = self._request.value
        return value

    def __await__(self) -> Any:
        return self.result().__await__()


class Client(Verbs[Coroutine[Any, Any, Pending[result.Result]], Coroutine[Any, Any, result.Result]]):
    """Connects on `async with`, or at the first verb; the arguments are airy.Client's, and so are those of the verbs."""

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
        self._connection: Optional[_Connection] = None
        self._connecting = asyncio.Lock()

    async def __aenter__(self) -> Client:
        await self._live()
        return self

    async def __aexit__(
        self, kind: Optional[type[BaseException]], value: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Requests that are still open end in ConnectionLost."""
        self._closed = True
        if self._connection is not None:
            self._connection.close()

    @property
    def daemon(self) -> result.Welcome:
        """Its version, features, limits, device and looks, once connected."""
        if self._connection is None or self._connection.engine.welcome is None:
            raise errors.ConnectionLost("not connected yet")
        return self._connection.engine.welcome

    # ---- verbs, beside those of Verbs ------------------------------------------------------------

    async def bloom(self, frame: payload.Source, /, *, timeout: Optional[float] = None, **options: Any) -> result.Result:
        """One frame; see airy.Client.bloom. After `timeout` seconds the request is cancelled, and TimeoutError raised."""

        async def whole() -> result.Result:
            return await (await self.submit(frame, **options)).result()

        return await _within(whole(), timeout)

    async def asset(
        self, source: payload.Source, *, via: Optional[payload.Via] = None, timeout: Optional[float] = None
    ) -> result.Asset:
        async def whole() -> result.Asset:
            pending: Pending[result.Asset] = await self._send(lambda w: _request.asset(w, source, via))
            return await pending.result()

        return await _within(whole(), timeout)

    async def status(self, timeout: float = ASK_S) -> result.Status:
        status: result.Status = await self._ask(_request.status, timeout)
        return status

    async def wall_list(self, name: str = "", *, timeout: float = ASK_S) -> walls.Walls:
        found: walls.Walls = await self._ask(lambda w: _request.wall_list(w, name), timeout)
        return found

    async def wall_open(
        self, definition: Definition, *, calibration: str = "", keep: bool = False, timeout: float = ASK_S
    ) -> walls.WallState:
        return await self._wall(lambda w: _request.wall_open(w, definition, calibration, keep), timeout)

    async def wall_close(self, name: str, *, timeout: float = ASK_S) -> None:
        await self._ask(lambda w: _request.wall_close(w, name), timeout)

    async def wall_pattern(
        self, name: str, pattern: str = "", *, board: str = "", led: int = 0, level: float = 0, timeout: float = ASK_S
    ) -> walls.WallState:
        return await self._wall(lambda w: _request.wall_pattern(w, name, pattern, board, led, level), timeout)

    async def wall_preview(self, name: str, *, timeout: float = ASK_S) -> walls.Preview:
        preview: walls.Preview = await self._ask(lambda w: _request.wall_preview(w, name), timeout)
        return preview

    # ---- within --------------------------------------------------------------------------------

    async def _live(self) -> _Connection:
        async with self._connecting:
            if self._closed:
                raise errors.ConnectionLost("the client was closed")
            if self._connection is None or self._connection.engine.lost is not None:
                self._connection = _Connection(self._path, self._timeout, self._reconnect)
                await self._connection.open()
            return self._connection

    async def _submit(self, make: Make, timeout: Optional[float]) -> Pending[result.Result]:
        sent: Pending[result.Result] = await _within(self._send(make), timeout)
        return sent

    async def _result(self, make: Make, timeout: Optional[float]) -> result.Result:
        async def whole() -> result.Result:
            pending: Pending[result.Result] = await self._send(make)
            return await pending.result()

        return await _within(whole(), timeout)

    async def _send(self, make: Make) -> Pending[_T]:
        connection = await self._live()
        assert connection.engine.welcome is not None
        request = make(connection.engine.welcome)
        pending: Pending[_T] = Pending(connection, request)
        connection.engine.submit(request)
        connection.move()
        await pending.sent()
        return pending

    async def _wall(self, make: Callable[[result.Welcome], Question], timeout: float) -> walls.WallState:
        state: walls.WallState = await self._ask(make, timeout)
        return state

    async def _ask(self, make: Callable[[result.Welcome], Question], timeout: float) -> Any:
        connection = await self._live()
        engine = connection.engine
        assert engine.welcome is not None
        question = make(engine.welcome)
        ended = asyncio.Event()
        question.on_end = lambda _: ended.set()
        engine.ask(question)
        connection.move()
        try:
            await _within(ended.wait(), timeout)
        except BaseException:
            engine.forget(question)
            raise
        if question.error is not None:
            raise question.error
        return question.value


async def _within(what: Coroutine[Any, Any, _T], timeout: Optional[float]) -> _T:
    async with asyncio.timeout(timeout):
        return await what
