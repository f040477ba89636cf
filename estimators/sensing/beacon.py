"""The errors of a satellite receiver, which stay much the same from one fix to the next.

Source: Bayley and Hammersley, "The effective number of independent observations in an autocorrelated time series",
Supplement to the Journal of the Royal Statistical Society 8(2), 1946.
"""

from __future__ import annotations

import math

_CORRELATION_S = 30.0
_MIN_STEP_S = 0.01


class BeaconErrors:
    """Returns the sigma with which each fix can be treated as an independent measurement.

    Fixes within the correlation time of the error count together as one: averaging them does not improve them. For
    errors that fade as exp(-t / tau), variances are multiplied by 2 tau / step, the growth of their mean's variance.
    """

    def __init__(self) -> None:
        self._last_s = -math.inf

    def sigma_m(self, time_s: float, sigma_m: float) -> float:
        """Return the standard deviation to use for a fix.

        Args:
            time_s: Time of the fix, vehicle's clock, s.
            sigma_m: Standard deviation that the beacon reports or that is configured, m.
        """
        step_s = max(abs(time_s - self._last_s), _MIN_STEP_S)
        self._last_s = max(self._last_s, time_s)
        return sigma_m * math.sqrt(max(2.0 * _CORRELATION_S / step_s, 1.0))
