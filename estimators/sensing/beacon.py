"""The errors of a satellite receiver, which stay much the same from one fix to the next."""

from __future__ import annotations

import math

_CORRELATION_S = 30.0
_MIN_STEP_S = 0.01


class BeaconErrors:
    """Tells with what sigma each fix is to be taken for an independent measurement.

    Fixes in the time that an error lasts count together as one: averaging them makes none of them better. For errors
    that fade as exp(-t / tau), variances are multiplied by 2 tau / step, what their mean's grows by.
    """

    def __init__(self) -> None:
        self._last_s = -math.inf

    def sigma_m(self, time_s: float, sigma_m: float) -> float:
        """Return the sigma to use for a fix of ``sigma_m`` at ``time_s``."""
        step_s = max(abs(time_s - self._last_s), _MIN_STEP_S)
        self._last_s = max(self._last_s, time_s)
        return sigma_m * math.sqrt(max(2.0 * _CORRELATION_S / step_s, 1.0))
