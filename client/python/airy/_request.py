# SPDX-License-Identifier: Apache-2.0
"""The arguments of the verbs as requests and questions of the engine: one place for both clients."""
from __future__ import annotations

import os
from typing import Any, Literal, Mapping, NamedTuple, Optional, Sequence, Union

from . import airy_pb2 as pb
from . import errors, payload, result, walls
from ._task import ProgressCallback, Question, Request
from ._wire import Type

Param = Union[str, float, int, bool]
Output = Literal["inline", "memfd", "buffer", "wall"]
Definition = Union[str, "os.PathLike[str]"]

PARAMS_MAX = 64
DEFINITION_BYTES_MAX = 60 * 1024  # airy-wall(5)
PREVIEW_BYTES_MAX = 3 << 20  # a wall has at most 1 << 20 pixels


class Part(NamedTuple):
    """A raw picture as a part of a frame: the whole frame's size, and where the part's first pixel is in it."""

    frame_width: int
    frame_height: int
    x: int
    y: int


def _texts(**texts: Optional[str]) -> dict[str, str]:
    for name, text in texts.items():
        if text is not None and (not isinstance(text, str) or "\0" in text):
            raise errors.InvalidRequest(f"{name} is {text!r}; expected a text without NUL", field=name)
    return {name: text for name, text in texts.items() if text}


def add_params(message: Any, params: Mapping[str, Param]) -> None:
    """Booleans are "on" and "off"; whether a name or a value is right is the daemon's to say."""
    if len(params) > PARAMS_MAX:
        raise errors.InvalidRequest(
            f"{len(params)} parameters; at most {PARAMS_MAX} are possible", field="params"
        )
    for name, value in params.items():
        if isinstance(value, bool):
            message.params.add(name=name, text="on" if value else "off")
        elif isinstance(value, str):
            _texts(**{name: value})
            message.params.add(name=name, text=value)
        else:
            try:
                message.params.add(name=name, number=float(value))
            except (TypeError, ValueError):
                raise errors.InvalidRequest(
                    f"{name} is a {type(value).__name__}; expected a number, a text, or a bool",
                    field=f"params.{name}",
                ) from None


def bloom(
    welcome: result.Welcome,
    source: payload.Source,
    params: Mapping[str, Param],
    *,
    plan_only: bool = False,
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
    wall: Optional[str] = None,
    present_ns: int = 0,
    part_of: Optional[Part] = None,
    priority: int = 0,
    deadline_ms: int = 0,
) -> Request:
    features = welcome.features
    needed = {"plan": plan_only, "wall": wall is not None, "priority": priority, "deadline": deadline_ms}
    for feature, asked in needed.items():
        if asked and feature not in features:
            raise errors.InvalidRequest(f"the daemon has no {feature}", field=feature)
    message = pb.Bloom(plan_only=plan_only, progress=progress is not None and "progress" in features)
    _set(message, priority=priority, deadline_ms=deadline_ms)
    add_params(message, params)
    if show is not None:
        add_params(message, {"view": show})
    exr = _texts(
        part=None if part is None else str(part), layer=layer, view=view, pixels=pixels, compression=compression
    )
    _set_wall(message, wall, present_ns, part_of, output)
    prepared = payload.prepare(source, features, via, channels)
    try:
        message.input.CopyFrom(prepared.message())
        if prepared.raw is None:
            message.exr.CopyFrom(pb.ExrOptions(**exr))
        elif exr:
            raise errors.InvalidRequest(
                f"{', '.join(exr)}: of an EXR file; this picture is raw pixels", field=next(iter(exr))
            )
        else:
            message.raw.CopyFrom(prepared.raw)
        if wall is not None:
            prepared.shape = None  # of the drive: not known yet
        if not plan_only:
            _set_output(message, prepared, features, output)
        shown = message.output.kind == pb.Output.WALL
        return Request(Type.BLOOM, message, prepared, plan_only, progress, idempotent=not shown)
    except BaseException:
        prepared.close()
        raise


def _set(message: Any, **numbers: int) -> None:
    for name, value in numbers.items():
        try:
            setattr(message, name, value)
        except (TypeError, ValueError):
            raise errors.InvalidRequest(f"{name} is {value!r}; expected a whole number that fits", field=name) from None


def _set_wall(
    message: Any, wall: Optional[str], present_ns: int, part_of: Optional[Part], output: Optional[Output]
) -> None:
    if wall is None:
        given = [n for n, v in (("present_ns", present_ns), ("part_of", part_of), ("output", output == "wall")) if v]
        if given:
            raise errors.InvalidRequest(f"{given[0]} without wall=NAME", field=given[0])
        return
    if not wall or not _texts(wall=wall):
        raise errors.InvalidRequest("wall is empty; expected a wall's name", field="wall")
    message.wall.name = wall
    _set(message.wall, present_ns=present_ns)
    if part_of is not None:
        _set(message.wall, **Part(*part_of)._asdict())


def _set_output(
    message: Any, prepared: payload.Prepared, features: frozenset[str], output: Optional[Output]
) -> None:
    way = output or ("memfd" if payload.HAS_MEMFD and "memfd" in features else "inline")
    if way not in ("inline", "memfd", "buffer", "wall"):
        raise errors.InvalidRequest(
            f'output is {way!r}; expected "inline", "memfd", "buffer" or "wall"', field="output"
        )
    if way not in features:
        raise errors.InvalidRequest(f"the daemon does not give output by {way}", field="output")
    if way in ("memfd", "buffer") and not payload.HAS_MEMFD:
        raise errors.InvalidRequest("this system has no memfd", field="output")
    kinds = {"inline": pb.Output.INLINE, "memfd": pb.Output.MEMFD, "buffer": pb.Output.BUFFER, "wall": pb.Output.WALL}
    message.output.kind = kinds[way]
    if way == "buffer":
        fd, prepared.output = payload.make_memfd(prepared.size)
        prepared.fds.append(fd)
        message.output.fd = len(prepared.fds) - 1
        message.output.size = prepared.size


def asset(welcome: result.Welcome, source: payload.Source, via: Optional[payload.Via] = None) -> Request:
    if "asset" not in welcome.features:
        raise errors.InvalidRequest("the daemon keeps no images", field="asset")
    if isinstance(source, payload.Raw) or payload.is_array(source):
        raise errors.InvalidRequest("an image to be kept is an EXR file: a path, or its bytes", field="input")
    prepared = payload.prepare(source, welcome.features, via)
    message = pb.Asset(input=prepared.message())
    return Request(Type.ASSET, message, prepared)


# ---- questions ---------------------------------------------------------------------------------------


def status(_: result.Welcome) -> Question:
    return Question(Type.STATUS, None, Type.STATUS_REPLY, lambda m, _: result.status(m))


def _wall(welcome: result.Welcome, action: int, make: Any, idempotent: bool, data_max: int = 0, **fields: Any) -> Question:
    if "wall" not in welcome.features:
        raise errors.InvalidRequest("the daemon has no walls", field="wall")
    message = pb.Wall(action=action, **_texts(**{k: v for k, v in fields.items() if isinstance(v, str)}))
    _set(message, **{k: v for k, v in fields.items() if not isinstance(v, str)})
    return Question(Type.WALL, message, Type.WALL_REPLY, make, idempotent, data_max)


def wall_list(welcome: result.Welcome, name: str) -> Question:
    return _wall(welcome, pb.Wall.LIST, walls.listed, True, name=name)


def wall_open(welcome: result.Welcome, definition: Definition, calibration: str, keep: bool) -> Question:
    if isinstance(definition, os.PathLike):
        try:
            with open(definition, "rb") as f:
                read = f.read(DEFINITION_BYTES_MAX + 1)
            definition = read.decode()
        except (OSError, UnicodeDecodeError) as e:
            raise errors.InvalidRequest(f"{os.fspath(definition)}: {e}", field="definition") from e
    if not isinstance(definition, str):
        raise errors.InvalidRequest(
            f"definition is a {type(definition).__name__}; expected its text, or a pathlib.Path", field="definition"
        )
    size = len(definition.encode())
    if size > DEFINITION_BYTES_MAX:
        raise errors.InvalidRequest(
            f"definition has {size} bytes; expected at most {DEFINITION_BYTES_MAX}", field="definition"
        )
    return _wall(
        welcome, pb.Wall.OPEN, walls.one, False, definition=definition, calibration=calibration, keep=bool(keep)
    )


def wall_close(welcome: result.Welcome, name: str) -> Question:
    return _wall(welcome, pb.Wall.CLOSE, walls.none, False, name=name)


def wall_pattern(welcome: result.Welcome, name: str, pattern: str, board: str, led: int, level: float) -> Question:
    return _wall(
        welcome, pb.Wall.PATTERN, walls.one, False, name=name, pattern=pattern, board=board, led=led, level=level
    )


def wall_preview(welcome: result.Welcome, name: str) -> Question:
    return _wall(welcome, pb.Wall.PREVIEW, walls.preview, True, PREVIEW_BYTES_MAX, name=name)
