# SPDX-License-Identifier: Apache-2.0
"""One client's side of the conversation, without a socket: bytes and descriptors in, bytes and descriptors out.

The blocking and the asyncio client drive this same code, so that there is one place where credits are counted, requests wait,
BUSY is tried again, and what the daemon sends is checked. What comes is taken as hostile: a message that may not come
loses the connection, with words, and every descriptor that came is closed.

A stream of bytes may end (drop) and another begin (begin): what may be asked again then waits for the next WELCOME, at most
RESENDS times each, and for at most `again_s` seconds without an answer; all else ends. lose() is the end of it all.
"""
from __future__ import annotations

import time
from collections import deque
from typing import Any, Callable, NamedTuple, Optional, Union

from . import _transport, _wire, errors, result
from . import airy_pb2 as pb
from ._task import ProgressCallback, Question, Request
from ._wire import Type

BUSY_TRIES = 8
BUSY_WAIT_S = (0.01, 5.0)  # whatever retry_after_ms says
# A wall that is being closed is gone in a second.
QUESTION_BUSY_TRIES = 40
QUESTION_WAIT_S = (0.01, 0.5)
QUESTIONS_MAX = 1024  # not answered, those included that nobody waits for any more
RESENDS = 3  # of one request, lest a frame that ends the daemon does so for ever

__all__ = ["Engine", "Piece", "ProgressCallback", "Question", "Request"]


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
    def __init__(self, clock: Callable[[], float] = time.monotonic, again_s: float = 0.0) -> None:
        self.clock = clock
        self.again_s = again_s
        self.welcome: Optional[result.Welcome] = None  # the last one
        self.ready = False  # greeted on this stream
        self.down: Optional[errors.AiryError] = None  # why there is no stream
        self.lost: Optional[errors.AiryError] = None
        self.credit = 0
        self._next_id = 1
        self._open: dict[int, Request] = {}
        self._waiting: deque[Request] = deque()
        self._asked: dict[int, Question] = {}
        self._asking: deque[Question] = deque()
        self._give_up_at: Optional[float] = None
        self._begin()

    def _begin(self) -> None:
        self.ready = False
        self._draining: Optional[errors.AiryError] = None
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

    # ---- the stream's life ---------------------------------------------------------------------

    @property
    def wanted(self) -> bool:
        """Does something wait for a stream?"""
        return bool(self._waiting or self._asking)

    def begin(self) -> None:
        """There is a new stream, and nothing on it yet."""
        assert self.lost is None
        self.down = None
        self._begin()

    def drop(self, why: errors.AiryError) -> None:
        """The stream is gone. What may be asked again waits for the next; all else ends so."""
        if self.lost is not None:
            return
        if self.welcome is None or not self.again_s:
            self.lose(why)
            return
        self.down = why
        self._forget_stream()
        requests, self._open = [self._open[id] for id in sorted(self._open)], {}
        questions, self._asked = list(self._asked.values()), {}
        again = [r for r in requests if r.idempotent and not r.cancelled and r.resent < RESENDS]
        asked_again = [q for q in questions if not q.ended and q.idempotent and q.resent < RESENDS]
        for r in again:
            r.resent += 1
        for q in asked_again:
            q.resent += 1
        self._waiting.extendleft(reversed(again))
        self._asking.extendleft(reversed(asked_again))
        if self.wanted:
            self._give_up_at = self._give_up_at or self.clock() + self.again_s
        for r in requests:
            if r not in again:
                self._end(r, errors.Cancelled("the request was cancelled") if r.cancelled else why)
        for q in questions:
            if not q.ended and q not in asked_again:
                q.end(why)

    def refused(self, why: errors.AiryError) -> None:
        """No new stream could be had: the reason, for when the time is up."""
        self.down = why

    def lose(self, why: errors.AiryError) -> None:
        """It is over: every request ends so, every descriptor is closed."""
        if self.lost is not None:
            return
        self.lost = why
        self.ready = False
        self._forget_stream()
        requests = [*self._open.values(), *self._waiting]
        questions = [*self._asked.values(), *self._asking]
        self._open, self._asked = {}, {}
        self._waiting.clear()
        self._asking.clear()
        for request in requests:
            self._end(request, why)
        for question in questions:
            if not question.ended:
                question.end(why)

    def _forget_stream(self) -> None:
        self.ready = False
        self._head = None
        self._control.clear()
        self._uploads.clear()
        while self._sets:
            _transport.close_all(self._sets.popleft().fds)
        _transport.close_all(self._fds)
        self._fds = []

    def _await_stream(self) -> None:
        if self.down is not None and self._give_up_at is None:
            self._give_up_at = self.clock() + self.again_s

    # ---- requests ------------------------------------------------------------------------------

    def submit(self, request: Request) -> None:
        """Sends it once credit and a place are there, in the order of the submits. Takes over its payload."""
        try:
            if self.lost is not None:
                raise self.lost
            self._check_size(request)
            _wire.pack(request.kind, 1, request.body)
        except BaseException:
            request.prepared.close()
            raise
        self._waiting.append(request)
        self._await_stream()
        self.tick()

    def _check_size(self, request: Request) -> None:
        most = self._limits().max_frame_bytes
        if request.size > most:
            raise errors.LimitError(
                f"the payload is {request.size} bytes; at most {most} are taken", field="input.size"
            )

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

    def ask(self, question: Question) -> None:
        """One answer for one question, beside whatever is in flight."""
        if self.lost is not None:
            raise self.lost
        if len(self._asked) + len(self._asking) >= QUESTIONS_MAX:
            raise errors.InvalidRequest(f"{QUESTIONS_MAX} earlier questions are not answered yet", field="id")
        _wire.pack(question.kind, 1, question.body)
        self._asking.append(question)
        self._await_stream()
        self.tick()

    def forget(self, question: Question) -> None:
        """Nobody waits for it any more; its answer may still come."""
        question.end(None)
        if question in self._asking:
            self._asking.remove(question)

    def tick(self) -> None:
        """Sends what may go now: called after whatever may have made room, and at next_wake()."""
        if self.lost is not None:
            return
        now = self.clock()
        if not self.wanted:
            self._give_up_at = None
        if self.down is not None and self._give_up_at is not None and now >= self._give_up_at:
            self.lose(self.down)
            return
        if self._draining is not None:
            # It does nothing more for anybody: the next one will.
            if not self._open and not self._asked:
                self.drop(self._draining)
            return
        if not self.ready:
            return
        for question in [q for q in self._asking if q.not_before <= now]:
            self._asking.remove(question)
            self._put(question)
        limits = self._limits()
        for request in list(self._waiting):
            if request.not_before > now:
                continue
            # A big frame is not overtaken for ever by small ones behind it.
            if request.size > self.credit or len(self._open) >= limits.max_requests:
                break
            self._waiting.remove(request)
            self._send(request)

    def next_wake(self) -> Optional[float]:
        """When what was BUSY is due again, or the waiting for a daemon is over, by the clock."""
        tasks: list[Union[Request, Question]] = [*self._waiting, *self._asking]
        times = [t.not_before for t in tasks if t.not_before] if self.ready else []
        if self.down is not None and self._give_up_at is not None:
            times.append(self._give_up_at)
        return min(times, default=None)

    def _limits(self) -> result.Limits:
        assert self.welcome is not None
        return self.welcome.limits

    def _new_id(self) -> int:
        id = self._next_id
        self._next_id += 1
        return id

    def _put(self, question: Question) -> None:
        question.id = self._new_id()
        question.tries += 1
        question.received = bytearray()
        self._asked[question.id] = question
        self._control.append((_wire.pack(question.kind, question.id, question.body), ()))

    def _send(self, request: Request) -> None:
        if request.kind == Type.BLOOM and request.body.HasField("wall"):
            self._ask_drive_shape(request)
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

    def _ask_drive_shape(self, request: Request) -> None:
        # A drive is as large as its wall, which its RESULT does not say; the answer comes before that.
        if request.plan_only or request.body.output.kind == pb.Output.WALL:
            return
        prepared = request.prepared

        def take(m: Any, _: bytes) -> None:
            for wall in m.walls:
                prepared.shape = result.Shape((wall.height, wall.width, 3), "<f4")

        body = pb.Wall(action=pb.Wall.LIST, name=request.body.wall.name)
        self._put(Question(Type.WALL, body, Type.WALL_REPLY, take, idempotent=False))

    def _drop_upload(self, request: Request) -> None:
        # At a message's end: what of a DATA has begun goes on.
        for upload in self._uploads:
            if upload.request is request:
                self._uploads.remove(upload)
                return

    def _end(self, request: Request, error: Optional[BaseException], value: Any = None) -> None:
        self._open.pop(request.id, None)
        self._drop_upload(request)
        request.end(error, value)

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
        if self.lost is not None or self.down is not None:
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
                self._take_data(header.id, data[:n])
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
            if self.lost is not None or self.down is not None:
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
        request, question = self._open.get(header.id), self._asked.get(header.id)
        task: Union[Request, Question]
        if question is not None and question.data_max:
            task, most = question, question.data_max
        elif not self.ready or request is None or request.kind != Type.BLOOM or request.plan_only:
            raise self._may_not(header)
        elif request.body.output.kind != pb.Output.INLINE:
            raise errors.PeerFault(f"DATA came for request {header.id}, whose output is not inline", field="output")
        else:
            task, most = request, self._limits().max_frame_bytes
        if len(task.received) + header.body_bytes > most:
            raise errors.PeerFault(f"more DATA came for request {header.id} than {most} bytes", field="output.size")

    def _take_data(self, id: int, data: memoryview) -> None:
        question = self._asked.get(id)
        if question is None:
            self._open[id].received += data
        else:
            question.received += data

    def _may_not(self, header: _wire.Header) -> errors.PeerFault:
        when = "now" if self.ready else "before WELCOME"
        return errors.PeerFault(f"the daemon sent {header.type.name} for id {header.id}, which may not come {when}")

    def _dispatch(self, header: _wire.Header, body: bytes, fds: list[int]) -> None:
        """One message. Takes what it keeps out of `fds`; the caller closes the rest."""
        m = _wire.parse(header.type, body)
        if header.type == Type.ERROR:
            self._on_error(header, m)
            return
        if self.ready == (header.type == Type.WELCOME):
            raise self._may_not(header)
        if header.type == Type.WELCOME:
            if m.version != _wire.VERSION:
                raise errors.PeerFault(
                    f"the daemon chose protocol version {m.version}, asked was {_wire.VERSION}", field="version"
                )
            self._on_welcome(result.welcome(m))
            return
        if header.type == Type.CREDIT:
            self.credit = min(self.credit + m.bytes, self._limits().credit_bytes)
            return
        if header.type in (Type.STATUS_REPLY, Type.WALL_REPLY):
            self._on_answer(header, m)
            return
        request = self._open.get(header.id)
        if header.type == Type.PROGRESS:
            # Of a frame that is done again the second way through is not told twice.
            if request is not None and request.progress is not None and m.fraction >= request.fraction:
                request.fraction = m.fraction
                self._call_progress(request, m.stage, m.fraction)
            return
        end = {Type.BLOOM: Type.RESULT, Type.ASSET: Type.ASSET_KEPT}
        if request is None or header.type not in (Type.CANCELLED, end[request.kind]):
            raise self._may_not(header)
        self._give_up_at = None
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

    def _on_welcome(self, welcome: result.Welcome) -> None:
        self.welcome = welcome
        self.ready = True
        self.credit = welcome.limits.credit_bytes
        # Another daemon may take less, and what can never be sent would hold up all behind it.
        for request in [r for r in self._waiting if r.size > welcome.limits.max_frame_bytes]:
            self._waiting.remove(request)
            try:
                self._check_size(request)
            except errors.LimitError as e:
                self._end(request, e)

    def _on_answer(self, header: _wire.Header, m: Any) -> None:
        question = self._asked.get(header.id)
        if question is None or question.answer != header.type:
            raise self._may_not(header)
        self._give_up_at = None
        del self._asked[header.id]
        if question.ended:
            return
        try:
            question.end(None, question.make(m, bytes(question.received)))
        except errors.PeerFault as e:
            question.end(e)

    def _on_error(self, header: _wire.Header, m: Any) -> None:
        error = errors.from_daemon(
            m.code, m.symbol, m.text, m.field, m.retryable, m.retry_after_ms, m.queue_position
        )
        request = self._open.get(header.id) if header.id else None
        question = self._asked.pop(header.id, None)
        if header.id and request is None and question is None:
            raise errors.PeerFault(f"the daemon sent ERROR {m.symbol} for request {header.id}, which is not open")
        last = not header.id or errors.closes(m.code)
        if last and error.retryable:
            self.drop(error)  # the daemon's last word on this connection
            return
        if question is not None:
            self._question_failed(question, error)
        elif request is not None:
            self._request_failed(request, error)
        if last:
            self.lose(error)

    def _stopping(self, error: errors.DaemonError) -> bool:
        """Is it a stopping daemon's refusal, and another one worth waiting for?"""
        if not isinstance(error, errors.ShuttingDown) or not self.again_s:
            self._give_up_at = None
            return False
        self._draining = error
        self._give_up_at = self._give_up_at or self.clock() + self.again_s
        return self.clock() < self._give_up_at

    def _question_failed(self, question: Question, error: errors.DaemonError) -> None:
        if question.ended:
            return
        if self._stopping(error):
            self._asking.append(question)
        elif isinstance(error, errors.Busy) and question.tries < QUESTION_BUSY_TRIES:
            question.not_before = self.clock() + _between(error.retry_after_ms / 1000, QUESTION_WAIT_S)
            self._asking.append(question)
        else:
            question.end(error)

    def _request_failed(self, request: Request, error: errors.DaemonError) -> None:
        stopping = self._stopping(error)
        busy = isinstance(error, errors.Busy) and request.tries < BUSY_TRIES
        if request.cancelled or not (stopping or busy):
            self._end(request, error)
            return
        del self._open[request.id]
        self._drop_upload(request)
        if busy:
            request.not_before = self.clock() + _between(error.retry_after_ms / 1000, BUSY_WAIT_S)
        self._waiting.appendleft(request)

    def _on_result(self, request: Request, m: Any, fds: list[int]) -> None:
        try:
            data = self._output(request, m.output, fds)
            shape = request.prepared.shape
            if data is not None and shape is not None and len(data) != shape.nbytes:
                raise errors.PeerFault(f"the result is {len(data)} bytes, expected {shape.nbytes}", field="output.size")
            self._end(request, None, result.result(m, request.id, data, shape))
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


def _between(value: float, least_most: tuple[float, float]) -> float:
    return min(max(value, least_most[0]), least_most[1])
