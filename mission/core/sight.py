"""What the ground hides of a target: the interface between terrain, planners and the control step."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class Sight(NamedTuple):
    """needed_m (targets, azimuths, rings): the height from which the target is seen, above home.

    The first is where the target is at the departure, each next one where it is step_s later. Azimuths are clockwise
    from north, rings lie ring_m apart, the first at ring_m. height_m: of the aircraft; within soft_m of the needed
    height it is doubtful. weight: of a second hidden. No targets: nothing is hidden.
    """

    needed_m: npt.NDArray[np.float32]
    ring_m: float
    step_s: float
    height_m: float
    soft_m: float
    weight: float


SightAt = Callable[[float, float, float, float], Sight]
NOTHING_HIDDEN = Sight(np.zeros((0, 1, 1), np.float32), 1.0, 1.0, 0.0, 1.0, 0.0)
