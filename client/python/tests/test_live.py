# SPDX-License-Identifier: Apache-2.0
"""The package against live daemons where the suite's data cannot go: pipelines, cancels, restarts, slow readers, threads,
asyncio, NumPy, descriptors. The seed of what is random is printed."""
from __future__ import annotations

import asyncio
import gc
import os
import random
import re
import resource
import signal
import socket
import stat
import threading
import time
from pathlib import Path
from typing import Any
from unittest import mock

import airy
from airy import _engine, _wire
from airy import airy_pb2 as pb
from airy._wire import Type
from kit import Daemon, Payloads, Skip, Tap, equal, main, need, open_fds, raises

PSF = "gaussians:sigma=2/8,weight=0.2/0.1"
WALL = """wall: sign
hold: forever
picture: {fit: stretch}
panels:
- {name: front, size: [8, 4]}
boards:
- {serial: NOT-THERE, panels: front}
"""
SEED = int(os.environ.get("AIRY_SEED", "0")) or random.SystemRandom().randrange(1, 2**31)


def numpy() -> Any:
    try:
        import numpy as np
    except ImportError:
        raise Skip("NumPy is not installed") from None
    return np


class Live:
    def __init__(self, daemon: Daemon, small: Daemon, payloads: Payloads, work: Path) -> None:
        self.daemon, self.small, self.payloads, self.work = daemon, small, payloads, work
        self.raw = airy.Raw(payloads["half_rgb"], 128, 72)
        self.random = random.Random(SEED)
        self.client = airy.Client(daemon.path)

    # ---- NumPy ---------------------------------------------------------------------------------

    def arrays(self) -> None:
        np = numpy()
        flat = self.client.bloom(self.raw, psf=PSF).tobytes()
        half = np.frombuffer(self.payloads["half_rgb"], "<f2").reshape(72, 128, 3)
        for output in ("inline", "memfd", "buffer"):
            for via in ("inline", "memfd"):
                r = self.client.bloom(half, psf=PSF, via=via, output=output)
                equal((r.array.shape, r.array.dtype), ((72, 128, 3), np.dtype("<f2")), "the array")
                need(r.array.tobytes() == flat, f"{via} to {output} gives other pixels than raw bytes")
                equal(r.array.flags.writeable, output == "buffer", f"writeable, {output}")

    def strides(self) -> None:
        np = numpy()
        big = np.zeros((144, 128, 4), np.float32)
        big[::2, :, 1:] = np.frombuffer(self.payloads["half_rgb"], "<f2").reshape(72, 128, 3)
        view = big[::2, :, 3:0:-1]  # neither contiguous nor in order
        want = self.client.bloom(np.ascontiguousarray(view), psf=PSF).array
        for a in (view, view.astype(">f4"), np.asfortranarray(view)):
            for via in ("inline", "memfd"):
                got = self.client.bloom(a, psf=PSF, via=via).array
                need(np.array_equal(got, want), f"strides {a.strides}, {a.dtype}, {via}: other pixels")

    def zero_copy(self) -> None:
        np = numpy()
        r = self.client.bloom(np.ones((64, 64, 3), np.float16), output="memfd")
        a = r.array
        need(not a.flags.owndata and np.shares_memory(a, r.array), "the array is a copy of the mapping")
        del r
        need(np.isfinite(a).all() and a.max() >= 1, "the array did not outlive its result")

    def bad_arrays(self) -> None:
        np = numpy()
        for a, field in (
            (np.zeros((4, 4, 3), np.float64), "dtype"),
            (np.zeros((4, 4, 3), np.uint8), "dtype"),
            (np.zeros(4, np.float32), "shape"),
            (np.zeros((0, 4, 3), np.float32), "shape"),
            (np.zeros((4, 4, 5), np.float32), "channels"),
        ):
            equal(raises(airy.InvalidRequest, lambda: self.client.bloom(a)).field, field, f"field of {a.dtype} {a.shape}")
        five = np.zeros((4, 4, 5), np.float32)
        five[..., 4] = 7
        out = self.client.bloom(five, channels=["R", "G", "B", "A", "id"]).array
        need((out[..., 4] == 7).all(), "a channel that is no colour changed")

    # ---- requests ------------------------------------------------------------------------------

    def pipeline(self) -> None:
        want = self.client.bloom(self.payloads.file("scene")).tobytes()
        pending = [self.client.submit(self.payloads.file("scene")) for _ in range(8)]
        for p in reversed(pending):
            need(p.result(60).tobytes() == want, "a frame of the pipeline has other bytes")

    def cancels(self) -> None:
        big = airy.Raw(self.payloads["half_4k"][: 1920 * 1080 * 6], 1920, 1080)
        ends = {"cancelled": 0, "done": 0}
        for i in range(24):
            via = self.random.choice(("inline", "memfd"))
            p = self.client.submit(big, via=via, output=self.random.choice(("inline", "memfd")))
            end = time.monotonic() + self.random.choice((0, 0.002, 0.02, 0.1, 0.3))
            while time.monotonic() < end and not p.done():
                try:
                    p.result(0.001)
                except TimeoutError:
                    pass
            p.cancel()
            p.cancel()
            try:
                p.result(60)
                ends["done"] += 1
            except airy.Cancelled as e:
                equal(e.symbol, "CANCELLED", "symbol")
                ends["cancelled"] += 1
        need(ends["cancelled"] > 0, f"no request was cancelled in time: {ends}")
        self.whole_credit()
        self.client.bloom(self.raw, timeout=60)
        print(f"# {ends}")

    def whole_credit(self) -> None:
        """A request's CREDIT may come after its end: STATUS's answer is waited for, and what comes before it is read."""
        engine = self.client._connection.engine
        end = time.monotonic() + 10
        while engine.credit < self.client.daemon.limits.credit_bytes and time.monotonic() < end:
            self.client.status(timeout=30)
        equal(engine.credit, self.client.daemon.limits.credit_bytes, "credit")

    def timeout(self) -> None:
        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        raises(TimeoutError, lambda: self.client.bloom(big, timeout=0.01))
        engine = self.client._connection.engine
        self.whole_credit()
        credit, engine.credit = engine.credit, 0  # as if others' frames had it all
        e = raises(TimeoutError, lambda: self.client.bloom(self.raw, timeout=0.05))
        need("no credit" in str(e), f"says {e}")
        engine.credit = credit
        p = self.client.submit(big)
        raises(TimeoutError, lambda: p.result(0.001))
        equal(len(p.result(60).tobytes()), 3840 * 2160 * 6, "the result after a time-out")

    def busy(self) -> None:
        """Two connections fill a daemon of 2 requests a connection; the client holds its third back by itself."""
        with airy.Client(self.small.path) as c:
            equal(c.daemon.limits.max_requests, 2, "max_requests")
            pending = [c.submit(self.raw) for _ in range(6)]
            for p in pending:
                p.result(60)
            # A client that counts wrong is told BUSY, tries again, and gets its frame.
            engine = c._connection.engine
            engine.welcome = _replace_limit(engine.welcome, max_requests=64)
            pending = [c.submit(self.raw, via="inline") for _ in range(12)]
            for p in pending:
                p.result(60)
            tries = [p._request.tries for p in pending]
            need(max(tries) > 1, f"nothing was BUSY: {tries}")
            # And when it stays busy, that is the error.
            with mock.patch.object(_engine, "BUSY_TRIES", 1):
                pending = [c.submit(self.raw, via="inline") for _ in range(12)]
                failed = [e for e in (p.exception(60) for p in pending) if e is not None]
            need(failed, "no request was refused")
            for e in failed:
                equal(type(e), airy.errors.Busy, "the exception")
                need(e.retryable and e.retry_after_ms > 0 and e.queue_position > 0, f"BUSY says {vars(e)}")

    def no_memfd(self) -> None:
        want = self.client.bloom(self.raw, psf=PSF).tobytes()
        with mock.patch("airy.payload.HAS_MEMFD", False):
            p = self.client.submit(self.raw, psf=PSF)
            equal(p._request.prepared.kind, pb.Payload.INLINE, "the payload's kind")
            equal(p._request.body.output.kind, pb.Output.INLINE, "the output's kind")
            need(p.result(60).tobytes() == want, "inline gives other pixels")
            e = raises(airy.InvalidRequest, lambda: self.client.bloom(self.raw, via="memfd"))
            equal(e.field, "via", "field")

    def progress(self) -> None:
        def stop(stage: str, fraction: float) -> None:
            raise KeyError(stage)

        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        raises(KeyError, lambda: self.client.bloom(big, progress=stop))
        self.client.bloom(self.raw)

    def threads(self) -> None:
        want = self.client.bloom(self.raw, psf=PSF).tobytes()
        wrong: list[Any] = []

        def work() -> None:
            try:
                for _ in range(5):
                    if self.client.bloom(self.raw, psf=PSF, timeout=60).tobytes() != want:
                        wrong.append("other bytes")
            except Exception as e:
                wrong.append(e)

        threads = [threading.Thread(target=work) for _ in range(4)]
        for t in threads:
            t.start()
        for t in threads:
            t.join()
        equal(wrong, [], "what went wrong")

    def invalid(self) -> None:
        for call, field in (
            (lambda: self.client.bloom(self.work / "no.exr"), "input"),
            (lambda: self.client.bloom(self.work), "input"),
            (lambda: self.client.bloom(b""), "input"),
            (lambda: self.client.bloom(7), "input"),
            (lambda: self.client.bloom(self.raw, threshold=None), "params.threshold"),
            (lambda: self.client.bloom(self.raw, psf="a\0b"), "psf"),
            (lambda: self.client.bloom(self.raw, layer="x"), "layer"),
            (lambda: self.client.bloom(self.raw, via="post"), "via"),
            (lambda: self.client.bloom(self.raw, via="file"), "via"),
            (lambda: self.client.bloom(self.raw, output="post"), "output"),
            (lambda: self.client.bloom(airy.Raw(b"12", -1, 1)), "raw"),
            (lambda: self.client.bloom(self.raw, **{f"p{i}": i for i in range(65)}), "params"),
            (lambda: self.client.asset(self.raw), "input"),
            (lambda: self.client.plan(self.raw).array, "array"),
            (lambda: self.client.plan(self.raw).tobytes(), "data"),
        ):
            equal(raises(airy.InvalidRequest, call).field, field, "field")
        equal(self.client.wall_list().walls, (), "walls that are open")
        long = raises(airy.InvalidRequest, lambda: self.client.bloom(self.raw, psf="x" * 70000))
        need("65536" in str(long), f"says {long}")

    def save(self) -> None:
        out = self.work / "saved.exr"
        r = self.client.bloom(self.payloads.file("scene"))
        r.save(out)
        equal(out.read_bytes(), r.tobytes(), "the file")
        umask = os.umask(0)
        os.umask(umask)
        equal(stat.S_IMODE(out.stat().st_mode), 0o666 & ~umask, "its mode")
        (self.work / "folder").mkdir(exist_ok=True)
        raises(OSError, lambda: r.save(self.work / "folder"))
        equal([p for p in os.listdir(self.work) if ".airy-" in p], [], "files left behind")

    # ---- connections ---------------------------------------------------------------------------

    def find(self) -> None:
        e = raises(airy.NoDaemon, lambda: airy.Client(self.work / "nobody.sock"))
        need("airyd --socket" in str(e) and "nobody.sock" in str(e) and e.retryable, f"says {e}")
        env = {"AIRY_SOCKET": str(self.work / "nobody.sock"), "XDG_RUNTIME_DIR": str(self.work / "run")}
        (self.work / "run").mkdir(exist_ok=True)
        with mock.patch.dict(os.environ, env):
            os.symlink(self.daemon.path, self.work / "run" / "airyd.sock")
            with airy.Client() as c:  # the first that answers
                c.status()
        with mock.patch.dict(os.environ, {**env, "AIRY_SOCKET": self.daemon.path}):
            with airy.Client() as c:
                c.status()

    def restart(self) -> None:
        own = Daemon(self.work, "restart", "--warm", "common").wait_ready()
        try:
            with airy.Client(own.path, reconnect=0) as c:
                want = c.bloom(self.raw, psf=PSF).tobytes()
                for how in (signal.SIGKILL, signal.SIGTERM):
                    big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
                    pending = c.submit(big) if how == signal.SIGKILL else None
                    own.kill(how)
                    if pending is not None:
                        need(raises(airy.ConnectionLost, lambda: pending.result(30)).retryable, "not retryable")
                    e = raises(airy.NoDaemon, lambda: c.bloom(self.raw))
                    need("restart.sock" in str(e), f"says {e}")
                    own.start()
                    own.wait_ready()
                    need(c.bloom(self.raw, psf=PSF, timeout=60).tobytes() == want, "other bytes after the restart")
        finally:
            own.stop()

    def frames(self, c: airy.Client) -> list[Any]:
        """Pendings of every way in and out."""
        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        file = airy.Raw(self.payloads.file("half_4k"), 3840, 2160)
        ways = [(big, "memfd", "memfd"), (big, "inline", "buffer"), (file, "file", "memfd"), (big, "memfd", "buffer")]
        return [c.submit(f, via=v, output=o, psf=PSF) for f, v, o in ways]

    def again(self) -> None:
        """A daemon that is killed in the midst of frames, or stopped, and another that is started: nobody hears of it."""
        own = Daemon(self.work, "again", "--warm", "common").wait_ready()
        try:
            with airy.Client(own.path, reconnect=120) as c:
                self.no_memory(own, c)
                want = c.bloom(airy.Raw(self.payloads["half_4k"], 3840, 2160), psf=PSF).tobytes()
                for how in (signal.SIGKILL, signal.SIGTERM):
                    seen: list[str] = []
                    big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
                    first = c.submit(big, psf=PSF, progress=lambda stage, _: seen.append(stage))
                    while not seen and not first.done():
                        c.status(30)
                    if how == signal.SIGKILL:
                        own.process.send_signal(signal.SIGSTOP)  # so that none ends before the kill
                    pending = [first, *self.frames(c)]
                    # A daemon that stops waits for who is to read: this thread reads.
                    successor = threading.Thread(target=lambda: (own.kill(how), own.start()))
                    successor.start()
                    for p in pending:
                        need(p.result(120).tobytes() == want, f"other bytes after signal {how}")
                    successor.join()
                    if how == signal.SIGKILL:
                        need(all(p._request.resent == 1 for p in pending[1:]), "nothing was sent again")
                    c.status(60)
                self.shown_once(own, c)
        finally:
            own.stop()

    def no_memory(self, own: Daemon, c: airy.Client) -> None:
        """The daemon has no address space left for the payload; then it has, and the same request is served."""
        pid = own.process.pid
        c.status(30)
        size = int(re.search(r"VmSize:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1]) * 1024  # type: ignore[index]
        old = resource.prlimit(pid, resource.RLIMIT_AS)
        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        resource.prlimit(pid, resource.RLIMIT_AS, (size + (8 << 20), old[1]))
        try:
            e = raises(airy.errors.NoMemory, lambda: c.bloom(big, via="inline"))
        finally:
            resource.prlimit(pid, resource.RLIMIT_AS, old)
        need(e.retryable and e.field == "input.size", f"says {e!r}")
        c.bloom(big, via="inline", timeout=120)

    def shown_once(self, own: Daemon, c: airy.Client) -> None:
        """A frame that was to be shown, and a wall, go with their daemon."""
        c.wall_open(WALL)
        c.show(self.raw, "sign")
        own.process.send_signal(signal.SIGSTOP)
        shown = c.submit(self.raw, wall="sign", output="wall")
        drive = c.submit(self.raw, wall="sign")
        own.kill()
        own.start()
        need(shown.exception(120).retryable, "not retryable")
        equal(type(shown.exception()), airy.ConnectionLost, "the shown frame's end")
        equal(type(drive.exception(120)), airy.errors.NoWall, "the drive's end")
        c.wall_open(WALL, timeout=60)

    def turns(self) -> None:
        """Who has waited too long is told so; who is more urgent has the next turn."""
        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        pending = [self.client.submit(big, priority=-5) for _ in range(5)]
        late = self.client.submit(self.raw, deadline_ms=1, priority=-10)
        urgent = self.client.submit(self.raw, priority=10)
        urgent.result(120)
        need(not pending[-1].done(), "a frame of priority 10 came after all of -5")
        e = late.exception(120)
        equal(type(e), airy.errors.DeadlineExceeded, "the late one's end")
        for p in pending:
            p.result(120)

    def wall(self) -> None:
        np = numpy()
        with airy.Client(self.daemon.path) as c:
            path = self.work / "sign.yaml"
            path.write_text(WALL)
            state = c.wall_open(path)
            half = np.frombuffer(self.payloads["half_rgb"], "<f2").reshape(72, 128, 3)
            for output in ("inline", "memfd"):
                r = c.bloom(half, wall="sign", output=output, bloom=False)
                equal((r.array.shape, r.array.dtype), ((state.height, state.width, 3), np.dtype("<f4")), "the drive")
                mean = half.astype(np.float32).reshape(4, 18, 8, 16, 3).mean((1, 3))
                need(np.allclose(r.array, mean, rtol=2e-3), f"the drive is off by {np.abs(r.array - mean).max()}")
            whole, r = c.bloom(half, wall="sign", psf=PSF), c.plan(half, wall="sign")
            equal((r.data, r.need.width, r.need.height), (None, 128, 72), "the plan's need")
            part = c.bloom(half, wall="sign", psf=PSF, part_of=airy.Part(128, 72, 0, 0))
            need(np.array_equal(whole.array, part.array), "a part that is the whole gives another drive")
            c.show(half, "sign", bloom=False, present_ns=time.monotonic_ns())
            end = time.monotonic() + 30
            while c.wall_preview("sign").array.max() == 0 and time.monotonic() < end:
                time.sleep(0.02)
            need(c.wall_preview("sign").array.shape == (4, 8, 3) and c.wall_preview("sign").array.max() > 0, "nothing is on the wall")
            for call, field in (
                (lambda: c.bloom(half, output="wall"), "output"),
                (lambda: c.bloom(half, present_ns=1), "present_ns"),
                (lambda: c.bloom(half, wall=""), "wall"),
                (lambda: c.bloom(half, wall="sign", present_ns=-1), "present_ns"),
                (lambda: c.bloom(half, priority="high"), "priority"),
                (lambda: c.wall_open(self.work / "none.yaml"), "definition"),
                (lambda: c.wall_open("#" * 70000), "definition"),
                (lambda: c.wall_open(b"wall: x"), "definition"),  # type: ignore[arg-type]
            ):
                equal(raises(airy.InvalidRequest, call).field, field, "field")

    async def aio_wall(self) -> None:
        async with airy.aio.Client(self.daemon.path) as c:
            equal((await c.wall_open(WALL)).leds, 32, "LEDs")
            equal(len((await c.bloom(self.raw, wall="sign")).tobytes()), 8 * 4 * 12, "the drive's bytes")
            await c.show(self.raw, "sign")
            equal((await c.plan(self.raw, wall="sign")).need.width, 128, "the plan's need")
            equal([w.name for w in (await c.wall_list("sign")).walls], ["sign"], "walls")
            await c.wall_pattern("sign", "red")
            equal(len((await c.wall_preview("sign")).data), 8 * 4 * 3, "the preview's bytes")
            await c.wall_close("sign")
            try:
                await c.bloom(self.raw, wall="sign")
                raise AssertionError("NO_WALL expected")
            except airy.errors.NoWall:
                pass

    async def aio_again(self) -> None:
        own = await asyncio.to_thread(lambda: Daemon(self.work, "aio-again", "--warm", "common").wait_ready())
        try:
            async with airy.aio.Client(own.path, reconnect=120) as c:
                want = (await c.bloom(self.raw, psf=PSF)).tobytes()
                own.process.send_signal(signal.SIGSTOP)
                frames = [asyncio.create_task(c.bloom(self.raw, psf=PSF, via=v)) for v in ("inline", "memfd")]
                status = asyncio.create_task(c.status(120))
                await asyncio.sleep(0.1)
                await asyncio.to_thread(own.kill)
                await asyncio.sleep(0.1)
                later = asyncio.create_task(c.bloom(self.raw, psf=PSF))
                own.start()
                for r in await asyncio.gather(*frames, later):
                    need(r.tobytes() == want, "other bytes after the restart")
                await status
        finally:
            await asyncio.to_thread(own.stop)

    def draining(self) -> None:
        """A daemon that stops says so to an upload that is half done."""
        own = Daemon(self.work, "drain", "--warm", "common").wait_ready()
        try:
            with socket.socket(socket.AF_UNIX) as s:
                s.connect(own.path)
                s.settimeout(30)
                s.sendall(_wire.pack(Type.HELLO, 0, pb.Hello(version_min=1, version_max=1)))
                body = pb.Bloom(input=pb.Payload(kind=pb.Payload.INLINE, size=100))
                s.sendall(_wire.pack(Type.BLOOM, 1, body) + _wire.pack(Type.STATUS, 2))
                came = b""
                while Type.STATUS_REPLY not in _types(came):
                    more = s.recv(1 << 16)
                    need(more, "the daemon closed")
                    came += more
                own.process.send_signal(signal.SIGTERM)
                data = b""
                while more := s.recv(1 << 16):
                    data += more
                need(b"SHUTTING_DOWN" in data, "no SHUTTING_DOWN came")
        finally:
            own.stop()

    def slow_reader(self) -> None:
        """A client that asks for much and reads nothing is dropped; nobody else waits for it."""
        with socket.socket(socket.AF_UNIX) as s, airy.Client(self.small.path) as other:
            s.settimeout(30)
            s.connect(self.small.path)
            s.sendall(_wire.pack(Type.HELLO, 0, pb.Hello(version_min=1, version_max=1)))
            status = _wire.pack(Type.STATUS, 1)
            closed = False
            end = time.monotonic() + 20
            while not closed and time.monotonic() < end:
                s.settimeout(0.05)
                try:
                    s.sendall(status * 200)
                except TimeoutError:
                    other.bloom(self.raw, timeout=30)
                except (BrokenPipeError, ConnectionResetError):
                    closed = True
            need(closed, "the daemon still serves who does not read")
            other.bloom(self.raw, timeout=30)

    def freed(self) -> None:
        """A frame's mapping goes with its last name, not when garbage happens to be collected."""
        gc.collect()
        gc.disable()
        try:
            before = open_fds()
            for output in ("inline", "memfd", "buffer"):
                self.client.bloom(self.raw, output=output)
                raises(airy.errors.ParamUnknown, lambda: self.client.bloom(self.raw, output=output, thresold=1))
                pending = [self.client.submit(self.raw, output=output) for _ in range(4)]
                pending[0].cancel()
                for p in pending:
                    p.exception(60)
                del p, pending
            equal(open_fds(), before, "descriptors")
        finally:
            gc.enable()

    def all_closed(self, before: list[str]) -> None:
        gc.collect()  # tracebacks of the errors that were asked for
        equal(open_fds(), before, "descriptors")

    # ---- asyncio -------------------------------------------------------------------------------

    async def aio(self) -> None:
        want = self.client.bloom(self.payloads.file("scene")).tobytes()
        async with airy.aio.Client(self.daemon.path) as c:
            seen: list[str] = []
            frames = [c.bloom(self.payloads.file("scene"), via=v, output=o) for v in ("inline", "memfd", "file") for o in ("inline", "memfd")]
            for r in await asyncio.gather(*frames):
                need(r.tobytes() == want, "other bytes than the blocking client's")
            # Progress is told when there is time for it: of a frame that takes some.
            big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
            await c.bloom(big, progress=lambda stage, _: seen.append(stage))
            need(seen, "no progress came")
            need((await c.plan(self.raw)).bound > 0, "the plan has no bound")
            equal((await c.asset(self.payloads["tiny"])).width, 2, "the asset's width")
            need((await c.status()).done > 0, "nothing is done")
            try:
                await c.bloom(self.raw, thresold=1)
                raise AssertionError("PARAM_UNKNOWN expected")
            except airy.errors.ParamUnknown as e:
                equal(e.field, "params.thresold", "field")
        try:
            await c.status()
            raise AssertionError("a closed client answers")
        except airy.ConnectionLost:
            pass

    async def aio_cancel(self) -> None:
        big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
        async with airy.aio.Client(self.daemon.path) as c:
            for via in ("inline", "memfd"):
                task = asyncio.create_task(c.bloom(big, via=via))
                await asyncio.sleep(self.random.random() * 0.1)
                task.cancel()
                await asyncio.wait([task])
                need(task.cancelled(), f"the task ended as {task}")
            pending = await c.submit(big)
            pending.cancel()
            try:
                await pending
            except airy.Cancelled:
                pass
            await c.status()
            full = c.daemon.limits.credit_bytes
            for _ in range(200):  # the cancelled tasks' ends come when the daemon sees them
                if c._connection.engine.credit == full:
                    break
                await asyncio.sleep(0.05)
            equal(c._connection.engine.credit, full, "credit after the cancels")

    async def aio_restart(self) -> None:
        own = await asyncio.to_thread(lambda: Daemon(self.work, "aio", "--warm", "common").wait_ready())
        try:
            async with airy.aio.Client(own.path, reconnect=0) as c:
                big = airy.Raw(self.payloads["half_4k"], 3840, 2160)
                pending = await c.submit(big)
                await asyncio.to_thread(own.kill)
                try:
                    await pending
                    raise AssertionError("ConnectionLost expected")
                except airy.ConnectionLost:
                    pass
                own.start()
                await asyncio.to_thread(own.wait_ready)
                await c.bloom(self.raw)
        finally:
            await asyncio.to_thread(own.stop)


def _replace_limit(welcome: Any, **limits: int) -> Any:
    import dataclasses

    return dataclasses.replace(welcome, limits=dataclasses.replace(welcome.limits, **limits))


def _types(data: bytes) -> list[int]:
    found = []
    while len(data) >= _wire.HEADER_BYTES:
        header = _wire.decode(data[: _wire.HEADER_BYTES], "daemon")
        found.append(header.type)
        data = data[_wire.HEADER_BYTES + header.body_bytes :]
    return found


def tests(tap: Tap, work: Path) -> None:
    print(f"# AIRY_SEED={SEED}")
    payloads = Payloads(work)
    daemon = Daemon(work, "live", "--warm", "common")
    small = Daemon(work, "small", "--warm", "common", "--max-requests", "2", "--timeout-s", "1")
    try:
        live = Live(daemon.wait_ready(), small.wait_ready(), payloads, work)
        live.client.bloom(live.raw)  # what is made once is made
        before = open_fds()
        tap.run("arrays in and out, by every way", live.arrays)
        tap.run("arrays with strides and of big-endian numbers", live.strides)
        tap.run("an array that looks into the daemon's memory", live.zero_copy)
        tap.run("arrays that cannot be sent, and channels with names", live.bad_arrays)
        tap.run("a pipeline of 8, waited for backwards", live.pipeline)
        tap.run("24 cancels at random moments", live.cancels)
        tap.run("time-outs", live.timeout)
        tap.run("requests held back, BUSY tried again, BUSY given up", live.busy)
        tap.run("without memfd", live.no_memfd)
        tap.run("a progress callback that raises", live.progress)
        tap.run("four threads on one client", live.threads)
        tap.run("requests that are none", live.invalid)
        tap.run("save: whole or not at all", live.save)
        tap.run("mappings go with their frames", live.freed)
        tap.run("who listens, and words when nobody does", live.find)
        tap.run("a slow reader costs only itself", live.slow_reader)
        tap.run("a daemon that stops says so to a half upload", live.draining)
        tap.run("kill and stop of the daemon, and its restart", live.restart)
        tap.run("a wall: drives as arrays, frames shown", live.wall)
        tap.run("turns and deadlines", live.turns)
        tap.run("no memory; a daemon killed or stopped amid frames, and another", live.again)
        tap.run("asyncio: walls", lambda: asyncio.run(live.aio_wall()))
        tap.run("asyncio: a daemon killed amid frames, and another", lambda: asyncio.run(live.aio_again()))
        tap.run("asyncio: every verb", lambda: asyncio.run(live.aio()))
        tap.run("asyncio: cancelled tasks", lambda: asyncio.run(live.aio_cancel()))
        tap.run("asyncio: a restart", lambda: asyncio.run(live.aio_restart()))
        tap.run("no descriptor is left open", lambda: live.all_closed(before))
        live.client.close()
    finally:
        daemon.stop()
        small.stop()


main("live", tests)
