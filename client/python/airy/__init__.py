# SPDX-License-Identifier: Apache-2.0
"""airy - bloom for HDR frames, by the airyd daemon.

    import airy
    with airy.Client() as c:
        c.bloom("in.exr", threshold=1.5).save("out.exr")
"""
from . import aio, errors
from .client import Client, Pending
from .errors import AiryError, Cancelled, ConnectionLost, DaemonError, InvalidRequest, NoDaemon
from ._request import Part
from .payload import Raw, RawChannel
from .result import Asset, Device, Energy, Limits, NonFinite, Region, Result, Status, Target, Times, Welcome
from .walls import Controller, Percentiles, Preview, WallBoard, Walls, WallState, WallSupply

__version__ = "0.1.0"
__all__ = [
    "AiryError",
    "Asset",
    "Cancelled",
    "Client",
    "ConnectionLost",
    "Controller",
    "DaemonError",
    "Device",
    "Energy",
    "InvalidRequest",
    "Limits",
    "NoDaemon",
    "NonFinite",
    "Part",
    "Pending",
    "Percentiles",
    "Preview",
    "Raw",
    "RawChannel",
    "Region",
    "Result",
    "Status",
    "Target",
    "Times",
    "WallBoard",
    "WallState",
    "WallSupply",
    "Walls",
    "Welcome",
    "aio",
    "errors",
]
