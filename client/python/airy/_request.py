# SPDX-License-Identifier: Apache-2.0
"""The keyword arguments of bloom(), plan(), asset() as requests of the engine: one place for both clients."""
from __future__ import annotations

from typing import Any, Literal, Mapping, Optional, Sequence, Union

from . import airy_pb2 as pb
from . import errors, payload
from ._engine import Engine, ProgressCallback, Request
from ._wire import Type

Param = Union[str, float, int, bool]
Output = Literal["inline", "memfd", "buffer"]

PARAMS_MAX = 64


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
    engine: Engine,
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
) -> Request:
    assert engine.welcome is not None
    features = engine.welcome.features
    if plan_only and "plan" not in features:
        raise errors.InvalidRequest("the daemon does not plan", field="plan_only")
    message = pb.Bloom(plan_only=plan_only, progress=progress is not None and "progress" in features)
    add_params(message, params)
    if show is not None:
        add_params(message, {"view": show})
    exr = _texts(
        part=None if part is None else str(part), layer=layer, view=view, pixels=pixels, compression=compression
    )
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
        if not plan_only:
            _set_output(message, prepared, features, output)
        return Request(Type.BLOOM, message, prepared, plan_only, progress)
    except BaseException:
        prepared.close()
        raise


def _set_output(
    message: Any, prepared: payload.Prepared, features: frozenset[str], output: Optional[Output]
) -> None:
    way = output or ("memfd" if payload.HAS_MEMFD and "memfd" in features else "inline")
    if way not in ("inline", "memfd", "buffer"):
        raise errors.InvalidRequest(f'output is {way!r}; expected "inline", "memfd" or "buffer"', field="output")
    if way not in features:
        raise errors.InvalidRequest(f"the daemon does not give output by {way}", field="output")
    if way != "inline" and not payload.HAS_MEMFD:
        raise errors.InvalidRequest("this system has no memfd", field="output")
    message.output.kind = {"inline": pb.Output.INLINE, "memfd": pb.Output.MEMFD, "buffer": pb.Output.BUFFER}[way]
    if way == "buffer":
        fd, prepared.output = payload.make_memfd(prepared.size)
        prepared.fds.append(fd)
        message.output.fd = len(prepared.fds) - 1
        message.output.size = prepared.size


def asset(engine: Engine, source: payload.Source, via: Optional[payload.Via] = None) -> Request:
    assert engine.welcome is not None
    if "asset" not in engine.welcome.features:
        raise errors.InvalidRequest("the daemon keeps no images", field="asset")
    if isinstance(source, payload.Raw) or payload.is_array(source):
        raise errors.InvalidRequest("an image to be kept is an EXR file: a path, or its bytes", field="input")
    prepared = payload.prepare(source, engine.welcome.features, via)
    message = pb.Asset(input=prepared.message())
    return Request(Type.ASSET, message, prepared)


def wall_list(name: str = "") -> Any:
    return pb.Wall(action=pb.Wall.LIST, **_texts(name=name))
