# SPDX-License-Identifier: Apache-2.0
"""airy - bloom for HDR frames, by the airyd daemon.

    import airy
    with airy.Client() as c:
        c.bloom("in.exr", threshold=1.5).save("out.exr")
"""
from . import aio, errors
from .client import Client, Pending
from .errors import AiryError, Cancelled, ConnectionLost, DaemonError, InvalidRequest, NoDaemon
from .payload import Raw, RawChannel
from .result import Asset, Device, Energy, Limits, NonFinite, Result, Status, Target, Times, Welcome

__version__ = "0.1.0"
__all__ = [
    "AiryError",
    "Asset",
    "Cancelled",
    "Client",
    "ConnectionLost",
    "DaemonError",
    "Device",
    "Energy",
    "InvalidRequest",
    "Limits",
    "NoDaemon",
    "NonFinite",
    "Pending",
    "Raw",
    "RawChannel",
    "Result",
    "Status",
    "Target",
    "Times",
    "Welcome",
    "aio",
    "errors",
]
