"""The simulated payloads by the names of their protocols."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sidelong.sitl.payload.device import Device
from sidelong.sitl.payload.siyi import SimulatedSiyi
from sidelong.sitl.settings import Quirks

DEVICES: dict[str, Callable[[Quirks, np.random.Generator], Device]] = {"siyi": SimulatedSiyi}
