# SPDX-License-Identifier: Apache-2.0
"""A daemon that breaks the protocol. The real one does not: here the other end of a socket pair sends what it never would, and
both clients must end the connection, or the request, with words, and keep no descriptor. Cut stream and random bytes, too."""
from __future__ import annotations

import array
import asyncio
import gc
import json
import os
import random
import re
import socket
import struct
import tempfile
import threading
from pathlib import Path
from typing import Any, Callable, Optional
from unittest import mock

import airy
from airy import _engine, _transport, _wire
from airy import airy_pb2 as pb
from airy._wire import Type
from kit import VECTORS, Tap, equal, main, need, open_fds, raises

SEED = int(os.environ.get("AIRY_SEED", "0")) or random.SystemRandom().randrange(1, 2**31)
LIMITS = pb.Limits(
    max_frame_bytes=1 << 20, max_width=64, max_height=64, max_pixels=4096, credit_bytes=1 << 20, max_requests=4,
    max_body_bytes=1 << 20,
)
FEATURES = ["exr", "raw", "inline", "memfd", "file", "buffer", "progress", "asset", "plan", "wall"]
WELCOME = _wire.pack(Type.WELCOME, 0, pb.Welcome(version=1, server="peer", features=FEATURES, limits=LIMITS))
RAW = airy.Raw(bytes(6), 1, 1)
Script = Callable[[socket.socket], None]


def send(s: socket.socket, data: bytes, fds: Optional[list[int]] = None) -> None:
    rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
    s.sendmsg([data], rights)


def take(s: socket.socket) -> tuple[_wire.Header, bytes]:
    """The client's next message, its descriptors closed."""
    data, fds, _, _ = socket.recv_fds(s, _wire.HEADER_BYTES, 4)
    _transport.close_all(fds)
    header = _wire.decode(data, "client")
    body = b""
    while len(body) < header.body_bytes:
        body += s.recv(header.body_bytes - len(body))
    return header, body


def memfd(size: int, seal: bool = True) -> int:
    import fcntl

    fd = os.memfd_create("peer", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(fd, size)
    if seal:
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
    return fd


def pipe() -> int:
    reader, writer = os.pipe()
    os.close(writer)
    return reader


def result(kind: int = 0, id: int = 1, size: int = 0, offset: int = 0, fd: int = 0) -> Any:
    return pb.Result(output=pb.Payload(kind=kind, size=size, offset=offset, fd=fd))


def answers(*parts: bytes, fds: Optional[Callable[[], list[int]]] = None) -> Script:
    """Greets, takes one request, then sends the parts, the first with descriptors."""

    def script(s: socket.socket) -> None:
        take(s)
        send(s, WELCOME)
        while take(s)[0].type == Type.DATA:
            pass
        given = fds() if fds else []
        try:
            for i, part in enumerate(parts):
                send(s, part, given if i == 0 else None)
        finally:
            _transport.close_all(given)
        while s.recv(1 << 16):
            pass

    return script


def against(script: Script, verb: Callable[[airy.Client], Any]) -> Any:
    """What the blocking client says; the asyncio one must say the same."""
    says = []
    for use in (_blocking, _asyncio):
        ours, theirs = socket.socketpair()

        def serve() -> None:
            with theirs:
                try:
                    script(theirs)
                except OSError:
                    pass  # the client closed: what is tested is what it says

        thread = threading.Thread(target=serve)
        thread.start()
        with mock.patch.object(_transport, "connect", lambda *_: ours):
            try:
                says.append(use(verb))
            except airy.AiryError as e:
                says.append(e)
            finally:
                ours.close()
        thread.join(10)
        need(not thread.is_alive(), "the peer waits for ever")
    one, other = (re.sub("memory at 0x[0-9a-f]+", "memory", repr(said)) for said in says)
    equal(one, other, "what the asyncio client says")
    return says[0]


def _blocking(verb: Callable[[Any], Any]) -> Any:
    with airy.Client("peer", timeout=5, reconnect=0) as c:
        return verb(c)


def _asyncio(verb: Callable[[Any], Any]) -> Any:
    async def use() -> Any:
        async with airy.aio.Client("peer", timeout=5, reconnect=0) as c:
            return await asyncio.wait_for(verb(c), 10)

    return asyncio.run(use())


def bloom(c: Any, output: str = "memfd") -> Any:
    return c.bloom(RAW, via="memfd", output=output)


def pixels(c: Any) -> Any:
    """bloom()'s bytes, of either client."""
    got = bloom(c, "inline")
    if isinstance(got, airy.Result):
        return got.tobytes()

    async def later() -> bytes:
        return (await got).tobytes()

    return later()


def lies(tap: Tap) -> None:
    """name, what comes after the request, descriptors, output asked for, part of the text"""
    R, F = Type.RESULT, pb.Payload
    data = _wire.encode(Type.DATA, 1, 4) + b"abcd"
    cases: list[tuple[str, list[bytes], Optional[Callable[[], list[int]]], str, str]] = [
        ("a memfd that can shrink", [_wire.pack(R, 1, result(F.MEMFD, size=8), 1)], lambda: [memfd(8, False)], "memfd", "F_SEAL_SHRINK"),
        ("a pipe as the result", [_wire.pack(R, 1, result(F.MEMFD, size=8), 1)], lambda: [pipe()], "memfd", "F_SEAL_SHRINK"),
        ("a memfd that is too short", [_wire.pack(R, 1, result(F.MEMFD, size=9), 1)], lambda: [memfd(8)], "memfd", "has 8 bytes"),
        ("an offset beyond the memfd", [_wire.pack(R, 1, result(F.MEMFD, size=1, offset=2**63), 1)], lambda: [memfd(8)], "memfd", "has 8 bytes"),
        ("a result without its descriptor", [_wire.pack(R, 1, result(F.MEMFD, size=8))], None, "memfd", "with 0 descriptors"),
        ("inline where a memfd was asked for", [_wire.pack(R, 1, result(F.INLINE))], None, "memfd", "kind"),
        ("a descriptor with an inline result", [_wire.pack(R, 1, result(F.INLINE), 1)], lambda: [memfd(8)], "inline", "with 1 descriptors"),
        ("another descriptor's number", [_wire.pack(R, 1, result(F.MEMFD, size=8, fd=1), 1)], lambda: [memfd(8)], "memfd", "kind"),
        ("fewer bytes than the result says", [data, _wire.pack(R, 1, result(F.INLINE, size=5))], None, "inline", "4 came"),
        ("a descriptor that is announced and does not come", [_wire.pack(R, 1, result(F.MEMFD, size=8), 1)], None, "memfd", "none came"),
        ("two descriptors for one", [_wire.pack(R, 1, result(F.MEMFD, size=8), 1)], lambda: [memfd(8), memfd(8)], "memfd", "2 came"),
        ("200 descriptors", [_wire.pack(R, 1, result(F.MEMFD, size=8), 1)], lambda: [memfd(8) for _ in range(200)], "memfd", "200 came"),
        ("a descriptor with a message that states none", [_wire.pack(R, 1, result(F.INLINE))], lambda: [memfd(8)], "inline", "descriptors came"),
        ("DATA of nobody", [_wire.encode(Type.DATA, 9, 4) + b"abcd"], None, "inline", "may not come"),
        ("DATA where a memfd was asked for", [data], None, "memfd", "not inline"),
        ("more DATA than a frame", [_wire.encode(Type.DATA, 1, 1 << 20) + bytes(1 << 20), data], None, "inline", "more DATA"),
        ("RESULT of nobody", [_wire.pack(R, 7, result())], None, "memfd", "may not come"),
        ("ASSET_KEPT for a BLOOM", [_wire.pack(Type.ASSET_KEPT, 1, pb.AssetKept(digest="0" * 32))], None, "memfd", "may not come"),
        ("ERROR of nobody", [_wire.pack(Type.ERROR, 7, pb.Error(code=500))], None, "memfd", "not open"),
        ("WELCOME twice", [WELCOME], None, "memfd", "may not come"),
        ("a client's message", [_wire.pack(Type.STATUS, 1)], None, "memfd", "daemon's to send"),
        ("the end of a group", [_wire.encode(Type.RESULT, 1, 1) + b"\x14"], None, "memfd", "wire type 4"),
        ("a body that is cut", [_wire.encode(R, 1, 2) + b"\x0a\x7f"], None, "memfd", "cannot be decoded"),
        ("a text that is no UTF-8", [_wire.encode(Type.ERROR, 1, 4) + b"\x1a\x02\xff\xfe"], None, "memfd", "cannot be decoded"),
    ]
    for name, parts, fds, output, text in cases:
        tap.run(name, lambda: _lie(answers(*parts, fds=fds), output, text))


def _lie(script: Script, output: str, text: str) -> None:
    e = against(script, lambda c: bloom(c, output))
    equal(type(e), airy.errors.PeerFault, f"the exception's class for {e}")
    need(text in str(e), f"\"{text}\" is not in: {e}")


def wall_lies() -> None:
    """What is no answer to a question about walls."""
    state = pb.WallState(name="w", width=2, height=1)
    reply = lambda *w, **k: _wire.pack(Type.WALL_REPLY, 1, pb.WallReply(walls=w, **k))
    data = lambda n: _wire.encode(Type.DATA, 1, n) + bytes(n)
    inline = lambda n: pb.Payload(kind=pb.Payload.INLINE, size=n)
    preview = lambda c: c.wall_preview("w")
    for parts, verb, text in (
        ([reply(state)], preview, "0 came"),
        ([data(5), reply(state, preview=inline(5))], preview, "5 came"),
        ([data(6), reply(state, preview=inline(7))], preview, "6 came"),
        ([data(6), reply(preview=inline(6))], preview, "0 walls"),
        ([data(1 << 20)] * 3 + [data(1)], preview, "more DATA"),
        ([data(6)], lambda c: c.wall_list(), "may not come"),
        ([reply(state, preview=inline(6))], lambda c: c.wall_list(), "none was asked for"),
        ([reply(state, state)], lambda c: c.wall_open("wall: w"), "2 walls"),
        ([_wire.pack(Type.STATUS_REPLY, 1, pb.StatusReply())], lambda c: c.wall_list(), "may not come"),
        ([_wire.pack(Type.WALL_REPLY, 9, pb.WallReply())], lambda c: c.wall_list(), "may not come"),
    ):
        e = against(answers(*parts), verb)
        need(type(e) is airy.errors.PeerFault and text in str(e), f"\"{text}\" is not in: {e!r}")
    good = answers(data(4), data(2), reply(state, preview=inline(6)))
    equal(against(good, preview).data, bytes(6), "a good preview")
    # A drive that is not its wall's, and one that is.
    for size in (24, 23):
        picture = _wire.encode(Type.DATA, 2, size) + bytes(size)
        parts = [reply(state), picture, _wire.pack(Type.RESULT, 2, result(pb.Payload.INLINE, size=size))]
        got = against(answers(*parts), lambda c: c.bloom(RAW, via="memfd", output="inline", wall="w"))
        if size == 24:
            equal(got.shape.shape, (1, 2, 3), "the drive's shape")
        else:
            need(type(got) is airy.errors.PeerFault and "expected 24" in str(got), f"a drive of 23 bytes: {got!r}")


def resends() -> None:
    """A frame that ends its daemon is sent four times, and no more; one that is shown, once; and time is up when it is."""
    with tempfile.TemporaryDirectory(prefix="airy-peer-") as folder:
        path, asked = f"{folder}/s", [0]
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(path)
            listener.listen(8)

            def serve() -> None:
                while True:
                    try:
                        s, _ = listener.accept()
                    except OSError:
                        return
                    with s:
                        take(s)
                        send(s, WELCOME)
                        try:
                            take(s)
                            asked[0] += 1
                        except (OSError, struct.error):
                            pass

            thread = threading.Thread(target=serve, daemon=True)
            thread.start()

            def counts(verb: Callable[[Any], Any], want: int) -> None:
                asked[0] = 0
                with airy.Client(path, reconnect=60) as c:
                    e = raises(airy.ConnectionLost, lambda: verb(c))
                    equal((asked[0], e.retryable), (want, True), "times that it was sent")

                async def use() -> None:
                    async with airy.aio.Client(path, reconnect=60) as c:
                        await verb(c)

                asked[0] = 0
                raises(airy.ConnectionLost, lambda: asyncio.run(use()))
                equal(asked[0], want, "times that the asyncio client sent it")

            counts(lambda c: bloom(c), 1 + _engine.RESENDS)
            counts(lambda c: c.show(RAW, "w"), 1)
            counts(lambda c: c.wall_list(), 1 + _engine.RESENDS)
            counts(lambda c: c.wall_open("wall: w"), 1)
            with airy.Client(path, reconnect=0.2) as c:
                listener.shutdown(socket.SHUT_RDWR)
                listener.close()
                e = raises(airy.NoDaemon, lambda: bloom(c))
                need(e.retryable and path in str(e), f"says {e}")
            thread.join(10)


def greetings() -> None:
    def first(*parts: bytes, fds: Optional[Callable[[], list[int]]] = None) -> Script:
        def script(s: socket.socket) -> None:
            take(s)
            given = fds() if fds else []
            for part in parts:
                send(s, part, given)
            _transport.close_all(given)
            while s.recv(1 << 16):
                pass

        return script

    welcome = lambda **k: _wire.pack(Type.WELCOME, 0, pb.Welcome(**{"version": 1, "limits": LIMITS, **k}))
    for script, text in (
        (first(welcome(version=2)), "version 2"),
        (first(welcome(limits=None)), "states 0"),
        (first(welcome(), fds=lambda: [memfd(8)]), "descriptors came"),
        (first(_wire.pack(Type.CREDIT, 0, pb.Credit(bytes=1))), "before WELCOME"),
        (first(b"HTTP/1.1 400 Bad Request\r\n\r\n"), "0x59524941"),
    ):
        e = against(script, lambda c: c.status())
        need(isinstance(e, airy.errors.PeerFault) and text in str(e), f"\"{text}\" is not in: {e!r}")
    refuse = _wire.pack(Type.ERROR, 0, pb.Error(code=101, symbol="BAD_VERSION", text="speak 2", field="version_max"))
    e = against(first(refuse), lambda c: c.status())
    equal((type(e), e.field), (airy.errors.BadVersion, "version_max"), "the daemon's own reason")


def endings() -> None:
    data = _wire.encode(Type.DATA, 1, 4) + b"abcd"

    def hangs_up(part: bytes) -> Script:
        def script(s: socket.socket) -> None:
            take(s)
            send(s, WELCOME)
            take(s)
            send(s, part)

        return script

    for part in (b"A", _wire.pack(Type.RESULT, 1, result(pb.Payload.INLINE, size=4))[:28], data):
        e = against(hangs_up(part), lambda c: bloom(c, "inline"))
        equal(type(e), airy.ConnectionLost, f"the exception's class for {e}")
        need(e.retryable and "closed the connection" in str(e), f"says {e}")
    e = against(
        hangs_up(_wire.pack(Type.ERROR, 1, pb.Error(code=999, symbol="NEW", text="later", field="x", retryable=True))),
        lambda c: bloom(c, "inline"),
    )
    equal((type(e), e.code, e.symbol, e.retryable), (airy.DaemonError, 999, "NEW", True), "an unknown code")
    # What no client can cause from outside: a fault in the daemon, a lost device.
    for cls in (airy.errors.NoMemory, airy.errors.InternalError, airy.errors.DeviceLost):
        retryable = cls is not airy.errors.InternalError
        said = pb.Error(code=cls.code, symbol=cls.symbol, text="it is so", retryable=retryable)
        e = against(hangs_up(_wire.pack(Type.ERROR, 1, said)), lambda c: bloom(c, "inline"))
        equal((type(e), e.symbol, e.retryable), (cls, cls.symbol, retryable), f"code {cls.code}")
    whole = _wire.pack(Type.CREDIT, 0, pb.Credit(bytes=2**64 - 1)) + data
    whole += _wire.pack(Type.PROGRESS, 55, pb.Progress(stage="?")) + _wire.pack(Type.RESULT, 1, result(pb.Payload.INLINE, size=4))
    equal(against(hangs_up(whole), pixels), b"abcd", "what came before the end")


def pieces() -> None:
    """A good stream gives the same, however it is cut; descriptors with the right header's first byte."""
    rng = random.Random(SEED)
    data = _wire.encode(Type.DATA, 1, 4) + b"abcd"
    credit = _wire.pack(Type.CREDIT, 0, pb.Credit(bytes=3))
    last = _wire.pack(Type.RESULT, 1, result(pb.Payload.INLINE, size=4))
    stream = WELCOME + credit + data + credit + last
    for _ in range(300):
        engine = _engine.Engine()
        cuts = sorted(rng.sample(range(1, len(stream)), rng.randrange(0, 12)))
        request = None
        for begin, end in zip([0, *cuts], [*cuts, len(stream)]):
            if request is None and begin >= len(WELCOME):
                request = _submit(engine, pb.Output.INLINE)
            elif request is None and end > len(WELCOME):
                engine.incoming(memoryview(stream[begin : len(WELCOME)]), [])
                request = _submit(engine, pb.Output.INLINE)
                begin = len(WELCOME)
            engine.incoming(memoryview(stream[begin:end]), [])
        assert request is not None
        need(engine.lost is None and request.ended and request.error is None, f"cuts {cuts}: {engine.lost}")
        equal(bytes(request.value.data), b"abcd", "the output")


def _submit(engine: _engine.Engine, output: int) -> _engine.Request:
    from airy import payload

    body = pb.Bloom(output=pb.Output(kind=output))
    request = _engine.Request(Type.BLOOM, body, payload.Prepared(pb.Payload.INLINE, 6, memoryview(bytes(6))))
    engine.submit(request)
    return request


def noise() -> None:
    """Damaged streams: the engine ends in words or goes on; it raises nothing and keeps no descriptor."""
    rng = random.Random(SEED)
    seeds = [bytes.fromhex(json.loads(p.read_text())["hex"]) for p in sorted(VECTORS.glob("*.json"))]
    before = open_fds()
    lost = 0
    for _ in range(5000):
        engine = _engine.Engine()
        engine.incoming(memoryview(WELCOME), [])
        request = _submit(engine, rng.choice((pb.Output.INLINE, pb.Output.MEMFD)))
        for _ in range(rng.randrange(1, 6)):
            message = bytearray(rng.choice(seeds))
            for _ in range(rng.randrange(0, 4)):
                message[rng.randrange(len(message))] = rng.randrange(256)
            if rng.random() < 0.5:
                message[16:24] = (1).to_bytes(8, "little")
            fds = [memfd(64, rng.random() < 0.5)] if rng.random() < 0.3 else []
            engine.incoming(memoryview(bytes(message[: rng.randrange(1, len(message) + 1)])), fds, rng.random() < 0.02)
        lost += engine.lost is not None
        engine.lose(airy.ConnectionLost("over"))
        need(request.ended, "a request has no end")
        del request, engine
    gc.collect()
    equal(open_fds(), before, "descriptors")
    need(lost > 1000, f"{lost} of 5000 streams were refused")
    print(f"# AIRY_SEED={SEED}: {lost} of 5000 damaged streams refused")


def tests(tap: Tap, _: Path) -> None:
    before = open_fds()
    lies(tap)
    tap.run("answers about walls that are none", wall_lies)
    tap.run("how often and for how long something is sent again", resends)
    tap.run("greetings that are none", greetings)
    tap.run("streams that end too early, codes that are new", endings)
    tap.run("300 ways to cut a good stream", pieces)
    tap.run("5000 damaged streams", noise)

    def closed() -> None:
        gc.collect()
        equal(open_fds(), before, "descriptors")

    tap.run("no descriptor is left open", closed)


main("peer", tests)
