"""What a position next to the target costs: the planner's one measure. Unit: seconds off the chosen side.

Watch frame: origin at the target, x to the right of the watch course, y ahead. The watch course is the target's
(held through stops), mirrored for the right side, so that the side to be on is always the left one, x < 0. For
a compass sector it is the course whose left normal is the middle of the sector.

Source: docs/explanation/planners.md#cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.mission.predictive.cost_kernel import CostTerms, cost_rates

# Outside the band one second costs as much as this many off the side, and more the further out.
_OUTSIDE, _OUTSIDE_PER_M = 20.0, 0.5
# Inside the band the cost rises towards its edges over this width, to _WALL at the edge.
_WALL_WIDTH_M, _WALL = 20.0, 2.0
# The planner keeps this far inside the required band: the aircraft's own error and what it learns too late.
_MARGIN_M = 15.0
# In wind the ground speed differs from the plan's: this much more margin for each m/s, up to twice the margin.
_MARGIN_IN_WIND_S = 3.0
# A target may turn towards the aircraft: the margin at the near edge is what the fastest one covers in this time.
_MARGIN_OF_TARGET_S = 1.8

# The planner keeps the target this far inside the pan limits. Just beyond them, a second costs as much as _BLIND
# seconds off the side. Far beyond them, where the payload's tracker loses the target, _LOST is added: its values are
# for circles of these shares of the band, because a figure of eight with wide circles takes more side and room.
_PAN_MARGIN_RAD, _BLIND = math.radians(2.0), 2.5
_LOST, _LOST_SHARES = (20.0, 0.0), (0.1, 1.0 / 3.8)

Values = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class WatchCost:
    """near_m..far_m: the band to keep. half_width_rad: of the watched sector about the normal; pi/2 is a side.

    pan_limit_rad: of the gimbal, to each side of the nose; pi: it looks all around. lost: what a second far beyond
    costs more than one just beyond.
    """

    near_m: float
    far_m: float
    half_width_rad: float = math.pi / 2
    pan_limit_rad: float = math.pi
    lost: float = 0.0

    @staticmethod
    def inside(
        range_min_m: float,
        range_max_m: float,
        half_width_rad: float = math.pi / 2,
        wind_speed_m_s: float = 0.0,
        target_speed_max_m_s: float = 0.0,
        pan_limit_rad: float = math.pi,
        radius_m: float = 0.0,
    ) -> WatchCost:
        """Return the cost of a required band, with the planner's margins: wider in wind, and near a fast target.

        Args:
            half_width_rad: Half of the sector, rad; pi/2 for a side.
            pan_limit_rad: Greatest pan of the gimbal, rad off the nose; pi: all around.
            radius_m: Radius of the circles, m; needed with a pan limit.
        """
        margin_m = _MARGIN_M + min(_MARGIN_IN_WIND_S * wind_speed_m_s, _MARGIN_M)
        near_m = range_min_m + max(margin_m, _MARGIN_OF_TARGET_S * target_speed_max_m_s)
        far_m = range_max_m - margin_m
        if pan_limit_rad >= math.pi:
            return WatchCost(near_m, far_m, half_width_rad)
        lost = float(np.interp(radius_m / (range_max_m - range_min_m), _LOST_SHARES, _LOST))
        return WatchCost(near_m, far_m, half_width_rad, pan_limit_rad - _PAN_MARGIN_RAD, lost)

    def rate(
        self, x_m: Values, y_m: Values, widened_m: npt.ArrayLike = 0.0, side_blur_m: npt.ArrayLike = 1.0
    ) -> Values:
        """Return the cost per second at places of the watch frame.

        It is the chance of being off the side, 0..1, and the walls at the edges of the band. widened_m moves both
        edges inwards, never beyond a half of the band's width; the sides' border is blurred over +-side_blur_m (> 0).
        """
        every = np.broadcast_arrays(x_m, y_m, widened_m, side_blur_m)
        rate = np.empty(every[0].shape)
        x, y, widened, blur = (a.astype(np.float64).ravel() for a in every)
        cost_rates(x, y, widened, blur, self.terms, rate.ravel())
        return rate

    @property
    def terms(self) -> CostTerms:
        """The same as the loops see it."""
        return CostTerms(
            self.near_m,
            self.far_m,
            math.cos(self.half_width_rad),
            _OUTSIDE,
            _OUTSIDE_PER_M,
            _WALL_WIDTH_M,
            _WALL,
            math.cos(self.pan_limit_rad),
            _BLIND if self.pan_limit_rad < math.pi else 0.0,
            self.lost,
        )
