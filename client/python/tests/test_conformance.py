# SPDX-License-Identifier: Apache-2.0
"""tests/conformance/cases.json against live daemons: requests through airy.Client, sessions by bytes on a bare socket."""
from __future__ import annotations

import array
import json
import math
import os
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

from google.protobuf import json_format

import airy
from airy import _transport, _wire
from airy import airy_pb2 as pb
from airy._wire import Type
from kit import AIRY, SUITE, VECTORS, Daemon, Payloads, Tap, equal, main, need, raises

PATIENCE_S = 30
MAGIC_EXR = bytes.fromhex("762f3101")


class Session:
    """A bare socket that plays one case's steps."""

    def __init__(self, path: str, payloads: Payloads) -> None:
        self.payloads = payloads
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(PATIENCE_S)
        self.socket.connect(path)
        self.credit = 0
        self.welcome: Any = None

    def play(self, steps: list[dict[str, Any]]) -> None:
        with self.socket:
            for step in steps:
                if "send" in step:
                    self.send(step["send"])
                elif "credit" in step:
                    self.await_credit(step["credit"])
                else:
                    self.expect(step["expect"])

    def sizes(self, value: Any) -> Any:
        if isinstance(value, dict):
            return {k: self.sizes(v) for k, v in value.items()}
        if isinstance(value, list):
            return [self.sizes(v) for v in value]
        if isinstance(value, str) and value.startswith("$SIZE:"):
            return str(len(self.payloads[value[6:]]))
        return value

    def send(self, s: dict[str, Any]) -> None:
        if "vector" in s:
            self.socket.sendall(bytes.fromhex(json.loads((VECTORS / f"{s['vector']}.json").read_text())["hex"]))
            return
        kind, id = Type[s["type"]], int(s.get("id", 0))
        if kind == Type.DATA:
            data = memoryview(self.payloads[s["payload"]])[s.get("begin", 0) : s.get("end")]
            for at in range(0, max(1, len(data)), _wire.DATA_BYTES_MAX):
                chunk = data[at : at + _wire.DATA_BYTES_MAX]
                self.socket.sendall(_wire.encode(kind, id, len(chunk)) + chunk)
            return
        cls = _wire.message_class(kind)
        body = json_format.ParseDict(self.sizes(s["body"]), cls()) if cls else None
        fds = [self.descriptor(fd) for fd in s.get("fds", [])]
        try:
            message = _wire.pack(kind, id, body, s.get("n_fds", len(fds) if kind != Type.STATUS else 0))
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
            equal(self.socket.sendmsg([message], rights), len(message), "bytes sent")
        finally:
            _transport.close_all(fds)

    def descriptor(self, what: dict[str, Any]) -> int:
        if "pipe" in what:
            reader, writer = os.pipe()
            os.close(writer)
            return reader
        if "file" in what:
            return os.open(self.payloads.file(what["file"]), os.O_RDONLY | os.O_CLOEXEC)
        import fcntl

        fd = os.memfd_create("conformance", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.write(fd, self.payloads[what["memfd"]])
        for seal in what["seals"]:
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, getattr(fcntl, f"F_SEAL_{seal}"))
        return fd

    def take(self, n: int) -> bytes:
        data = b""
        while len(data) < n:
            more = self.socket.recv(n - len(data))
            if not more:
                raise EOFError(f"{len(data)} of {n} bytes came before the end of the stream")
            data += more
        return data

    def next(self) -> tuple[_wire.Header, Any]:
        """The next message that is not in passing."""
        while True:
            header = _wire.decode(self.take(_wire.HEADER_BYTES), "daemon")
            body = _wire.parse(header.type, self.take(header.body_bytes))
            if header.type == Type.CREDIT:
                self.credit += body.bytes
            elif header.type not in (Type.PROGRESS, Type.DATA):
                return header, body

    def expect(self, want: Any) -> None:
        if want == "close":
            try:
                got = self.next()
            except (EOFError, ConnectionResetError) as e:
                need("0 of 24" in str(e), f"a clean end of the stream expected: {e!r}")
                return
            raise AssertionError(f"{got} came, the end expected")
        header, body = self.next()
        found = json_format.MessageToDict(body, preserving_proto_field_name=True) if body is not None else {}
        equal((header.type.name, str(header.id)), (want["type"], want["id"]), f"the answer {found}")
        for name, value in want.get("body", {}).items():
            equal(found.get(name), value, f"{name} of {found}")
        if header.type == Type.ERROR:
            need(body.text, "the error has no text")

    def await_credit(self, text: str) -> None:
        name, _, times = text.removeprefix("$SIZE:").partition("*")
        want = len(self.payloads[name]) * int(times or 1)
        # An answer after the last message is behind all the credit that is due.
        end = time.monotonic() + 10
        while self.credit < want and time.monotonic() < end:
            self.socket.sendall(_wire.pack(Type.STATUS, 1))
            equal(self.next()[0].type, Type.STATUS_REPLY, "the answer to STATUS")
        equal(self.credit, want, "credit")


class Requests:
    """Cases through the library's interface; keeps the outputs that later cases name."""

    def __init__(self, clients: dict[str, airy.Client], daemons: dict[str, Daemon], payloads: Payloads, work: Path) -> None:
        self.clients, self.daemons, self.payloads, self.work = clients, daemons, payloads, work
        self.outputs: dict[str, bytes] = {}

    def source(self, name: str, via: str, raw: Any) -> Any:
        data: Any = self.payloads.file(name) if via == "file" else self.payloads[name]
        made = self.payloads.raw(name)
        if made is None:
            return data
        kind = {"PIXEL_HALF": "half", "PIXEL_FLOAT": "float"}
        if raw is None:
            return airy.Raw(data, made["width"], made["height"], kind[made["type"]], made["channels"])
        channels = [
            airy.RawChannel(c["name"], int(c["offset"]), int(c["rowStride"]), c["pixelStride"]) for c in raw["channels"]
        ]
        return airy.Raw(data, raw["width"], raw["height"], kind.get(raw["type"], raw["type"]), channels)

    def bloom(self, case: dict[str, Any], via: str, digest: str = "") -> None:
        r, want = case["request"], case["expect"]
        client = self.clients[case["daemon"]]
        source = self.source(r["input"], via, r.get("raw"))
        params = {k: digest if v == "$DIGEST" else v for k, v in r.get("params", {}).items()}
        fractions: list[float] = []
        options: dict[str, Any] = {"via": via, **r.get("exr", {})}
        if r.get("progress"):
            options["progress"] = lambda stage, fraction: fractions.append(fraction)
        if r.get("plan_only"):
            call = lambda: client.plan(source, timeout=PATIENCE_S, **options, **params)
        else:
            output = r.get("output", "inline")
            call = lambda: client.bloom(source, timeout=PATIENCE_S, output=output, **options, **params)
        if "error" in want:
            self.failed(raises(airy.AiryError, call), want["error"])
            return
        result = call()
        target = result.targets[0]
        need(target.plan or not want.get("plan", True), "no plan is stated")
        if want.get("plan"):
            equal(result.data, None, "a plan's data")
            need(target.error_bound > 0 and target.predicted_ms > 0, f"the plan states {target}")
        else:
            need(result.ms.total > 0, f"times are {result.ms}")
            self.picture(case, result, self.payloads[r["input"]], via)
        if want.get("progress"):
            need(fractions and fractions == sorted(fractions), f"progress is {fractions}")
            need(0 <= fractions[0] and fractions[-1] <= 1, f"progress is {fractions}")
        if "targets" in want:
            equal(len(result.targets), want["targets"], "targets")
        if "untouched" in want:
            equal(target.untouched, want["untouched"], "untouched")
        if "nan" in want:
            equal(target.nonfinite.nan, want["nan"], "nan")

    def failed(self, e: airy.AiryError, want: dict[str, Any]) -> None:
        equal((e.code, e.symbol), (want["code"], want["symbol"]), f"the error ({e})")
        equal(e.retryable, want["retryable"], f"retryable of {e}")
        equal(type(e), airy.errors.BY_CODE[want["code"]], f"the exception's class for {e}")
        if "field" in want:
            equal(e.field, want["field"], f"the field of {e}")
        need(e.text, "the error has no text")
        need(e.text.startswith(want.get("text", "")), f"{e} does not begin with {want.get('text')}")

    def picture(self, case: dict[str, Any], result: airy.Result, given: bytes, via: str) -> None:
        want, data = case["expect"], result.tobytes()
        if want.get("exr"):
            equal(data[:4], MAGIC_EXR, "the output's first bytes")
        if want.get("same_as_input"):
            need(data == given, "the output is not the input")
        if want.get("size_of_input"):
            equal(len(data), len(given), "the output's length")
            need(data != given, "the output is the input")
        if want.get("same_by_every_way"):
            need(self.outputs.setdefault(case["name"], data) == data, f"via {via} gives other bytes")
        self.outputs.setdefault(case["name"], data)
        if "as" in want:
            need(self.outputs[want["as"]] == data, f"the bytes of \"{want['as']}\" are others")
        if "command" in want:
            need(self.command(case, want["command"]) == data, f"airy bloom writes other bytes")

    def command(self, case: dict[str, Any], options: list[str]) -> bytes:
        out = self.work / "command.exr"
        out.unlink(missing_ok=True)
        where = ["--socket", self.daemons[case["daemon"]].path, "--quiet"]
        given = self.payloads.file(case["request"]["input"])
        subprocess.run([AIRY, "bloom", given, str(out), *options, *where], check=True)
        return out.read_bytes()

    def asset(self, case: dict[str, Any]) -> None:
        a, want = case["asset"], case["expect"]
        client = self.clients[case["daemon"]]
        digests = set()
        for via in a["via"]:
            source = self.source(a["input"], via, None)
            call = lambda: client.asset(source, via=via, timeout=PATIENCE_S)
            if "error" in want:
                self.failed(raises(airy.AiryError, call), want["error"])
                continue
            kept = call()
            equal({"width": kept.width, "height": kept.height}, want["kept"], "size")
            need(len(kept.digest) == 32 and int(kept.digest, 16) >= 0, f"the digest is {kept.digest}")
            digests.add(kept.digest)
        if "then" in case:
            equal(len(digests), 1, "digests")
            then = {"name": case["name"], "daemon": case["daemon"], **case["then"]}
            self.bloom(then, then["request"]["via"][0], digests.pop())


class WallCase:
    """Plays one case's steps, each on the connection that it names."""

    def __init__(self, requests: Requests, path: str) -> None:
        self.requests, self.path = requests, path
        self.clients: dict[str, airy.Client] = {}

    def play(self, steps: list[dict[str, Any]]) -> None:
        try:
            for step in steps:
                name = step.get("leave", step.get("as", "a"))
                if name not in self.clients:
                    self.clients[name] = airy.Client(self.path)
                if "leave" in step:
                    self.clients.pop(name).close()
                else:
                    self.step(self.clients[name], step, step.get("expect", {}))
        finally:
            for client in self.clients.values():
                client.close()

    def step(self, c: airy.Client, step: dict[str, Any], want: dict[str, Any]) -> None:
        verb = next(k for k in ("open", "close", "list", "pattern", "preview", "bloom", "show") if k in step)
        what = step[verb]
        if verb in ("bloom", "show"):
            for via in what["via"]:
                self.expect(lambda: self.bloom(c, what, via, verb == "show"), want, self.picture)
        elif verb == "open":
            self.expect(lambda: [c.wall_open(**what, timeout=PATIENCE_S)], want, self.states)
        elif verb == "pattern":
            self.expect(lambda: [c.wall_pattern(**what, timeout=PATIENCE_S)], want, self.states)
        elif verb == "close":
            self.expect(lambda: c.wall_close(what, timeout=PATIENCE_S), want, lambda _, __: None)
        elif verb == "list":
            self.expect(lambda: c.wall_list(what, timeout=PATIENCE_S).walls, want, self.states, PATIENCE_S)
        else:
            self.expect(lambda: c.wall_preview(what, timeout=PATIENCE_S), want, self.preview, PATIENCE_S)

    def expect(self, call: Any, want: dict[str, Any], check: Any, patience_s: float = 0) -> None:
        if "error" in want:
            self.requests.failed(raises(airy.AiryError, call), want["error"])
            return
        end = time.monotonic() + patience_s
        while True:
            got = call()
            try:
                check(got, want)
                return
            except AssertionError:
                if time.monotonic() >= end:
                    raise
            time.sleep(0.02)

    def states(self, states: Any, want: dict[str, Any]) -> None:
        equal([s.name for s in states], [w.get("name", s.name) for w, s in zip(want["walls"], states)], "walls")
        equal(len(states), len(want["walls"]), "the number of walls")
        for state, fields in zip(states, want["walls"]):
            self.fields(state, fields)

    def fields(self, state: Any, fields: dict[str, Any]) -> None:
        for name, value in fields.items():
            found = getattr(state, name)
            if name == "boards":
                equal(len(found), len(value), "boards")
                for board, wanted in zip(found, value):
                    self.fields(board, wanted)
            else:
                equal(found, value, f"{name} of {state.name}")

    def preview(self, p: airy.Preview, want: dict[str, Any]) -> None:
        equal(len(p.data), p.wall.width * p.wall.height * 3, "bytes of the preview")
        if "pixels" in want:
            need(set(p.data) <= set(want["pixels"]), f"the preview has {sorted(set(p.data))[:8]}, expected {want['pixels']}")
        if "first" in want:
            equal(list(p.data[:3]), want["first"], "the first pixel")

    def bloom(self, c: airy.Client, what: dict[str, Any], via: str, show: bool) -> airy.Result:
        wall = what.get("wall")
        options: dict[str, Any] = {"via": via, **what.get("params", {})}
        if wall is not None:
            options["wall"] = wall["name"]
            if "part_of" in wall:
                options["part_of"] = airy.Part(*wall["part_of"])
        source = self.requests.source(what["input"], via, None)
        if what.get("plan_only"):
            return c.plan(source, timeout=PATIENCE_S, **options)
        for name in ("priority", "deadline_ms"):
            options[name] = what.get(name, 0)
        if show:
            assert wall is not None
            present_ns = wall.get("present_ns", 0)
            return c.show(source, options.pop("wall"), timeout=PATIENCE_S, present_ns=present_ns, **options)
        return c.bloom(source, timeout=PATIENCE_S, output=what.get("output", "inline"), **options)

    def picture(self, r: airy.Result, want: dict[str, Any]) -> None:
        if "need" in want:
            assert r.need is not None
            equal([r.need.x, r.need.y, r.need.width, r.need.height], want["need"], "need")
        if "drive" not in want:
            return
        d = want["drive"]
        width, height = d["width"], d["height"]
        equal((r.shape.shape if r.shape else None), (height, width, 3), "the drive's shape")
        samples = array.array("f", r.tobytes())
        equal(len(samples), width * height * 3, "samples of the drive")
        need(all(math.isfinite(v) and v >= 0 for v in samples), "the drive has samples that no LED can have")
        if "value" in d:
            left, top, w, h = d.get("lit", [0, 0, width, height])
            for i, v in enumerate(samples):
                x, y = i // 3 % width, i // 3 // width
                wanted = d["value"] if left <= x < left + w and top <= y < top + h else 0
                need(abs(v - wanted) <= 1e-4, f"sample {i} of the drive is {v}, expected {wanted}")


def tests(tap: Tap, work: Path) -> None:
    payloads = Payloads(work)
    daemons = {name: Daemon(work, name, *options) for name, options in SUITE["daemons"].items()}
    clients: dict[str, airy.Client] = {}
    try:
        for name, daemon in daemons.items():
            clients[name] = airy.Client(daemon.wait_ready().path, timeout=60)
        requests = Requests(clients, daemons, payloads, work)
        for case in SUITE["cases"]:
            if "session" in case:
                path = daemons[case["daemon"]].path
                tap.run(case["name"], lambda: Session(path, payloads).play(case["session"]))
            elif "walls" in case:
                wall_case = WallCase(requests, daemons[case["daemon"]].path)
                tap.run(case["name"], lambda: wall_case.play(case["walls"]))
            elif "asset" in case:
                tap.run(case["name"], lambda: requests.asset(case))
            else:
                for via in case["request"]["via"]:
                    tap.run(f"{case['name']}, {via}", lambda: requests.bloom(case, via))
    finally:
        for client in clients.values():
            client.close()
        for daemon in daemons.values():
            daemon.stop()


main("conformance", tests)
