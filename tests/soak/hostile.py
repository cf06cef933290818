# SPDX-License-Identifier: Apache-2.0
"""hostile.py SPEC SEED SECONDS - sessions that do what no client should: garbage, half uploads, files that shrink, replies that nobody
reads. Each is a function of the table FAULTS; it raises Wrong when the daemon's answer is not one that PROTOCOL.md allows. One JSON line
each: {"fault", "ended"} or {"fault", "wrong"}; frames that end well say {"case", "sha"} besides.
"""
from __future__ import annotations

import array
import fcntl
import json
import os
import random
import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Iterator, NamedTuple

from airy import _wire, airy_pb2 as pb
from airy._wire import Type
from cases import Case, digest_of

ANSWER_S = 120  # for whatever the daemon must say; only a stuck daemon takes so long
CREDIT_BYTES = 64 << 20  # inputs of these sessions are smaller
TERMINAL = (Type.RESULT, Type.ERROR, Type.CANCELLED)


class Wrong(Exception):
    """The daemon did what it must not."""


class Ended(NamedTuple):
    type: Type
    body: Any
    data: bytes

    @property
    def said(self) -> str:
        return self.body.symbol if self.type == Type.ERROR else self.type.name


def say(**line: Any) -> None:
    print(json.dumps(line), flush=True)


class Peer:
    """A socket that speaks the protocol, right or wrong."""

    def __init__(self, path: str, hello: bool = True) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(ANSWER_S)
        self.socket.connect(path)
        self.buffer = b""
        self.fds: list[int] = []
        if hello:
            self.send(Type.HELLO, 0, pb.Hello(version_min=1, version_max=1, client="soak"))
            self.expect(Type.WELCOME)

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        for fd in self.fds:
            os.close(fd)
        self.fds = []
        self.socket.close()

    def send(self, type: Type, id: int, body: Any = None, fds: tuple[int, ...] = ()) -> None:
        self.bytes(_wire.pack(type, id, body, len(fds)), fds)

    def bytes(self, data: bytes, fds: tuple[int, ...] = ()) -> None:
        ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
        n = self.socket.sendmsg([data], ancillary)
        self.socket.sendall(data[n:])

    def data(self, id: int, data: bytes) -> None:
        for at in range(0, len(data), _wire.DATA_BYTES_MAX):
            piece = data[at : at + _wire.DATA_BYTES_MAX]
            self.bytes(_wire.encode(Type.DATA, id, len(piece)) + piece)

    def read(self, n: int, sip: int = 1 << 18) -> bytes:
        """Exactly n bytes, or fewer at the end of the stream."""
        while len(self.buffer) < n:
            try:
                got, ancillary, _, _ = self.socket.recvmsg(sip, socket.CMSG_SPACE(16), socket.MSG_CMSG_CLOEXEC)
            except ConnectionResetError:
                break
            except TimeoutError:
                raise Wrong(f"no answer in {ANSWER_S} s") from None
            for _, _, fds in ancillary:
                numbers = array.array("i")
                numbers.frombytes(fds)
                self.fds += numbers
            if not got:
                break
            self.buffer += got
        data, self.buffer = self.buffer[:n], self.buffer[n:]
        return data

    def next(self, sip: int = 1 << 18) -> tuple[_wire.Header, Any] | None:
        """The next message, its body parsed; None when the daemon has closed."""
        head = self.read(_wire.HEADER_BYTES, sip)
        if not head:
            return None
        if len(head) < _wire.HEADER_BYTES:
            raise Wrong(f"the stream ends within a header of {len(head)} bytes")
        header = _wire.decode(head, "daemon")
        body = self.read(header.body_bytes, sip)
        if len(body) < header.body_bytes:
            raise Wrong(f"{header.type.name} of {header.body_bytes} bytes ends after {len(body)}")
        return header, body if header.type == Type.DATA else _wire.parse(header.type, body)

    def expect(self, type: Type) -> Any:
        while (message := self.next()) is not None:
            if message[0].type == type:
                return message[1]
            if message[0].type == Type.ERROR:
                raise Wrong(f"{message[1].symbol} ({message[1].text}) instead of {type.name}")
        raise Wrong(f"the end instead of {type.name}")

    def ends(self, ids: set[int], sip: int = 1 << 18, pause_s: float = 0) -> dict[int, Ended]:
        """The terminal reply of each, and, by a STATUS behind them, that each has one only."""
        data = {id: bytearray() for id in ids}
        ended: dict[int, Ended] = {}
        asked = False
        while (message := self.next(sip)) is not None:
            header, body = message
            if header.id in ended and header.type not in (Type.CREDIT, Type.STATUS_REPLY):
                raise Wrong(f"{header.type.name} for id {header.id} after its end in {ended[header.id].said}")
            if header.type == Type.DATA:
                data[header.id] += body
            elif header.type in TERMINAL and header.id in ids:
                ended[header.id] = Ended(header.type, body, bytes(data[header.id]))
            elif header.type == Type.ERROR:
                raise Wrong(f"{body.symbol} ({body.text}) for id {header.id}")
            elif header.type == Type.STATUS_REPLY:
                return ended
            if len(ended) == len(ids) and not asked:
                self.send(Type.STATUS, 999)
                asked = True
            time.sleep(pause_s)
        raise Wrong(f"the connection closed; {sorted(ids - ended.keys())} have no end")

    def closes(self) -> str:
        """What it says last."""
        last = ""
        while (message := self.next()) is not None:
            last = message[1].symbol if message[0].type == Type.ERROR else last
        return last


class Session:
    """What the faults work with: cases of which the bytes are at hand, a random generator, a folder."""

    def __init__(self, spec: dict[str, Any], rng: random.Random, folder: Path) -> None:
        self.path: str = spec["socket"]
        self.rng, self.folder = rng, folder
        self.cases: list[Case] = [c for c in spec["cases"] if not c["dirt"] and os.path.getsize(c["input"]) < CREDIT_BYTES]
        self.files = [c for c in self.cases if not c["raw"]]
        self.small = [c for c in self.cases if c["pixels"] < 2**20]

    def case(self, files: bool = False) -> tuple[Case, bytes]:
        case = self.rng.choice(self.files if files else self.cases)
        return case, Path(case["input"]).read_bytes()

    def bloom(self, case: Case, kind: int, size: int, output: int = pb.Output.INLINE, **more: Any) -> Any:
        m = pb.Bloom(input=pb.Payload(kind=kind, size=size), output=pb.Output(kind=output), **more)
        for name, value in case["params"].items():
            p = m.params.add(name="view" if name == "show" else name)
            if isinstance(value, str):
                p.text = value
            else:
                p.number = value
        if case["raw"]:
            raw = case["raw"]
            size, m.raw.type = (2, pb.PIXEL_HALF) if raw["type"] == "half" else (4, pb.PIXEL_FLOAT)
            m.raw.width, m.raw.height = raw["width"], raw["height"]
            step = size * len(raw["channels"])
            for i, c in enumerate(raw["channels"]):
                m.raw.channels.add(name=c, offset=i * size, row_stride=step * raw["width"], pixel_stride=step)
        else:
            m.exr.CopyFrom(pb.ExrOptions(**case["exr"]))
        return m

    def file(self, data: bytes) -> int:
        fd, name = tempfile.mkstemp(dir=self.folder)
        os.unlink(name)
        os.write(fd, data) if len(data) < 1 << 20 else os.pwrite(fd, data, 0)
        return fd

    def right(self, case: Case, ended: Ended, *others: str) -> str:
        """It ended in the frame, or in one of these errors."""
        if ended.type == Type.RESULT:
            say(case=case["id"], sha=digest_of(ended.data))
        elif ended.said not in others:
            raise Wrong(f"{ended.said} ({getattr(ended.body, 'text', '')}) for case {case['id']}; expected RESULT {' '.join(others)}")
        return ended.said


def memfd(data: bytes, seals: int) -> int:
    fd = os.memfd_create("soak", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.truncate(fd, len(data))
    os.pwrite(fd, data, 0)
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)
    return fd


BUSY = ("BUSY", "NO_MEMORY")


def garbage(s: Session) -> str:
    with Peer(s.path, hello=s.rng.random() < 0.5) as p:
        p.bytes(bytes([s.rng.randrange(256) ^ 0x41 or 1]) + s.rng.randbytes(s.rng.randint(24, 4000)))
        last = p.closes()
    if not last:
        raise Wrong("the connection closed without an ERROR")
    return last


def mutated(s: Session) -> str:
    """A few bytes of a right conversation are others; then this side ends, and so must the daemon's."""
    case, data = s.case()
    body = bytearray(_wire.pack(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data))))
    for _ in range(s.rng.randint(1, 4)):
        body[s.rng.randrange(len(body))] = s.rng.randrange(256)
    with Peer(s.path) as p:
        try:
            p.bytes(bytes(body))
            p.data(1, data)
            p.socket.shutdown(socket.SHUT_WR)
        except (BrokenPipeError, ConnectionResetError):
            pass
        return p.closes() or "closed"


def half_upload(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data)))
        p.data(1, data[: s.rng.randrange(len(data))])
        time.sleep(s.rng.random() * 0.2)
    return "left"


def stalled_upload(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data)))
        p.data(1, data[: len(data) // 2])
        ended = p.ends({1})[1]
    if ended.type != Type.ERROR:
        raise Wrong(f"{ended.said} for half an upload")
    return ended.said


def slow_reader(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data), progress=True))
        p.data(1, data)
        time.sleep(s.rng.random() * 0.3)
        # Sips of a size that ends in the time at hand.
        sip = max(512, case["pixels"] // 20)
        return s.right(case, p.ends({1}, sip, 0.005)[1], *BUSY)


def leaves_with_result(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data)))
        p.data(1, data)
        p.read(s.rng.randint(1, 200))
    return "left"


def cancel(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.INLINE, len(data)))
        if s.rng.random() < 0.8:
            p.data(1, data)
        else:
            p.data(1, data[: len(data) // 2])
        time.sleep(s.rng.random() * 0.05)
        p.send(Type.CANCEL, 1)
        p.send(Type.CANCEL, 1)
        return s.right(case, p.ends({1})[1], "CANCELLED", *BUSY)


def deadline(s: Session) -> str:
    case, data = s.case()
    if case["pixels"] > 2**20:
        return "left out"
    fd = memfd(data, fcntl.F_SEAL_SHRINK)
    with Peer(s.path) as p:
        p.fds.append(fd)
        for id in range(1, 9):
            p.send(Type.BLOOM, id, s.bloom(case, pb.Payload.MEMFD, len(data), deadline_ms=s.rng.randint(1, 60), priority=s.rng.randint(-10, 10)), (fd,))
        ended = p.ends(set(range(1, 9)))
    said = [s.right(case, e, "DEADLINE", *BUSY) for e in ended.values()]
    return "DEADLINE" if "DEADLINE" in said else "in time"


def truncated_exr(s: Session) -> str:
    case, whole = s.case(files=True)
    data = whole[: s.rng.randint(1, len(whole) - 1)]
    with Peer(s.path) as p:
        way = s.rng.choice([pb.Payload.INLINE, pb.Payload.MEMFD, pb.Payload.FILE])
        if way == pb.Payload.INLINE:
            p.send(Type.BLOOM, 1, s.bloom(case, way, len(data)))
            p.data(1, data)
        else:
            p.fds.append(memfd(data, fcntl.F_SEAL_SHRINK) if way == pb.Payload.MEMFD else s.file(data))
            p.send(Type.BLOOM, 1, s.bloom(case, way, len(data)), (p.fds[0],))
        ended = p.ends({1})[1]
    if ended.said not in ("NOT_EXR", "EXR_DAMAGED", "EXR_UNSUPPORTED", *BUSY):
        raise Wrong(f"{ended.said} for {len(data)} of {len(whole)} bytes of {case['input']}")
    return ended.said


def shrinking_file(s: Session) -> str:
    """The file is cut while the daemon reads it: it has read all before, or says so."""
    case, data = s.case()
    with Peer(s.path) as p:
        p.fds.append(s.file(data))
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.FILE, len(data)), (p.fds[0],))
        time.sleep(s.rng.random() * 0.02)
        os.truncate(p.fds[0], s.rng.randrange(len(data)))
        return s.right(case, p.ends({1})[1], "PAYLOAD", "NOT_EXR", "EXR_DAMAGED", *BUSY)


def scribbled_memfd(s: Session) -> str:
    """Its bytes change meanwhile: what comes of it is undefined, but something must, and nothing else is harmed."""
    case, data = s.case()
    with Peer(s.path) as p:
        p.fds.append(memfd(data, fcntl.F_SEAL_SHRINK))
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.MEMFD, len(data)), (p.fds[0],))
        for _ in range(s.rng.randint(1, 30)):
            os.pwrite(p.fds[0], s.rng.randbytes(min(64, len(data))), s.rng.randrange(max(1, len(data) - 64)))
        return p.ends({1})[1].said


def unsealed_memfd(s: Session) -> str:
    case, data = s.case()
    with Peer(s.path) as p:
        p.fds.append(memfd(data, 0))
        p.send(Type.BLOOM, 1, s.bloom(case, pb.Payload.MEMFD, len(data)), (p.fds[0],))
        said = p.ends({1})[1].said
    if said not in ("PAYLOAD_SEALS", "BUSY"):
        raise Wrong(f"{said} for a memfd without seals")
    return said


def wrong_descriptors(s: Session) -> str:
    case, data = s.case()
    message = bytearray(_wire.pack(Type.BLOOM, 1, s.bloom(case, pb.Payload.MEMFD, len(data))))
    message[6] = s.rng.choice([0, 1, 2, 200])
    given = s.rng.choice([n for n in (0, 1, 2, 9) if n != message[6]])
    with Peer(s.path) as p:
        p.fds += [memfd(b"x", fcntl.F_SEAL_SHRINK) for _ in range(given)]
        p.bytes(bytes(message), tuple(p.fds))
        last = p.closes()
    if last != "BAD_FDS":
        raise Wrong(f'"{last}" for {given} descriptors where the header says {message[6]}')
    return last


def wrong_params(s: Session) -> str:
    case, data = s.case()
    m = s.bloom(case, pb.Payload.INLINE, len(data))
    name, value = s.rng.choice([("threshold", "1e40"), ("psf", "gaussians:sigma=" + "9/" * 3000), ("tolerance", "nan"), ("no" * 50, "1"), ("dirt", "0" * 32), ("exposure", "99")])
    m.params.add(name=name, text=value)
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, m)
        p.data(1, data)
        said = p.ends({1})[1].said
    if not said.startswith("PARAM_") and said not in ("NO_ASSET", "BUSY"):
        raise Wrong(f"{said} for {name}={value[:40]}")
    return said


def duplicate_id(s: Session) -> str:
    case, data = s.case()
    m = s.bloom(case, pb.Payload.INLINE, len(data))
    with Peer(s.path) as p:
        p.send(Type.BLOOM, 1, m)
        p.send(Type.BLOOM, 1, m)
        if (answer := p.next()) is None or answer[0].type == Type.CREDIT and (answer := p.next()) is None or answer[0].type != Type.ERROR:
            raise Wrong(f"{answer} for an id in use")
        if answer[1].symbol not in ("DUPLICATE_ID", "BUSY"):
            raise Wrong(f"{answer[1].symbol} for an id in use")
        if answer[1].symbol == "BUSY":
            return "BUSY"
        p.data(1, data)
        return s.right(case, p.ends({1})[1], *BUSY) and "DUPLICATE_ID"


def crowd(s: Session) -> str:
    peers = []
    try:
        for _ in range(s.rng.randint(20, 150)):
            peers.append(Peer(s.path, hello=s.rng.random() < 0.5))
        return "held"
    finally:
        for p in peers:
            p.close()


def open_wall(p: Peer, name: str) -> str:
    """A wall without boards. What the daemon said against it, or nothing."""
    text = (
        f"wall: {name}\nrate: 50\nhold: forever\npicture: {{tone map: aces}}\npanels:\n"
        "  - {grid: [2, 1], name: tile, size: [16, 16], wiring: {serpentine: true}}\n"
        f"boards:\n  - {{serial: {name.upper()}, panels: [tile]}}\n"
    )
    p.send(Type.WALL, 77, pb.Wall(action=pb.Wall.OPEN, definition=text))
    while (message := p.next()) is not None and message[0].type not in (Type.WALL_REPLY, Type.ERROR):
        pass
    if message is not None and message[0].type == Type.WALL_REPLY:
        return ""
    if message is None or message[1].symbol not in ("BUSY", "LIMIT"):
        raise Wrong(f"{message and message[1].text} at the opening of a wall")
    return str(message[1].symbol)


def send_picture(s: Session, p: Peer, id: int, case: Case, name: str, output: int = pb.Output.WALL, **params: str) -> None:
    """To the wall, or (name "") back as any frame."""
    case = {**case, "params": params, "exr": {}}
    data = Path(case["input"]).read_bytes()
    target = {"wall": pb.WallTarget(name=name)} if name else {}
    p.send(Type.BLOOM, id, s.bloom(case, pb.Payload.INLINE, len(data), output, **target))
    p.data(id, data)


def wall_session(s: Session) -> str:
    """A wall, frames for it, and away without a word."""
    name = f"w{s.rng.randrange(10**9)}"
    with Peer(s.path) as p:
        if said := open_wall(p, name):
            return said
        for id in range(1, s.rng.randint(2, 6)):
            send_picture(s, p, id, s.rng.choice(s.small), name)
        if s.rng.random() < 0.5:
            p.send(Type.WALL, 78, pb.Wall(action=pb.Wall.PREVIEW, name=name))
        time.sleep(s.rng.random() * 0.3)
    return "left"


def first_of_each_kind(s: Session) -> None:
    """What a daemon makes for the first of its kind (threads of walls, of kernels) is there afterwards."""
    ways: list[tuple[str, int, dict[str, str]]] = [
        (name, output, params)
        for name, output in (("warm", pb.Output.WALL), ("warm", pb.Output.INLINE), ("", pb.Output.INLINE))
        for params in ({}, {"psf": "eye"})
    ]
    with Peer(s.path) as p:
        if said := open_wall(p, "warm"):
            raise Wrong(said)
        pictures = [(c, *ways[0]) for c in s.small] + [(s.small[-1], *way) for way in ways]
        for id, (case, name, output, params) in enumerate(pictures, 1):
            send_picture(s, p, id, case, name, output, **params)
            if (end := p.ends({id})[id]).type != Type.RESULT:
                raise Wrong(f"{end.said} ({getattr(end.body, 'text', '')}) for {case}, wall {name!r}, {params}")


FAULTS: dict[str, Callable[[Session], str]] = {
    f.__name__: f
    for f in (
        garbage, mutated, half_upload, slow_reader, leaves_with_result, cancel, deadline, truncated_exr, shrinking_file, scribbled_memfd,
        unsealed_memfd, wrong_descriptors, wrong_params, duplicate_id, crowd, wall_session,
    )
}  # fmt: skip


def turns(rng: random.Random, stall: bool) -> Iterator[str]:
    """Each kind once in an order of its own, and again."""
    while True:
        yield from rng.sample(list(FAULTS), len(FAULTS))
        if stall:
            yield "stalled_upload"


def main() -> None:
    with open(sys.argv[1]) as f:
        spec = json.load(f)
    rng = random.Random(int(sys.argv[2]))
    end = time.monotonic() + float(sys.argv[3])
    with tempfile.TemporaryDirectory(dir=spec["work"]) as folder:
        session = Session(spec, rng, Path(folder))
        for name in turns(rng, bool(spec.get("stall"))):
            if time.monotonic() > end:
                break
            try:
                say(fault=name, ended=(stalled_upload if name == "stalled_upload" else FAULTS[name])(session))
            except Wrong as e:
                say(fault=name, wrong=str(e))


if __name__ == "__main__":
    main()
