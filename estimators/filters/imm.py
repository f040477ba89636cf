"""Interacting multiple model filter: a target that stands, cruises, turns or manoeuvres.

Source: Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Transactions on Automatic Control 33(8), 1988; docs/explanation/filter.md#motion.

standing      velocity is zero but for a shuffle, the position stays
cruising      velocity holds, with a little white acceleration
turning       velocity turns at an unknown rate, otherwise as cruising
manoeuvring   much white acceleration: braking, gathering way, swerving

All models share the derivative of the measurement, taken at their common mean: they lie within metres of one another
and some hundred metres from the aircraft.

Several payloads can feed one filter, each with constant errors of its own. Two aircraft see the target along two base
lines: what one payload's yaw error shifts across its line of sight, the other's range measures along it. So both
calibrations become observable, which they hardly are for one aircraft alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from sidelong.estimators.filters import imm_kernel as kernel
from sidelong.estimators.filters.biases import Biases, FloatArray, prior_sigmas
from sidelong.estimators.filters.imm_kernel import EAST, ERRORS, HEIGHT, NORTH, TARGET, TURN, VELOCITY_E, VELOCITY_N
from sidelong.estimators.sensing.sighting import AnySighting, Fix, measurement_by_biases
from sidelong.estimators.settings import TargetKind, TrackerSettings

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground

# No target stands still for long: one that stays in place still wanders, by a metre in 10 s. With less noise, the
# motion of a resting or creeping target was attributed to an error of the gimbal.
_SHUFFLE_M2_S = 0.1

# Of several densities, those with which the filter's 95 % ellipse contained recorded movers of that kind 95 % of the
# time, at the least error (``tests/bench/test_real_targets.py``).
DENSITIES: dict[TargetKind, kernel.Densities] = {
    "unknown": kernel.Densities(0.025, 1.0, _SHUFFLE_M2_S),
    "walker": kernel.Densities(0.02, 0.5, _SHUFFLE_M2_S),
    "cyclist": kernel.Densities(0.025, 1.5, _SHUFFLE_M2_S),
    "car": kernel.Densities(0.02, 0.5, _SHUFFLE_M2_S),
    "boat": kernel.Densities(0.02, 1.0, _SHUFFLE_M2_S),
    "animal": kernel.Densities(0.02, 0.5, _SHUFFLE_M2_S),
}

# Without ranges the filter averages over tens of seconds, in which a target holds its velocity better than that: this
# share of the accelerations gives an ellipse that contains it as often (``tests/bench/test_camera_motion.py``).
_SHARE_WITHOUT_RANGE, _WITHOUT_RANGE_S = 0.25, 3.0
_STEPS_MAX = 60


class TargetImm:
    """A filter that has been started at a sighting. Sightings come in the order of time."""

    models: ClassVar[int] = len(kernel.MODELS)

    def __init__(
        self, settings: TrackerSettings, sighting: AnySighting, biases: Biases, ground: Ground | None = None
    ) -> None:
        """Start at the first sighting of a target; ``biases`` of all payloads are as :func:`prior_of` has them."""
        mean, covariance = starting_moments(settings, sighting, biases)
        if ground is not None:
            kernel.begin_standing(mean, covariance, ground.grid, ground.sigma_m)
        row = np.concatenate(([1.0 / self.models], mean, covariance.ravel()))
        self._set_up(settings, sighting.time_s, np.tile(row, (self.models, 1)), ground)
        if not sighting.has_range:
            self._ranged_s = -math.inf

    @classmethod
    def resumed(
        cls, settings: TrackerSettings, time_s: float, state: FloatArray, ground: Ground | None = None
    ) -> Self:
        """Return a filter in a known state, see :mod:`sidelong.estimators.filters.imm_kernel`."""
        filtered = cls.__new__(cls)
        filtered._set_up(settings, time_s, state, ground)
        return filtered

    def _set_up(self, settings: TrackerSettings, time_s: float, state: FloatArray, ground: Ground | None) -> None:
        self.time_s, self.state = time_s, state
        self._ground, self._soft_nis = ground, settings.soft_nis
        self.densities, self._ranged_s, self._averages = self._densities_of(settings), time_s, False

    @staticmethod
    def _densities_of(settings: TrackerSettings) -> kernel.Densities:
        return DENSITIES[settings.target_kind]

    def predict(self, time_s: float) -> None:
        """Predict the state to a time that is not earlier than the filter's own."""
        left_s, self.time_s = round(time_s - self.time_s, 6), time_s
        if left_s <= 0.0:
            return
        densities = steadier(self.densities) if self._averages else self.densities
        for _ in range(_STEPS_MAX):  # the motions switch by steps of at most 1 s; after a minute little changes
            if left_s <= 1.0:
                self._move(left_s, densities)
                break
            self._move(1.0, densities)
            left_s = round(left_s - 1.0, 6)

    def _move(self, step_s: float, densities: kernel.Densities) -> None:
        ahead, ground = np.empty_like(self.state), self._ground
        if ground is None:
            kernel.predict(self.state, step_s, densities, ahead)
        else:
            kernel.predict_standing(self.state, step_s, densities, ground.grid, ground.sigma_m, ahead)
        self.state = ahead

    def update(self, sighting: AnySighting, gate_nis: float) -> float:
        """Update the state with a sighting of now unless the gate rejects it; return the NIS, of three freedoms."""
        state = self.state.copy()
        nis = kernel.update(state, sighting.payload, seen(sighting), gate_nis, self._soft_nis)
        if nis <= gate_nis:
            self.state = state
            if sighting.has_range:
                self._ranged_s = sighting.time_s
            self._averages = sighting.time_s - self._ranged_s > _WITHOUT_RANGE_S
        return nis

    @property
    def height_m(self) -> float:
        """The height of the target's ground, m."""
        return float(self.state[:, 0] @ self.state[:, 1 + HEIGHT])

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) of (east, north, velocity east, velocity north)."""
        return self._combined(4)

    def biases(self) -> Biases:
        """Return what is known of the errors of all payloads."""
        mean, covariance = self._combined(kernel.numbers_of(self.state))
        return Biases(mean[TARGET:], covariance[TARGET:, TARGET:])

    def without_errors(self, sightings: Iterable[AnySighting]) -> list[AnySighting]:
        """Return sightings without the payload's errors."""
        biases = self.biases()
        return [sighting.without(*biases.mean[_errors_in(biases, sighting)].tolist()) for sighting in sightings]

    def _combined(self, size: int) -> tuple[FloatArray, FloatArray]:
        mean, covariance = np.empty(size), np.empty((size, size))
        kernel.combine(self.state, mean, covariance)
        return mean, covariance

    def widen_clock(self, payload: int, sigma_s: float) -> None:
        """Set the standard deviation of the clock of the payload of an index, before its first detection."""
        n = kernel.numbers_of(self.state)
        at = kernel.errors_of(payload, n)[0] + ERRORS
        self.state = self.state.copy()
        self.state[:, 1 + n + at * (n + 1)] = sigma_s**2

    def copy(self) -> Self:
        """Return an independent filter with the same state."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other


def steadier(densities: kernel.Densities) -> kernel.Densities:
    """Return the process noise while no ranges are measured, from that of the same target with ranges."""
    return densities._replace(
        cruise_m2_s3=_SHARE_WITHOUT_RANGE * densities.cruise_m2_s3,
        manoeuvre_m2_s3=_SHARE_WITHOUT_RANGE * densities.manoeuvre_m2_s3,
    )


def prior_of(payloads: Sequence[TrackerSettings], clock_sigmas_s: Sequence[float]) -> Biases:
    """Return the prior of the errors of several payloads, each with its clock."""
    sigmas = [(*prior_sigmas(payload), clock_s) for payload, clock_s in zip(payloads, clock_sigmas_s, strict=True)]
    return Biases(np.zeros(4 * len(sigmas)), np.diag(np.square(sigmas).ravel()))


def _errors_in(biases: Biases, sighting: AnySighting) -> slice:
    """Return where the errors of a sighting's payload are."""
    first = kernel.errors_of(sighting.payload, TARGET + biases.mean.size)[0] - TARGET
    return slice(first, first + ERRORS)


def starting_moments(
    settings: TrackerSettings, sighting: AnySighting, biases: Biases
) -> tuple[FloatArray, FloatArray]:
    """Return mean (n,) and covariance (n, n) of a target at its first sighting, with unknown velocity."""
    size = TARGET + biases.mean.size
    mean, covariance = np.zeros(size), np.zeros((size, size))
    own, position, velocity = _errors_in(biases, sighting), [EAST, NORTH, HEIGHT], [VELOCITY_E, VELOCITY_N]
    seen = sighting.without(*biases.mean[own].tolist())
    to_position = seen.place_by_measurement
    # What a bias adds to the measurement it adds to the position, and is to be taken off it.
    shift = -to_position @ measurement_by_biases(sighting)
    mean[position] = seen.east_m, seen.north_m, seen.height_m
    mean[TARGET:] = biases.mean
    covariance[np.ix_(position, position)] = (to_position * np.array(sighting.variances)) @ to_position.T
    covariance[np.ix_(position, position)] += shift @ biases.covariance[own, own] @ shift.T
    covariance[position, TARGET:] = shift @ biases.covariance[own]
    covariance[TARGET:, :TARGET] = covariance[:TARGET, TARGET:].T
    covariance[velocity, velocity] = settings.target_speed_sigma_m_s**2
    covariance[TURN, TURN] = kernel.TURN_SIGMA_RAD_S**2
    covariance[TARGET:, TARGET:] = biases.covariance
    return mean, covariance


def seen(sighting: AnySighting) -> kernel.Seen:
    """Return a sighting in the form of the compiled functions."""
    if isinstance(sighting, Fix):
        return kernel.Seen(True, sighting.east_m, sighting.north_m, 0.0, *sighting.variances, 0.0, 0.0, 0.0)
    return kernel.Seen(
        False,
        sighting.slant_range_m,
        sighting.bearing_rad,
        sighting.depression_rad,
        sighting.range_sigma_m**2,
        sighting.bearing_sigma_rad**2,
        sighting.depression_sigma_rad**2,
        sighting.aircraft_east_m,
        sighting.aircraft_north_m,
        sighting.aircraft_height_m,
    )
