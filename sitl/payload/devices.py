"""The simulated payloads by the names of their protocols."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sidelong.sitl.payload.device import Device
from sidelong.sitl.payload.gremsy import SimulatedGremsy
from sidelong.sitl.payload.siyi import SimulatedSiyi
from sidelong.sitl.payload.topotek import SimulatedTopotek
from sidelong.sitl.payload.viewpro import SimulatedViewpro
from sidelong.sitl.settings import Quirks, Settings

OVER_TCP = ("viewpro",)
"""Those that listen for a TCP connection; the others take datagrams."""

DEVICES: dict[str, Callable[[Quirks, np.random.Generator], Device]] = {
    "siyi": SimulatedSiyi,
    "viewpro": SimulatedViewpro,
    "gremsy": SimulatedGremsy,
    "topotek": SimulatedTopotek,
}


def device_of(settings: Settings) -> Device | None:
    """Return the device of a vehicle, None where its payload has no port of its own."""
    if not settings.device:
        return None
    kind = settings.device.partition("@")[0]
    return DEVICES[kind](settings.quirks, np.random.default_rng(settings.seed))
