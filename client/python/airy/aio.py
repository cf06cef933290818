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
from typing import Any, Callable, Generic, Optional, Sequence, TypeVar, Union

from . import _request, _transport, errors, payload, result
from ._engine import Engine, ProgressCallback, Request
from ._request import Output, Param
from ._wire import Type
from .client import _PLAN_OPTIONS, answered, lost

_T = TypeVar("_T")


class _Connection:
    """A socket on the running loop, and its engine."""

    def __init__(self, s: socket.socket) -> None:
        self.socket = s
        self.engine = Engine()
        self._loop = asyncio.get_running_loop()
        self._buffer = memoryview(bytearray(_transport.READ_BYTES))
        self._writing = False
        self._timer: Optional[asyncio.TimerHandle] = None
        self._greeted: asyncio.Future[None] = self._loop.create_future()
        s.setblocking(False)
        self._loop.add_reader(s, self._on_readable)
        self.move()

    async def greet(self, timeout_s: float) -> None:
        try:
            await asyncio.wait_for(self._greeted, timeout_s)
        except asyncio.TimeoutError:
            raise errors.ConnectionLost(
                f"the daemon did not answer HELLO in {timeout_s:g} s", field="socket"
            ) from None

    def close(self, why: Optional[errors.AiryError] = None) -> None:
        if self.socket.fileno() >= 0:
            self._loop.remove_reader(self.socket)
            self._loop.remove_writer(self.socket)
            self.socket.close()
        if self._timer is not None:
            self._timer.cancel()
        self.engine.lose(why or errors.ConnectionLost("the connection was closed by close()"))
        if not self._greeted.done():
            assert self.engine.lost is not None
            self._greeted.set_exception(self.engine.lost)

    def move(self) -> None:
        """Sends what can be sent, and asks the loop for the rest."""
        if self.engine.lost is not None:
            self.close()
            return
        refused = self._write()
        if refused is not None:
            # The daemon may have sent the reason first.
            self.close(self._read() or refused)
            return
        want = self.engine.outgoing() is not None
        if want != self._writing:
            self._writing = want
            if want:
                self._loop.add_writer(self.socket, self.move)
            else:
                self._loop.remove_writer(self.socket)
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        wake = self.engine.next_wake()
        if wake is not None:
            self._timer = self._loop.call_later(max(0.0, wake - self.engine.clock()), self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self.engine.tick()
        self.move()

    def _write(self) -> Optional[errors.AiryError]:
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
            if self.engine.lost is not None:
                break
            try:
                came = _transport.receive(self.socket, self._buffer)
            except OSError as e:
                return lost(e)
            if came is None:
                break
            n, fds, truncated = came
            if not n:
                _transport.close_all(fds)
                return lost(None)
            self.engine.incoming(self._buffer[:n], fds, truncated)
        return None

    def _on_readable(self) -> None:
        ended = self._read()
        if ended is not None:
            self.close(ended)
            return
        if self.engine.welcome is not None and not self._greeted.done():
            self._greeted.set_result(None)
        self.move()


class Pending(Generic[_T]):
    """A request in flight: await it."""

    def __init__(self, connection: _Connection, request: Request) -> None:
        self._connection = connection
        self._request = request
        self._loop = asyncio.get_running_loop()
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


class Client:
    """Connects on `async with`, or at the first verb; path as airy.Client's."""

    def __init__(self, path: Optional[_transport.PathLike] = None, timeout: float = _transport.CONNECT_TIMEOUT_S) -> None:
        self._path = path
        self._timeout = timeout
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

    async def bloom(self, frame: payload.Source, /, **options: Any) -> result.Result:
        """One frame; see airy.Client.bloom. For a time limit: asyncio.wait_for."""
        return await (await self.submit(frame, **options)).result()

    async def submit(
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
        **params: Param,
    ) -> Pending[result.Result]:
        """Returns when the frame is on its way: at once, or as soon as credit allows. Await what it returns."""
        return await self._submit(
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
            )
        )

    async def plan(self, frame: payload.Source, /, **options: Any) -> result.Result:
        extra = {k: options.pop(k) for k in _PLAN_OPTIONS & options.keys()}
        pending: Pending[result.Result] = await self._submit(
            lambda engine: _request.bloom(engine, frame, options, plan_only=True, **extra)
        )
        return await pending.result()

    async def asset(self, source: payload.Source, *, via: Optional[payload.Via] = None) -> result.Asset:
        pending: Pending[result.Asset] = await self._submit(lambda engine: _request.asset(engine, source, via))
        return await pending.result()

    async def status(self) -> result.Status:
        return result.status(await self._ask(Type.STATUS, None, Type.STATUS_REPLY))

    async def wall_list(self, name: str = "") -> Any:
        """The WallReply message; for daemons with the feature "wall"."""
        engine = (await self._live()).engine
        assert engine.welcome is not None
        if "wall" not in engine.welcome.features:
            raise errors.InvalidRequest("the daemon has no walls", field="wall")
        return await self._ask(Type.WALL, _request.wall_list(name), Type.WALL_REPLY)

    async def _live(self) -> _Connection:
        async with self._connecting:
            if self._closed:
                raise errors.ConnectionLost("the client was closed")
            if self._connection is None or self._connection.engine.lost is not None:
                # A Unix socket connects at once, unless the backlog is full: not the loop's to wait for.
                s = await asyncio.to_thread(_transport.connect, self._path, self._timeout)
                self._connection = _Connection(s)
                try:
                    await self._connection.greet(self._timeout)
                except BaseException:
                    self._connection.close()
                    raise
            return self._connection

    async def _submit(self, make: Callable[[Engine], Request]) -> Pending[_T]:
        connection = await self._live()
        request = make(connection.engine)
        pending: Pending[_T] = Pending(connection, request)
        connection.engine.submit(request)
        connection.move()
        await pending.sent()
        return pending

    async def _ask(self, kind: Type, body: Any, answer: Type) -> Any:
        connection = await self._live()
        got: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        id = connection.engine.ask(kind, body, answer, lambda m: None if got.done() else got.set_result(m))
        connection.move()
        try:
            return answered(await got, connection.engine)
        finally:
            connection.engine.forget(id)
