# SPDX-License-Identifier: Apache-2.0
"""One connection's side of the conversation, without a socket: bytes and descriptors in, bytes and descriptors out.

The blocking and the asyncio client drive this same code, so that there is one place where credits are counted, requests wait,
BUSY is tried again, and what the daemon sends is checked. What comes is taken as hostile: a message that may not come
loses the connection, with words, and every descriptor that came is closed.
"""
from __future__ import annotations

import time
from collections import deque
from typing import Any, Callable, NamedTuple, Optional

from . import _transport, _wire, errors, payload, result
from . import airy_pb2 as pb
from ._wire import Type

BUSY_TRIES = 8
BUSY_WAIT_S = (0.01, 5.0)  # whatever retry_after_ms says

ProgressCallback = Callable[[str, float], None]


def _nothing(_: Any) -> None:
    pass


class Request:
    """From submit to its one end; `on_end` is then called, from within whatever drives the engine."""

    def __init__(
        self,
        kind: Type,
        body: Any,
        prepared: payload.Prepared,
        plan_only: bool = False,
        progress: Optional[ProgressCallback] = None,
    ) -> None:
        self.kind = kind
        self.body = body
        self.prepared = prepared
        self.plan_only = plan_only
        self.progress = progress
        self.id = 0
        self.tries = 0
        self.not_before = 0.0
        self.sent = False  # at least once
        self.cancelled = False
        self.received = bytearray()
        self.ended = False
        self.value: Any = None
        self.error: Optional[BaseException] = None
        self.on_sent: Callable[[Request], None] = _nothing
        self.on_end: Callable[[Request], None] = _nothing

    @property
    def size(self) -> int:
        return self.prepared.size


class Piece(NamedTuple):
    """What one sendmsg begins with; descriptors go with its first byte."""

    buffers: list[memoryview]
    fds: tuple[int, ...]


class _FdSet(NamedTuple):
    first: int  # stream bytes [first, end) that the descriptors came with
    end: int
    fds: list[int]
    truncated: bool


class _Upload:
    def __init__(self, request: Request, data: memoryview) -> None:
        self.request = request
        self.id = request.id
        self.data = data
        self.at = 0


class Engine:
    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self.welcome: Optional[result.Welcome] = None
        self.lost: Optional[errors.AiryError] = None
        self.credit = 0
        self._next_id = 1
        self._open: dict[int, Request] = {}
        self._waiting: deque[Request] = deque()
        self._asked: dict[int, tuple[Type, Callable[[Any], None]]] = {}
        # out
        self._control: deque[tuple[bytes, tuple[int, ...]]] = deque()
        self._uploads: deque[_Upload] = deque()
        self._head: Optional[Piece] = None
        # in
        self._sets: deque[_FdSet] = deque()
        self._received = 0
        self._taken = 0
        self._header: Optional[_wire.Header] = None
        self._fds: list[int] = []
        self._part = bytearray()  # of a header, or of a body that is no DATA
        self._data_left = 0
        hello = pb.Hello(version_min=_wire.VERSION, version_max=_wire.VERSION, client="airy-python/0.1.0")
        self._control.append((_wire.pack(Type.HELLO, 0, hello), ()))

    # ---- requests ------------------------------------------------------------------------------

    def submit(self, request: Request) -> None:
        """Sends it once credit and a place are there, in the order of the submits. Takes over its payload."""
        try:
            if self.lost is not None:
                raise self.lost
            limits = self._limits()
            if request.size > limits.max_frame_bytes:
                raise errors.LimitError(
                    f"the payload is {request.size} bytes; at most {limits.max_frame_bytes} are taken",
                    field="input.size",
                )
            _wire.pack(request.kind, 1, request.body)
        except BaseException:
            request.prepared.close()
            raise
        self._waiting.append(request)
        self.tick()

    def cancel(self, request: Request) -> None:
        """Asks for an early end; no harm when it has ended."""
        if request.ended or request.cancelled:
            return
        request.cancelled = True
        if request in self._waiting:
            self._waiting.remove(request)
            self._end(request, errors.Cancelled("the request was cancelled"))
            return
        self._drop_upload(request)
        self._control.append((_wire.pack(Type.CANCEL, request.id), ()))

    def ask(self, kind: Type, body: Any, answer: Type, then: Callable[[Any], None]) -> int:
        """A question with one answer: STATUS, WALL. Returns its id, to forget()."""
        if self.lost is not None:
            raise self.lost
        message = _wire.pack(kind, self._next_id, body)
        id = self._new_id()
        self._asked[id] = (answer, then)
        self._control.append((message, ()))
        return id

    def forget(self, id: int) -> None:
        self._asked.pop(id, None)

    def tick(self) -> None:
        """Sends what may go now: called after whatever may have made room, and at next_wake()."""
        if self.welcome is None or self.lost is not None:
            return
        limits = self._limits()
        now = self.clock()
        for request in list(self._waiting):
            if request.not_before > now:
                continue
            # A big frame is not overtaken for ever by small ones behind it.
            if request.size > self.credit or len(self._open) >= limits.max_requests:
                break
            self._waiting.remove(request)
            self._send(request)

    def next_wake(self) -> Optional[float]:
        """When a request that was BUSY is due again, by the clock."""
        times = [r.not_before for r in self._waiting if r.not_before]
        return min(times, default=None)

    def lose(self, why: errors.AiryError) -> None:
        """The connection is gone: every request ends so, every descriptor is closed."""
        if self.lost is not None:
            return
        self.lost = why
        self._head = None
        self._control.clear()
        self._uploads.clear()
        while self._sets:
            _transport.close_all(self._sets.popleft().fds)
        _transport.close_all(self._fds)
        self._fds = []
        for request in [*self._open.values(), *self._waiting]:
            self._end(request, why)
        self._open.clear()
        self._waiting.clear()
        asked, self._asked = self._asked, {}
        for _, then in asked.values():
            then(None)

    def _limits(self) -> result.Limits:
        assert self.welcome is not None
        return self.welcome.limits

    def _new_id(self) -> int:
        id = self._next_id
        self._next_id += 1
        return id

    def _send(self, request: Request) -> None:
        request.id = self._new_id()
        request.tries += 1
        request.received = bytearray()
        fds = tuple(request.prepared.fds)
        self._open[request.id] = request
        self.credit -= request.size
        self._control.append((_wire.pack(request.kind, request.id, request.body, len(fds)), fds))
        if request.prepared.data is not None:
            self._uploads.append(_Upload(request, request.prepared.data))
        request.sent = True
        request.on_sent(request)

    def _drop_upload(self, request: Request) -> None:
        # At a message's end: what of a DATA has begun goes on.
        for upload in self._uploads:
            if upload.request is request:
                self._uploads.remove(upload)
                return

    def _end(self, request: Request, error: Optional[BaseException], value: Any = None) -> None:
        self._open.pop(request.id, None)
        self._drop_upload(request)
        request.prepared.close()
        request.ended = True
        if request.error is None:
            request.error = error
        request.value = value
        on_end = request.on_end
        # No cycle may keep a mapped frame alive until somebody collects garbage.
        request.on_sent = request.on_end = _nothing
        on_end(request)

    # ---- out -----------------------------------------------------------------------------------

    def outgoing(self) -> Optional[Piece]:
        """The next bytes, none of another message beside descriptors; None when all is out."""
        if self._head is None and self._control:
            message, fds = self._control.popleft()
            self._head = Piece([memoryview(message)], fds)
        elif self._head is None and self._uploads:
            upload = self._uploads[0]
            chunk = upload.data[upload.at : upload.at + _wire.DATA_BYTES_MAX]
            upload.at += len(chunk)
            if upload.at == len(upload.data):
                self._uploads.popleft()
            header = _wire.encode(Type.DATA, upload.id, len(chunk))
            self._head = Piece([memoryview(header), chunk], ())
        return self._head

    def went(self, n: int) -> None:
        """So many bytes of outgoing() are on their way."""
        assert self._head is not None
        if not n:
            return
        left = []
        for buffer in self._head.buffers:
            if n < len(buffer):
                left.append(buffer[n:])
            n = max(0, n - len(buffer))
        self._head = Piece(left, ()) if left else None

    # ---- in ------------------------------------------------------------------------------------

    def incoming(self, data: memoryview, fds: list[int], truncated: bool = False) -> None:
        """Bytes as they came from one receive, and the descriptors that came with them."""
        if self.lost is not None:
            _transport.close_all(fds)
            return
        first, self._received = self._received, self._received + len(data)
        if fds or truncated:
            self._sets.append(_FdSet(first, self._received, fds, truncated))
        try:
            self._read(data)
            self._check_unclaimed()
        except errors.ProtocolError as e:
            self.lose(errors.PeerFault(f"from the daemon: {e.text}", field=e.field))
        except errors.PeerFault as e:
            self.lose(e)
        self.tick()

    def _read(self, data: memoryview) -> None:
        while True:
            if self._header is None:
                n = min(_wire.HEADER_BYTES - len(self._part), len(data))
                self._part += data[:n]
                data = data[n:]
                if len(self._part) < _wire.HEADER_BYTES:
                    self._taken += n
                    return
                header = _wire.decode(bytes(self._part), "daemon")
                self._fds = self._claim(header, self._taken + n - _wire.HEADER_BYTES)
                self._taken += n
                self._part.clear()
                self._header = header
                if header.type == Type.DATA:
                    self._data_left = header.body_bytes
                    self._check_data(header)
            header = self._header
            if header.type == Type.DATA:
                n = min(self._data_left, len(data))
                self._open[header.id].received += data[:n]
                self._data_left -= n
                done = not self._data_left
            else:
                n = min(header.body_bytes - len(self._part), len(data))
                self._part += data[:n]
                done = len(self._part) == header.body_bytes
            data = data[n:]
            self._taken += n
            if not done:
                return
            if self._sets and self._sets[0].end <= self._taken:
                raise errors.BadFds(
                    f"{len(self._sets[0].fds)} descriptors came with bytes of {header.type.name} that its header "
                    "does not state",
                    field="header.n_fds",
                )
            body, fds = bytes(self._part), self._fds
            self._part.clear()
            self._header, self._fds = None, []
            if header.type != Type.DATA:
                try:
                    self._dispatch(header, body, fds)
                finally:
                    _transport.close_all(fds)
            if self.lost is not None:
                return

    def _claim(self, header: _wire.Header, at: int) -> list[int]:
        """The descriptors of the header that begins at this byte of the stream."""
        s = self._sets[0] if self._sets else None
        with_header = s is not None and s.first <= at < s.end
        if not header.n_fds:
            if s is not None and s.end <= at:
                raise errors.BadFds(f"{len(s.fds)} descriptors came with bytes of no header", field="header.n_fds")
            return []
        if s is None or not with_header:
            raise errors.BadFds(
                f"{header.type.name} says that it brings {header.n_fds} descriptors, none came with its first byte",
                field="header.n_fds",
            )
        if s.truncated or len(s.fds) != header.n_fds:
            lost = " and others could not be taken" if s.truncated else ""
            raise errors.BadFds(
                f"{header.type.name} says that it brings {header.n_fds} descriptors, {len(s.fds)} came{lost}",
                field="header.n_fds",
            )
        return self._sets.popleft().fds

    def _check_unclaimed(self) -> None:
        # Only a header that is still in parts can claim what is left.
        partial = self._header is None and self._part
        at = self._taken - len(self._part)
        for i, s in enumerate(self._sets):
            if i or not partial or not s.first <= at < s.end:
                raise errors.BadFds(
                    f"{len(s.fds)} descriptors came with bytes of no header that states them", field="header.n_fds"
                )

    def _check_data(self, header: _wire.Header) -> None:
        request = self._open.get(header.id)
        if self.welcome is None or request is None or request.kind != Type.BLOOM or request.plan_only:
            raise self._may_not(header)
        if request.body.output.kind != pb.Output.INLINE:
            raise errors.PeerFault(f"DATA came for request {header.id}, whose output is not inline", field="output")
        most = self._limits().max_frame_bytes
        if len(request.received) + header.body_bytes > most:
            raise errors.PeerFault(f"more DATA came for request {header.id} than {most} bytes", field="output.size")

    def _may_not(self, header: _wire.Header) -> errors.PeerFault:
        when = "before WELCOME" if self.welcome is None else "now"
        return errors.PeerFault(f"the daemon sent {header.type.name} for id {header.id}, which may not come {when}")

    def _dispatch(self, header: _wire.Header, body: bytes, fds: list[int]) -> None:
        """One message. Takes what it keeps out of `fds`; the caller closes the rest."""
        m = _wire.parse(header.type, body)
        if header.type == Type.ERROR:
            self._on_error(header, m)
            return
        if (self.welcome is None) != (header.type == Type.WELCOME):
            raise self._may_not(header)
        if header.type == Type.WELCOME:
            if m.version != _wire.VERSION:
                raise errors.PeerFault(
                    f"the daemon chose protocol version {m.version}, asked was {_wire.VERSION}", field="version"
                )
            self.welcome = result.welcome(m)
            self.credit = self.welcome.limits.credit_bytes
            return
        if header.type == Type.CREDIT:
            self.credit = min(self.credit + m.bytes, self._limits().credit_bytes)
            return
        if header.type in (Type.STATUS_REPLY, Type.WALL_REPLY):
            answer, then = self._asked.get(header.id, (header.type, lambda _: None))
            if answer != header.type:
                raise self._may_not(header)
            self.forget(header.id)
            then(m)
            return
        request = self._open.get(header.id)
        if header.type == Type.PROGRESS:
            if request is not None and request.progress is not None:
                self._call_progress(request, m.stage, m.fraction)
            return
        end = {Type.BLOOM: Type.RESULT, Type.ASSET: Type.ASSET_KEPT}
        if request is None or header.type not in (Type.CANCELLED, end[request.kind]):
            raise self._may_not(header)
        if header.type == Type.CANCELLED:
            self._end(request, errors.Cancelled("the request was cancelled"))
        elif header.type == Type.RESULT:
            self._on_result(request, m, fds)
        else:
            self._end(request, None, result.Asset(m.digest, m.width, m.height))

    def _call_progress(self, request: Request, stage: str, fraction: float) -> None:
        assert request.progress is not None
        try:
            request.progress(stage, fraction)
        except BaseException as e:  # raised again by whoever waits for the request
            request.error = e
            request.progress = None
            self.cancel(request)

    def _on_error(self, header: _wire.Header, m: Any) -> None:
        error = errors.from_daemon(
            m.code, m.symbol, m.text, m.field, m.retryable, m.retry_after_ms, m.queue_position
        )
        request = self._open.get(header.id) if header.id else None
        asked = self._asked.pop(header.id, None)
        if header.id and request is None and asked is None:
            raise errors.PeerFault(f"the daemon sent ERROR {m.symbol} for request {header.id}, which is not open")
        if asked is not None:
            asked[1](error)
        elif request is not None:
            self._request_failed(request, error)
        if not header.id or errors.closes(m.code):
            self.lose(error)  # the daemon's last word

    def _request_failed(self, request: Request, error: errors.DaemonError) -> None:
        again = isinstance(error, errors.Busy) and not request.cancelled and request.tries < BUSY_TRIES
        if not again:
            self._end(request, error)
            return
        low, high = BUSY_WAIT_S
        del self._open[request.id]
        self._drop_upload(request)
        request.not_before = self.clock() + min(max(error.retry_after_ms / 1000, low), high)
        self._waiting.appendleft(request)

    def _on_result(self, request: Request, m: Any, fds: list[int]) -> None:
        try:
            data = self._output(request, m.output, fds)
            self._end(request, None, result.result(m, request.id, data, request.prepared.shape))
        except (errors.PeerFault, OSError, ValueError, MemoryError) as e:
            self._end(request, e)

    def _output(self, request: Request, out: Any, fds: list[int]) -> Optional[memoryview]:
        expected = {pb.Output.INLINE: pb.Payload.INLINE, pb.Output.MEMFD: pb.Payload.MEMFD}
        want = pb.Payload.NONE if request.plan_only else expected.get(request.body.output.kind, pb.Payload.NONE)
        if out.kind != want or out.fd or bool(fds) != (want == pb.Payload.MEMFD):
            raise errors.PeerFault(
                f"the result came as kind {out.kind} with {len(fds)} descriptors, expected kind {want}",
                field="output.kind",
            )
        if want == pb.Payload.MEMFD:
            return result.map_output(fds[0], out.offset, out.size)
        if want == pb.Payload.INLINE:
            if out.size != len(request.received):
                raise errors.PeerFault(
                    f"the result is said to be {out.size} bytes, {len(request.received)} came", field="output.size"
                )
            return memoryview(request.received).toreadonly()
        own = request.prepared.output
        return None if own is None else memoryview(own)

