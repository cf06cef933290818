# SPDX-License-Identifier: Apache-2.0
"""The golden vectors, good and bad, both ways; and the package's tables against PROTOCOL.md's."""
from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from google.protobuf import json_format

from airy import _wire, errors
from kit import ROOT, VECTORS, Tap, equal, main, need, raises


def decode(message: bytes, sender: str) -> tuple[_wire.Header, Any]:
    header = _wire.decode(message[: _wire.HEADER_BYTES], sender)
    body = message[_wire.HEADER_BYTES :]
    equal(len(body), header.body_bytes, "the body's length")
    return header, _wire.parse(header.type, body)


def good(vector: dict[str, Any]) -> None:
    message = bytes.fromhex(vector["hex"])
    header, body = decode(message, vector["from"])
    want = vector["header"]
    equal((header.type.name, int(header.type)), (want["type"], want["number"]), "type")
    equal((header.n_fds, header.body_bytes, header.id), (want["n_fds"], want["body_bytes"], int(want["id"])), "header")
    if "data" in vector:
        equal(message[_wire.HEADER_BYTES :].hex(), vector["data"], "data")
        return
    cls = _wire.message_class(header.type)
    if cls is None:
        equal(message[_wire.HEADER_BYTES :], b"", "body")
        equal(_wire.pack(header.type, header.id), message, "the message, encoded again")
        return
    expected = json_format.ParseDict(vector["body"], cls())
    equal(body, expected, "body")
    equal(_wire.pack(header.type, header.id, expected, header.n_fds), message, "the message, encoded from its JSON")


def bad(vector: dict[str, Any]) -> None:
    e = raises(errors.ProtocolError, lambda: decode(bytes.fromhex(vector["hex"]), vector["from"]))
    equal(e.symbol, vector["error"], "symbol")
    need(e.text and e.field, "the error names no field")


def table(name: str) -> list[list[str]]:
    text = (ROOT / "proto" / "PROTOCOL.md").read_text()
    rows = re.search(rf"<!-- {name} -->(.*?)<!-- /{name} -->", text, re.S)
    assert rows
    return [[c.strip() for c in line.split("|")[1:-1]] for line in rows[1].strip().splitlines()[2:]]


def faults() -> None:
    rows = table("faults")
    need(len(rows) > 25, "the table is not read")
    for code, symbol, _, closes, _ in rows:
        cls = errors.BY_CODE.get(int(code))
        need(cls is not None, f"no exception for code {code}, {symbol}")
        assert cls is not None
        equal(cls.symbol, symbol, f"the symbol of code {code}")
        equal(errors.closes(int(code)), closes == "yes", f"whether {symbol} closes")


def types() -> None:
    for number, name, who, fds, _, _ in table("types"):
        equal(_wire.Type(int(number)).name, name, f"type {number}")
        row = _wire._ROWS[int(number)]
        equal(row, (who[0].upper(), int(fds), row.body), name)


def tests(tap: Tap, _: Path) -> None:
    for path in sorted(VECTORS.glob("*.json")):
        vector = json.loads(path.read_text())
        tap.run(f"vector {path.stem}", lambda: (bad if "error" in vector else good)(vector))
    tap.run("an exception for every code of PROTOCOL.md", faults)
    tap.run("every message type of PROTOCOL.md", types)


main("vectors", tests)
