"""What is wrong with laser and gimbal: one history of their readings, one set of hypotheses, one verdict.

Each hypothesis is another reading of the payload. The right one lets the apparent target move as targets do; by a
wrong one it circles with the aircraft.

1. A value that stays the same while the aircraft's motion has to change it: a stuck laser, a frozen gimbal.
2. Another frame of the gimbal, another unit of the laser, a yaw error of 35 degrees and more: once a second, over
   12 s in which a target moves straight. After a jump they are compared with the motion before it. The height over
   the ground is a second witness of the unit.
3. Delays and smaller errors of yaw and range, over up to 300 s, together with the target's path.
4. Yaw, range or pitch that drift, and ranges that are wrong at some bearings only, over the last 100 s.

Delays, and errors of yaw and range that are constant or drift, are corrected by the tracker, which leaves out ranges
at bearings where they are wrong. Other errors make the device faulty: its readings are not used until it agrees
again. An apparent target that jumps farther than it can drive makes the payload suspect for ``SUSPECT_S``.

Source: docs/health.md#contradictions-of-the-payload; docs/explanation/filter.md#delays.
"""

from __future__ import annotations

import cmath
import itertools
import math
import operator
import statistics
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import Quaternion, Vector, from_roll_pitch_yaw, multiply, rotate, sight_direction
from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
)
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.payload_kernel import (
    MAX_DELAY_S,
    MIN_DELAY_S,
    SHARED,
    FloatArray,
    Readings,
    fit_readings,
    look,
)

FRAMES = {
    "earth": "relative to north",
    "vehicle": "relative to the aircraft's heading",
    "body": "relative to the airframe",
}
FACTORS = {
    10.0: "a tenth of the distance: decimetres are read as centimetres",
    0.1: "ten times the distance: decimetres are read as metres",
    1.0 / 0.3048: "0.3 of the distance: metres are read as feet",
    0.3048: "3.3 times the distance: feet are read as metres",
    100.0: "a hundredth of the distance: metres are read as centimetres",
    0.01: "a hundred times the distance: centimetres are read as metres",
}
"""By what a range has to be multiplied, and what is then wrong with it."""
_STUCK = "it repeats the same range while the aircraft turns: check its power, its lens and its driver"
_FROZEN = "its orientation is frozen while the aircraft turns: check its power, its mode and its driver"
_YAW_FROZEN = "its yaw is frozen while the aircraft turns: check its pan motor, its pan limits and its driver"
_DRIFTS = {
    "pitch": "the gimbal's pitch drifts and is off by about {:+.0f} degrees, or the aircraft's height drifts: check "
    "its gyro, its mounting and the barometer",
    "range": "the laser's ranges drift by about {:+.0f} m a minute and are off by about {:+.0f} m, and corrected: "
    "check its lens, its temperature and its driver",
    "yaw": "the gimbal's yaw drifts by about {:+.0f} degrees a minute and is off by about {:+.0f} degrees, and "
    "corrected: check its gyro and the aircraft's heading",
}

_ROW_EVERY_S, _GAP_MAX_S = 0.19, 3.0
_WINDOW_S = 300.0
# 1. values that repeat
_SAME_RANGE_M, _SAME_SIGHT = 0.5, 5e-4
_SAME_S, _TURNED_RAD, _SAME_COUNT = 5.0, 0.8, 5
_EXACT_M, _SWEPT_RAD = 0.1, 0.3  # an eighth of the angle's square, times the range: 3 m at 300 m
_MOVES_AGAIN = 3
_CLOSED_M, _PASSED_RAD = 40.0, 0.25
_FLYING_M_S = 5.0
# 2. frames, units, large yaw errors
SAMPLES_S = 12.0  # how far back the verdict on frames and units looks, at two samples a second
_SAMPLE_EVERY_S, _JUDGE_EVERY_S, _FRESH_S = 0.45, 1.0, 0.6
_SAMPLES, _SAMPLES_MIN, _SPAN_MIN_S = 24, 12, 6.0
_LASER_SILENT_S = 10.0  # after that, lines of sight are judged without ranges
_FOUND_AFTER, _CLEARED_AFTER = 3, 6  # judgements in a row
_CORRECTED_AFTER = 5  # readings in a row
_WRONG_M, _BETTER_SHARE, _AS_GOOD_SHARE, _OWN_SHARE = 8.0, 0.5, 0.7, 0.3
_JUMP_M, _DRIVES_M_S, _STEPS_MIN, _APPARENT_M_S = 40.0, 15.0, 3, 30.0
OFTEN, SUSPECT_S = 3, 15.0  # how many of the last jumps are remembered; how long the payload is suspect after one
_CHANGED_S, _MARGIN_S = 30.0, 1.0
_LATELY_S, _LATELY_MIN, _CONTINUED_MIN = 6.0, 6, 5  # samples before and after a change
_CONTINUED_M, _DRIVEN_M_S, _DISCONTINUED = 15.0, 1.5, 2.0
_TRIM_SHARE = 0.8  # of the samples: a line is fitted to those, without outliers
_LEVEL_SHARE, _OFF_LEVEL_SHARE, _LEVEL_LATELY_S = 0.3, 0.5, 60.0  # of the aircraft's height over the ground
_HEIGHT_MIN_M, _OFF_GROUND_M = 25.0, 25.0  # six times the usual error of elevation data
_OFF_GROUND = (
    f"by laser and gimbal the target is more than {_OFF_GROUND_M:.0f} m above or below its ground; "
    "check the tiles, home, and what the laser meets"
)
_PITCH_NOISE_RAD = math.radians(2.0)  # six standard deviations
_DOWN_MIN, _GROUND_STEPS = 0.02, 4  # how far a line of sight points down, and how its end on hills is found
_TURN_MIN_RAD = math.radians(35.0)  # smaller ones are found with the delays
_TURNED_SHARE, _SCALES = 0.25, (0.8, 1.25)  # the hypothesis is fitted, with the length of the line of sight free
_LATE_S = -1.5, 3.5  # delays that a yaw error is mistaken for on a circle
_FIT_M, _FIT_SHARE, _DISCRIMINATES = 8.0, 0.01, 2.0
# 3. delays and smaller errors
_READINGS_MIN, _FIT_SPAN_MIN_S, _ERRING_SPAN_S = 50, 12.0, 20.0
_GROWTH, _EVERY_MIN_S, _EVERY_MAX_S = 0.2, 10.0, 60.0  # the next fit comes when the readings span a fifth more
# Standard deviations stated, of those assumed. Of readings: a target's own motion is not quite the noise that the fit
# takes it for. Of priors: on a steady circle, a late gimbal differs from a yaw error by the prior of that alone.
_READINGS_SIGMAS, _PRIORS_SIGMAS = 4.0, 2.0
_STAMPS_SIGMA_S = 0.02  # of position and attitude: their own stamps are not exact, and err alike all the time
_RANGE_BIAS_SIGMA_M = 3.0  # holds the error of the target's height, too
_STARTS_S = (0.0, 0.0), (2.0, 2.0), (1.0, 1.0), (0.0, 2.0), (2.0, 0.0)  # from the last fit, a lesser minimum may hold
# Large errors are tried where the fit without them is strained. They have to be far better (evidence: difference of
# -ln likelihood), and larger than those that a target's own motion looks like.
_STRAINED, _TURNS_M, _LOOSE_M, _EVIDENCE = 1.5, 0.15, 0.2, 50.0
_ENOUGH_AT_ONCE = 100.0  # with less evidence the next fit has to find it too
_CALM_M, _CALMER = 0.1, 0.5  # the target then turns hardly at all, or far less
_CALM_ON_HILLS_M, _CALMER_ON_HILLS = 0.2, 0.1  # the same as evidence of its own, where the ends lie on wrong hills
_WILD_M = 1.0  # or where the target would turn as no target does
_DELAYS_MAX_S = 0.95 * MAX_DELAY_S  # a delay at the end of its range fits nothing
_YAW_MIN_RAD, _RANGE_MIN_M, _FACTOR_MIN = math.radians(4.0), 15.0, 0.08
_RANGE_SHARE_MAX = 0.5  # ranges that shrink to nothing would put the target at the aircraft
_FACTOR_FROM_M, _FACTOR_BETTER, _FACTOR_STEPS, _FACTORS = 10.0, 10.0, 3, (0.25, 4.0)
_NOISE_SCALED = 0.5  # 1 for noise that is all of the ranges' own, 0 for none
_FACTOR_STARTS = 1.4, 0.7  # from 1, a lesser minimum may hold
# On a steady circle a delay hardly differs from a yaw error: 0.1 s go with a degree, and 4 m. Most payloads have the
# configured delays. Others replace them only where those are evidently wrong, and are corrected further once sure.
# The shape of hills may look like a small delay.
SURE_S = 0.045  # standard deviation of a delay that is known
_EVIDENT, _EVIDENT_ON_HILLS, _STEP_MIN_S, _GAIN, _GAIN_AT_ONCE = 3.0, 5.0, 0.015, 15.0, 60.0
# 4. drifts
_DRIFT_S, _DRIFT_SPAN_MIN_S, _GROWS_S = 100.0, 40.0, 50.0  # a drift may have begun within the window
_HALVINGS = 3  # of the time between beginnings of a drift of the yaw
_DRIFT_EVERY_S = 15.0, 10.0  # while nothing drifts, and while something seems to
_PINNED_S, _PINNED_YAW, _PINNED_RANGE = 1e-4, 1e-7, 1e-5  # standard deviations of numbers that are pinned
_RATE_SIGMAS = 3e-4, 0.05  # of yaw rad/s and range m/s; heavy tails
_SINKS_MIN, _SINKS_MAX = 0.4, 1.6  # share of a drift of the range that the target's height over the ground shows
_GROWN_YAW, _GROWN_M = math.radians(1.8), 5.0  # a drift is at least this large in its last seconds
_DRIFTED_RAD, _DRIFTED_M, _BLOCKS = math.radians(3.0), 12.0, 10
_CALM_DRIFT_M = 0.05
_WORTH = 4.0  # evidence in sight, without which a drift is not fitted
_PITCHED_RAD, _OPPOSITE_RAD = math.radians(8.0), math.radians(2.5)
_DRIFT_FOUND_AFTER, _DRIFT_CLEARED_AFTER, _UNSEEMING_COUNT = 2, 3, 2  # judgements in a row
_SUDDEN_RAD, _BEYOND_DOUBT, _BEYOND_DOUBT_LONG = math.radians(1.0), 60.0, 200.0
_SEEN_AGAIN = 0.6  # of the evidence, for a yaw that drifted a judgement before
_LONG_COUNT = 1  # of a range error that lasts, and that no fit of constant errors finds
_YAW_EVIDENCE, _RANGE_EVIDENCE, _SUSPICIOUS, _DRIFTING_SIGMA_M = 30.0, 40.0, 10.0, 1.0
_WANDER_MIN_M = 10.0  # less is within what the ellipse of the estimate and the band allow for
# Ranges that are wrong at some bearings.
_BIN_RAD, _BIN_COUNT, _VISITS, _VISIT_S = math.radians(15.0), 4, 2, 5.0
_WRONG_SHARE, _WRONG_SIGMA, _WRONG_EVIDENCE = 0.06, 0.05, 60.0  # shares of the range
_RIGHT_SHARE = 0.3  # how far off the ground right ranges are, of what the wrong ones are
_EDGE_RAD, _HALF_MAX_RAD = math.radians(15.0), math.radians(80.0)  # left out beyond what is known; at most

_NO_ATTITUDE = 4 * (math.nan,)
_AXES: tuple[Vector, ...] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_SMALL, _ERRING = np.zeros(SHARED, np.bool_), np.array([False, False, True, True, True, True])

GroundHeight = Callable[[float, float], float]
"""Returns the height of the ground above home at a position (east, north); NaN where unknown."""


class Verdict(NamedTuple):
    """What the motion of some seconds shows to be wrong."""

    frame: str | None = None  # the gimbal's true one where its flags are wrong
    factor: float = 1.0  # what the range has to be multiplied with
    is_turned: bool = False  # the gimbal's yaw has a large constant error


_NOTHING: tuple[str, str, None] = "", "", None
SOUND = Verdict()
TURNED = Verdict(is_turned=True)


class WrongBearings(NamedTuple):
    """The bearings at which the laser's ranges are wrong by a share of the distance."""

    from_nose: bool  # or from north
    middle_rad: float
    half_rad: float
    share: float

    def hold(self, bearing_rad: float, attitude: AttitudeReading | None) -> bool:
        """Return whether a line of sight is within them; True while it is not known where the nose is."""
        if attitude is None and self.from_nose:
            return True
        nose_rad = attitude.yaw_rad if attitude is not None and self.from_nose else 0.0
        return abs(wrap_rad(bearing_rad - nose_rad - self.middle_rad)) <= self.half_rad

    def of(self, readings: Readings) -> npt.NDArray[np.bool_]:
        """Return which ranges (n,) are within them."""
        off_rad = _looks(readings)[0] - (_noses_rad(readings) if self.from_nose else 0.0) - self.middle_rad
        within: npt.NDArray[np.bool_] = np.cos(off_rad) >= math.cos(self.half_rad)
        return within

    def with_others(self, other: WrongBearings) -> WrongBearings:
        """Return all bearings from the one end to the other; those known first were relative to something else."""
        if self.from_nose is not other.from_nose:
            return other
        at_rad = wrap_rad(other.middle_rad - self.middle_rad)
        first_rad = min(-self.half_rad, at_rad - other.half_rad)
        last_rad = max(self.half_rad, at_rad + other.half_rad)
        half_rad = 0.5 * (last_rad - first_rad)
        if half_rad > _HALF_MAX_RAD:
            return self
        return self._replace(middle_rad=self.middle_rad + 0.5 * (first_rad + last_rad), half_rad=half_rad)

    def __str__(self) -> str:
        return (
            f"off by about {100.0 * self.share:+.0f} % where it looks about "
            f"{math.degrees(self.middle_rad) % 360.0:.0f} degrees to the right of "
            f"{'the nose' if self.from_nose else 'north'}"
        )


class Fit(NamedTuple):
    """What a fit has come to; see :func:`sidelong.estimators.tracking.payload_kernel.fit_readings`."""

    shared: FloatArray
    scale_m: float
    information: FloatArray
    cost: float
    off_m: FloatArray


_cost = operator.attrgetter("cost")


class _Sample(NamedTuple):
    """What was received at one time; ``sighted_m`` is the apparent target, by the frame as flagged."""

    time_s: float
    turned_rad: float
    own_m: Vector
    sighted_m: Vector
    attitude: AttitudeReading
    gimbal: GimbalReading
    range_m: float
    off_level: float  # how far the target is off the ground, as a share of the own height over it; NaN: unknown


class _Repeats:
    """Notices a value that stays the same although the aircraft's motion has to change it."""

    def __init__(self, same: float) -> None:
        self._same = same
        self._anchor: tuple[float, ...] = (math.inf,)
        self._travelled: tuple[float, ...] = ()
        self.since_s = 0.0
        self._count = self._moved = 0
        self.found = False

    def note(self, values: tuple[float, ...], time_s: float, travelled: tuple[float, ...]) -> bool:
        """Take a value; return whether the finding has changed. A travelled motion of 1 has to change the value."""
        before, same = self.found, self._same
        for then, now in zip(self._anchor, values, strict=False):
            if now - then > same or then - now > same:
                break
        else:
            self._count += 1
            self._moved = 0
            if not before and self._count >= _SAME_COUNT and time_s - self.since_s >= _SAME_S:
                moves = zip(travelled, self._travelled, strict=True)
                self.found = any(abs(now - then) >= 1.0 for now, then in moves)
            return self.found is not before
        self._moved += 1
        if not before or self._moved >= _MOVES_AGAIN:
            self.found = False
            self._anchor, self.since_s, self._travelled, self._count = values, time_s, travelled, 0
        return self.found is not before


class _Drift:
    """What drifts: found by judgements in a row that name it, and over by judgements in a row that name nothing."""

    def __init__(self) -> None:
        self.what = self.text = ""  # in a word, and in words, once it is found
        self.seen = ""  # by the last judgement
        self._count, self._is_missed = 0, False

    def judge(self, seen: str, text: str, *, is_sudden: bool) -> bool:
        """Note one judgement; return whether the drift that was found is over."""
        # Of two likely paths, the fit may find the other one now and then.
        self._is_missed = not seen and self.seen == "yaw" and not self.what and not self._is_missed
        if not self._is_missed:
            self._count = self._count + 1 if seen == self.seen else 1
            self.seen = seen
        if seen and not self.what and self._count >= _DRIFT_FOUND_AFTER + 2 * (seen == "yaw" and is_sudden):
            self.what, self.text = seen, text
        is_over = bool(self.what) and not seen and self._count >= _DRIFT_CLEARED_AFTER
        if is_over:
            self.what = self.text = ""
        return is_over


class PayloadFit:
    """Takes the readings of laser and gimbal as they are used, and finds what is wrong with them."""

    def __init__(
        self, settings: TrackerSettings | None = None, parent_from_mount: Quaternion = (1.0, 0.0, 0.0, 0.0)
    ) -> None:
        settings = settings or TrackerSettings()
        self._settings, self._parent_from_mount = settings, parent_from_mount
        delay_s, yaw_rad = settings.latency_sigma_s, settings.yaw_bias_sigma_rad
        self._fits_errors, self._may_err = delay_s > 0.0, yaw_rad > 0.0  # or the biases are not estimated
        constants = max(yaw_rad, 1e-6), _RANGE_BIAS_SIGMA_M
        self._sigmas = np.array([delay_s, delay_s, *constants, _PINNED_YAW, _PINNED_RANGE])
        self.laser_fault = self.gimbal_fault = self.terrain_fault = ""  # what is wrong, and what to do
        self.is_news = self.is_changed = False  # a fault may have come or gone; there is anything new
        self.wrong_since_s = math.inf  # of the readings, while there is a fault of laser or gimbal
        self.ground: GroundHeight | None = None  # None: flat at the height of home
        self._on_ground = self._on_hills = False  # whether the ranges are those to the ground, and that is hilly
        self._ground_sigma_m = 0.0
        self.jumped_s = self._changed_s = self._level_s = -math.inf  # of the apparent target, last
        self.jumps_s: deque[float] = deque(maxlen=OFTEN)
        self._position: PositionReading | None = None
        self._attitude: AttitudeReading | None = None
        self._gimbal: GimbalReading | None = None
        self._range: RangeReading | None = None
        self._gimbal_source: Source | None = None
        self._ranged = (math.nan, math.nan)  # time and slant range, of the laser or to the ground
        self._travel_from: PositionReading | None = None
        self._course_rad: float | None = None
        self._turned_rad = self._closed = self._passed = self._swept_rad = 0.0
        self._sight: tuple[float, float] | None = None
        self._range_noted: RangeReading | None = None
        self._history: list[tuple[float, ...]] = []  # the latest readings at a time, which is the first number
        self._row_s = self._axis_s = self._sampled_s = self._judged_s = self._since_s = -math.inf
        self._expect_another_laser()
        self._expect_another_gimbal()
        self._samples: deque[_Sample] = deque(maxlen=_SAMPLES)
        self._jumped: _Sample | None = None
        self._before: tuple[float, FloatArray, FloatArray] | None = None  # time, place, velocity before the change
        self._frame = self._flagged = ""
        self.used_s = settings.latencies_s  # delays of gimbal and laser that are in use
        self._begin_device()

    def _begin_device(self) -> None:
        """Judge another device, or lines of sight that come without the yaw error from now on."""
        self._samples.clear()
        self._since_s = self._device_s = self._row_s
        self._established = self._verdict = SOUND
        self._agreeing = self._corrected = self._off_ground = self._fits = self._late_count = 0
        self._suspected_in = -1  # the fit that found a large error last
        self._frame_fault = self._unit_fault = ""
        self.wrong_bearings: WrongBearings | None = None  # where ranges are left out
        self._uneven, self._even_count = False, 0  # ranges seem to be wrong at some bearings; judgements without that
        self._drift = _Drift()
        self._long = self._unseeming = 0
        self._yaw_fitted, self._is_sudden = (-math.inf, 0.0), False  # time s and yaw error rad of the last judgement
        self.yaw_error_rad = self._turn_rad = 0.0  # the first one is large, and to be corrected
        self._sound: Fit | None = None
        self._erring: Fit | None = None  # while that explains the readings far better
        self._drifted: Fit | None = None  # with which a drift was corrected last
        self._factor = 1.0  # of the ranges, in that
        self.found: Delays | None = None  # by the latest fit; None while unknown
        self.is_late = self.is_confirmed = False  # ``found`` is to replace the delays in use; it is certain
        self.is_changed = True
        self._fit_s = self._drift_s = self._wander_s = -math.inf
        self._wander = 0.0, 0.0  # suspected error of the estimate m, and its growth m/s

    def _expect_another_laser(self) -> None:
        self._range_repeats, self._range_stays = _Repeats(_SAME_RANGE_M), _Repeats(_EXACT_M)

    def _expect_another_gimbal(self) -> None:
        self._sight_repeats, self._yaw_repeats = _Repeats(_SAME_SIGHT), _Repeats(_SAME_SIGHT)

    def stand_on(self, hills: bool, sigma_m: float) -> None:
        """Let lines of sight end on a ground; a flat one is too high or low as a whole: that is the ranges' bias."""
        self._on_hills, self._ground_sigma_m = hills, sigma_m if hills else 0.0

    @property
    def on_hills(self) -> bool:
        """Whether the ranges are those at which lines of sight meet hills."""
        return self._on_ground and self._on_hills

    @property
    def finds_yaw_error(self) -> bool:
        """Whether a large yaw error explains the readings far better."""
        return self._erring is not None

    def is_suspect(self, time_s: float) -> bool:
        """Return whether the apparent target has jumped lately, and it is not known yet whether there is a fault."""
        return 0.0 <= time_s - self.jumped_s < SUSPECT_S

    def expect_another_target(self) -> None:
        """Begin again with another target: the readings until now show the last one."""
        self._samples.clear()
        self.restart()

    def restart(self) -> None:
        """Fit delays, errors and drifts to later readings only."""
        self._since_s = self._device_s = self._row_s
        self.is_confirmed = False

    def turned_back(self) -> None:
        """Begin again with lines of sight that come without the yaw error from now on."""
        self._begin_device()
        self._settle()

    # -- readings ------------------------------------------------------------------------------------------

    def position(self, reading: PositionReading) -> None:
        """Process the aircraft's position."""
        self._position = reading

    def attitude(self, reading: AttitudeReading) -> None:
        """Process the aircraft's attitude."""
        self._attitude = reading

    def range(self, reading: RangeReading) -> None:
        """Process a range of the laser in use."""
        before = self._range
        if before is not None and reading.source is not before.source and reading.source != before.source:
            self._expect_another_laser()
            self._begin_device()
        self._range = reading
        self._ranged = reading.time_s, reading.slant_range_m
        if self._on_ground:
            self._on_ground, self._since_s = False, self._row_s
        if not self._row_s <= reading.time_s < self._row_s + _ROW_EVERY_S:
            self._row(reading.time_s)

    def ground_range(self, time_s: float, slant_range_m: float) -> None:
        """Process where a line of sight meets the ground, in place of a laser's range."""
        if not self._on_ground:
            self._on_ground, self._since_s = True, self._row_s
        self._ranged = time_s, slant_range_m

    def gimbal_axis(self, reading: GimbalReading) -> None:
        """Process the axis of a gimbal, which is not the line of sight if a camera tracks a target off it."""
        turns, passed = self._turned_rad / _TURNED_RAD, self._passed
        news = self._sight_repeats.note(reading.quaternion_wxyz, reading.time_s, (turns, passed))
        forward, right, _ = sight_direction(reading.quaternion_wxyz)
        if self._yaw_repeats.note((math.atan2(right, forward),), reading.time_s, (turns / 2.0, passed / 2.0)) or news:
            self._settle()

    def gimbal(self, reading: GimbalReading, ends_on_ground: bool = False) -> None:
        """Process a line of sight in use; one that ends on known ground counts without a range."""
        if reading.source is not self._gimbal_source and reading.source != self._gimbal_source:
            if self._gimbal_source is not None:
                self._expect_another_gimbal()
                self._begin_device()
            self._gimbal_source = reading.source
        if self._frame_fault:
            self._corrected = self._corrected + 1 if reading.frame == self._established.frame else 0
            if self._corrected >= _CORRECTED_AFTER:  # at once: on a straight leg no motion could show it
                self._begin_device()
                self._settle()
        self._gimbal = reading
        if reading.frame != self._frame:
            self._frame, self._since_s = reading.frame, self._row_s
        if not self._row_s <= reading.time_s < self._row_s + _ROW_EVERY_S:
            self._row(reading.time_s)
        if not self._axis_s <= reading.time_s < self._axis_s + _ROW_EVERY_S:
            self._axis_s = reading.time_s
            if reading.source.message != IMAGE_TRACKER:
                self.gimbal_axis(reading)
        if reading.time_s - self._sampled_s >= _SAMPLE_EVERY_S:
            self._sample(reading, ends_on_ground)

    def _row(self, now_s: float) -> None:
        if now_s < self._row_s:  # the clock was set back
            self._history.clear()
            self._sampled_s = self._judged_s = self._since_s = self._fit_s = self._drift_s = -math.inf
        self._row_s = now_s
        if self._since_s == -math.inf:
            self._since_s = self._device_s = now_s - _ROW_EVERY_S
        position, attitude, gimbal, ranged = self._position, self._attitude, self._gimbal, self._range
        if position is None:
            return
        self._travel(position)
        if ranged is not None and ranged is not self._range_noted:
            self._range_noted = ranged
            values, time_s = (ranged.slant_range_m,), ranged.time_s
            travelled = self._turned_rad / _TURNED_RAD, self._closed
            news = self._range_repeats.note(values, time_s, travelled)
            if self._range_stays.note(values, time_s, (self._swept_rad / _SWEPT_RAD,)) or news:
                self._settle()
        if gimbal is None or not self._fits_errors:
            return
        w, x, y, z = gimbal.quaternion_wxyz
        if not 0.95**2 <= w * w + x * x + y * y + z * z <= 1.05**2:
            return
        place = position.time_s, position.east_m, position.north_m
        motion = position.velocity_east_m_s, position.velocity_north_m_s, position.height_m
        turned = _NO_ATTITUDE
        if attitude is not None:
            turned = attitude.time_s, attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad
        forward, right, down = sight_direction(gimbal.quaternion_wxyz)
        self._history.append((now_s, *place, *motion, *turned, gimbal.time_s, forward, right, down, *self._ranged))
        if self._history[0][0] < now_s - 2.0 * _WINDOW_S:
            del self._history[: bisect_left(self._history, (now_s - _WINDOW_S,))]

    def _since(self, time_s: float) -> FloatArray:
        return np.array(self._history[bisect_left(self._history, (time_s,)) :]).reshape(-1, 17)

    def _travel(self, now: PositionReading) -> None:
        """Add up how far the aircraft has turned, come along the line of sight, and by what angle gone past it."""
        before, self._travel_from = self._travel_from, now
        if before is now:
            return
        east_m_s, north_m_s = now.velocity_east_m_s, now.velocity_north_m_s
        if east_m_s * east_m_s + north_m_s * north_m_s < _FLYING_M_S**2:
            self._course_rad = None
            return
        course_rad = math.atan2(east_m_s, north_m_s)
        if self._course_rad is not None and before is not None:
            step_rad = wrap_rad(course_rad - self._course_rad)
            self._turned_rad += step_rad if step_rad >= 0.0 else -step_rad
            if self._sight is not None and self._range is not None:
                east_m, north_m, (east, north) = now.east_m - before.east_m, now.north_m - before.north_m, self._sight
                across_m = north_m * east - east_m * north
                self._closed += (east_m * east + north_m * north) / _CLOSED_M
                far_m = self._range.slant_range_m
                self._passed += across_m / (far_m if far_m > 50.0 else 50.0) / _PASSED_RAD
        self._course_rad = course_rad

    def _sweep(self) -> None:
        before, self._sight = self._sight, None
        if self._samples:
            last = self._samples[-1]
            range_m = max(math.dist(last.sighted_m, last.own_m), 1.0)
            east, north = (
                (there - own) / range_m for there, own in zip(last.sighted_m[:2], last.own_m, strict=False)
            )
            self._sight = east, north
            if before is not None:
                across, along = before[1] * east - before[0] * north, before[0] * east + before[1] * north
                self._swept_rad += math.atan2(across, along)

    # -- frames, units and large yaw errors ----------------------------------------------------------------

    def _sample(self, gimbal: GimbalReading, ends_on_ground: bool) -> None:
        """Take two samples a second, and judge once a second."""
        position, attitude, slant, now_s = self._position, self._attitude, self._range, gimbal.time_s
        if position is None or attitude is None or abs(now_s - position.time_s) > _FRESH_S:
            return
        # Angles relative to north need no attitude, and are used while it is silent.
        if gimbal.frame != "earth" and abs(now_s - attitude.time_s) > _FRESH_S:
            return
        since_s = math.inf if slant is None else abs(now_s - slant.time_s)
        if since_s > _FRESH_S and (not ends_on_ground or since_s <= _LASER_SILENT_S):
            return
        self._sampled_s = now_s
        is_sound = not (self._is_stuck or self._is_frozen)
        if is_sound:
            range_m = slant.slant_range_m if slant is not None and since_s <= _FRESH_S else math.nan
            self._add_sample(position, attitude, gimbal, range_m)
            self._sweep()
        else:
            self._samples.clear()
        if now_s - self._judged_s >= _JUDGE_EVERY_S:
            self._judged_s = now_s
            if self.wrong_bearings is None or (self._samples and now_s - self._samples[-1].time_s < _JUDGE_EVERY_S):
                self._judge(gimbal.frame)
            if self._fits_errors and is_sound and not (self._frame_fault or self._unit_fault):
                self._judge_errors(now_s)
            self._settle()

    def _add_sample(
        self, position: PositionReading, attitude: AttitudeReading, gimbal: GimbalReading, range_m: float
    ) -> None:
        samples, now_s = self._samples, position.time_s
        own_m, is_ranged = (position.east_m, position.north_m, position.height_m), not math.isnan(range_m)
        sighted_m = self._apparent_m(own_m, range_m, attitude, gimbal, gimbal.frame)
        if is_ranged and self.wrong_bearings is not None:
            bearing_rad = math.atan2(sighted_m[0] - own_m[0], sighted_m[1] - own_m[1])
            if self.wrong_bearings.hold(bearing_rad, attitude):
                return
        off_level = self._off_level(own_m, sighted_m) if is_ranged else 0.0
        if samples and is_ranged is math.isnan(samples[-1].range_m):
            samples.clear()
        sample = _Sample(now_s, self._turned_rad, own_m, sighted_m, attitude, gimbal, range_m, off_level)
        jumped, self._jumped = self._jumped, None
        self._flagged = self._flagged or gimbal.frame
        jump_m, far_m = math.dist(sighted_m, samples[-1].sighted_m) if samples else 0.0, _JUMP_M
        if not is_ranged:  # noise of the pitch moves the end of the line, too; on hills it jumps between them
            noise_m = _PITCH_NOISE_RAD * math.dist(own_m, sighted_m) ** 2 / max(own_m[2] - sighted_m[2], 1.0)
            far_m += noise_m if self.ground is None else math.inf
        # A wrong frame lets it jump on and on.
        jumps = jump_m > far_m and abs(now_s - self._changed_s) > SAMPLES_S and self._drove()
        if jumps or gimbal.frame != self._flagged:
            if jumped is None or jumped.gimbal.frame != gimbal.frame or jumped.range_m == range_m:
                self._jumped = sample  # an outlier, unless the next one is like it, with a range of its own
                return
            if jump_m > _JUMP_M:
                self._change(jumped.time_s, jump_m)
            self._flagged = gimbal.frame
            samples.clear()  # what was before would hide the change
            samples.append(jumped)
        samples.append(sample)

    def _drove(self) -> bool:
        """Return whether the apparent target moved until now as slowly as one that drives; True: not known."""
        speeds_m_s = [
            math.dist(one.sighted_m, then.sighted_m) / (one.time_s - then.time_s)
            for then, one in itertools.pairwise(self._samples)
            if one.time_s > then.time_s  # a position may serve two samples
        ]
        return len(speeds_m_s) < _STEPS_MIN or statistics.median(speeds_m_s) <= _APPARENT_M_S

    def _change(self, now_s: float, jump_m: float) -> None:
        """Remember the target's motion until it jumped."""
        self._changed_s = now_s
        if jump_m > _JUMP_M + _DRIVES_M_S * (now_s - self._samples[-1].time_s):
            self.jumped_s = now_s
            self.jumps_s.append(now_s)
            self._since_s, self.is_confirmed = self._row_s, False  # the target or the payload is another one
        lately = [one for one in self._samples if now_s - one.time_s < _LATELY_S]
        if len(lately) < _LATELY_MIN:  # after dropouts: fewer but older ones
            lately = [one for one in self._samples if now_s - one.time_s < SAMPLES_S][-_LATELY_MIN:]
        self._before = None
        if len(lately) >= _LATELY_MIN:  # medians of both halves, so that one outlier in each does no harm
            rows = np.array([(one.time_s, *one.sighted_m) for one in lately])
            first, last = (np.median(half, axis=0) for half in np.split(rows, [len(rows) // 2]))
            self._before = last[0], last[1:], (last[1:] - first[1:]) / max(last[0] - first[0], 1.0)

    def _verdict_of_motion(self, established: Verdict) -> Verdict | None:
        """Return what is wrong, ``SOUND`` or as established until that fits better; None while it is not known."""
        samples = self._samples
        if established.frame == self._flagged:  # the flags are corrected; until then a wrong target moved
            established, self._before = SOUND, None
        is_recent = bool(samples) and samples[-1].time_s - self._changed_s < SAMPLES_S
        if established == SOUND and is_recent and (found := self._continued()) is not None:
            return found
        if len(samples) < _SAMPLES_MIN or samples[-1].time_s - samples[0].time_s < _SPAN_MIN_S:
            return None
        if samples[-1].turned_rad - samples[0].turned_rad < _TURNED_RAD:
            return None
        shares = sorted([one.off_level for one in samples])
        off_level = math.nan if math.isnan(sum(shares)) else shares[len(shares) // 2]
        unit_is_right, unit_is_wrong = off_level < _LEVEL_SHARE, off_level > _OFF_LEVEL_SHARE
        if unit_is_right and not math.isnan(samples[-1].range_m):
            self._level_s = samples[-1].time_s
        times_s, own_m, sighted_m = self._arrays()
        since_s, centred_m = times_s - times_s.mean(), sighted_m - sighted_m.mean(axis=0)
        off_m = centred_m - np.outer(since_s, since_s @ centred_m / (since_s @ since_s))
        as_reported_m = math.sqrt(statistics.median((off_m * off_m).sum(axis=1).tolist()))
        if established == SOUND and as_reported_m < _WRONG_M and not unit_is_wrong:
            return SOUND
        residual_m, own_residual_m, as_reported_m = self._residuals_of_hypotheses_m(
            times_s, own_m, sighted_m, established
        )
        if established != SOUND:
            if established.factor != 1.0 and not math.isnan(off_level):
                return SOUND if unit_is_right else established
            return SOUND if as_reported_m < _AS_GOOD_SHARE * residual_m[established] else established
        if unit_is_wrong and (factor := self._unit_by_height(own_m, sighted_m, residual_m, own_residual_m)):
            return Verdict(None, factor)
        if as_reported_m < _WRONG_M:
            return SOUND
        if unit_is_right:
            residual_m = {verdict: one_m for verdict, one_m in residual_m.items() if verdict.factor == 1.0}
        best = min(residual_m, key=residual_m.__getitem__)
        if residual_m[best] > _AS_GOOD_SHARE * as_reported_m:
            return SOUND
        return None if residual_m[best] > _BETTER_SHARE * as_reported_m else best

    def _continued(self) -> Verdict | None:
        """Return the reading of the payload by which the target goes on as before the change; None: it is none."""
        if self._before is None or len(self._samples) < _CONTINUED_MIN:
            return None
        times_s, own_m, sighted_m = self._arrays()
        verdicts, positions_m = self._hypotheses(own_m, sighted_m)
        before_s, before_m, before_m_s = self._before
        since_s = times_s - before_s
        expected_m = before_m + since_s[:, None] * before_m_s
        off_m = np.median(np.linalg.norm(positions_m - expected_m[:, None, :], axis=2), axis=0)
        reported_off_m = np.linalg.norm(sighted_m - expected_m, axis=1)
        reported_m, best = float(np.median(reported_off_m)), int(off_m.argmin())
        near_m = _CONTINUED_M + _DRIVEN_M_S * float(np.median(since_s))
        if reported_m < near_m:  # outliers, no change
            self._changed_s = self.jumped_s = -math.inf
            kept = [one for one, off in zip(self._samples, reported_off_m, strict=True) if off < _JUMP_M]
            self._samples.clear()
            self._samples.extend(kept)
            return None
        return verdicts[best] if off_m[best] < near_m and reported_m > _DISCONTINUED * near_m else None

    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times (n,), the aircraft (n, 3) and the apparent target (n, 3) of the samples."""
        rows = np.array([(one.time_s, *one.own_m, *one.sighted_m) for one in self._samples])
        return rows[:, 0], rows[:, 1:4], rows[:, 4:]

    def _apparent_m(
        self, own_m: Vector, range_m: float, attitude: AttitudeReading, gimbal: GimbalReading, frame: str | None
    ) -> Vector:
        """Return the end (east, north, up) of a line of sight in this frame; without a range on the ground."""
        north, east, down = sight_direction(gimbal.quaternion_wxyz)
        if frame != "earth":
            roll_rad, pitch_rad = (attitude.roll_rad, attitude.pitch_rad) if frame == "body" else (0.0, 0.0)
            aircraft = from_roll_pitch_yaw(roll_rad, pitch_rad, attitude.yaw_rad)
            north, east, down = rotate(multiply(aircraft, self._parent_from_mount), (north, east, down))
        if math.isnan(range_m):
            ground_m = 0.0
            for _ in range(1 if self.ground is None else 1 + _GROUND_STEPS):
                range_m = (own_m[2] - ground_m) / max(down, _DOWN_MIN)
                if self.ground is not None:
                    ground_m = self.ground(own_m[0] + range_m * east, own_m[1] + range_m * north)
                if math.isnan(ground_m):
                    break
        return own_m[0] + range_m * east, own_m[1] + range_m * north, own_m[2] - range_m * down

    def _off_level(self, own_m: Sequence[float], target_m: Sequence[float]) -> float:
        ground_m = 0.0 if self.ground is None else self.ground(target_m[0], target_m[1])
        over_m = own_m[2] - ground_m
        return abs(target_m[2] - ground_m) / over_m if over_m >= _HEIGHT_MIN_M else math.nan

    def _unit_by_height(
        self, own_m: FloatArray, sighted_m: FloatArray, residual_m: dict[Verdict, float], own_residual_m: float
    ) -> float | None:
        """Return the unit that puts the target on the ground and lets it move plausibly; None: there is none."""
        off_level = {}
        for factor in FACTORS:
            shares = list(map(self._off_level, own_m.tolist(), (own_m + factor * (sighted_m - own_m)).tolist()))
            off_level[factor] = math.inf if any(map(math.isnan, shares)) else statistics.median(shares)
        factor = min(FACTORS, key=off_level.__getitem__)
        fits_m = _FIT_M + _FIT_SHARE * factor * float(np.median([one.range_m for one in self._samples]))
        # A hill may look like a wrong unit, but not all of a sudden, nor does the target then stand still: with a
        # wrong factor it moves with a part of the aircraft's own motion, which has to be visible.
        lately = 0.0 <= self._samples[-1].time_s - self._level_s < _LEVEL_LATELY_S
        is_visible = lately or abs(factor - 1.0) * own_residual_m >= _DISCRIMINATES * fits_m
        is_level = off_level[factor] < _LEVEL_SHARE
        return factor if is_level and is_visible and residual_m[Verdict(None, factor)] < fits_m else None

    def _residuals_of_hypotheses_m(
        self, times_s: FloatArray, own_m: FloatArray, sighted_m: FloatArray, established: Verdict
    ) -> tuple[dict[Verdict, float], float, float]:
        """Return the residual of every other reading of the payload, of the aircraft's motion, and as reported."""
        verdicts, positions_m = self._hypotheses(own_m, sighted_m)
        own, way = own_m[:, 0] + 1j * own_m[:, 1], (sighted_m - own_m) @ (1.0, 1j, 0.0)
        scale = 1.0
        if not established.is_turned:
            # The constant yaw error without which the target moves straightest, and by what the ways then stretch:
            # least squares of own + turn * way = place + velocity * time, in the complex plane.
            columns = np.stack([way, np.full(len(way), -1.0), times_s.mean() - times_s], axis=1)
            turn = complex(np.linalg.lstsq(columns, -own, rcond=None)[0][0])
            self._turn_rad, scale = cmath.phase(turn), abs(turn)
        turned = own + way * cmath.exp(1j * self._turn_rad)
        turned_m = np.stack((turned.real, turned.imag, sighted_m[:, 2]), axis=1)
        others_m = np.stack((turned_m, own_m, sighted_m), axis=1)
        *residuals_m, turned_residual_m, straight_m, as_reported_m = _residuals_m(
            times_s, np.concatenate((positions_m, others_m), axis=1)
        ).tolist()
        # Any range that is divided by enough puts the target at the aircraft, which flies straight at times, too.
        residual_m = {
            verdict: math.inf if verdict.factor < 1.0 and one_m > _OWN_SHARE * straight_m else one_m
            for verdict, one_m in zip(verdicts, residuals_m, strict=True)
        }
        is_turn = established.is_turned or (
            abs(self._turn_rad) >= _TURN_MIN_RAD
            and _SCALES[0] <= scale <= _SCALES[1]
            and turned_residual_m <= _TURNED_SHARE * as_reported_m
            and not self._may_be_late()
        )
        residual_m[TURNED] = turned_residual_m if is_turn else math.inf
        return residual_m, straight_m, as_reported_m

    def _may_be_late(self) -> bool:
        """Return whether a delay of the gimbal looks like the yaw error: angles against north lag on a circle."""
        samples = self._samples
        turned_rad = np.unwrap([one.attitude.yaw_rad for one in samples])
        lag_rad = -self._turn_rad * (samples[-1].time_s - samples[0].time_s)
        least_rad, most_rad = sorted(delay_s * float(turned_rad[-1] - turned_rad[0]) for delay_s in _LATE_S)
        return self._flagged == "earth" and least_rad <= lag_rad <= most_rad

    def _hypotheses(self, own_m: FloatArray, sighted_m: FloatArray) -> tuple[list[Verdict], FloatArray]:
        """Return every other reading of the payload, and the targets (n, k, 3) that the samples then show."""
        frames, samples = [frame for frame in FRAMES if frame != self._flagged], self._samples
        positions_m = [
            np.array([self._apparent_m(one.own_m, one.range_m, one.attitude, one.gimbal, frame) for one in samples])
            for frame in frames
        ] + [own_m + factor * (sighted_m - own_m) for factor in FACTORS]
        return [*map(Verdict, frames), *(Verdict(None, factor) for factor in FACTORS)], np.stack(positions_m, axis=1)

    def _judge(self, flagged: str) -> None:
        verdict = self._verdict_of_motion(self._established)
        if verdict is None:
            return
        self._judge_terrain(sound=verdict == SOUND)
        # Just after a change half of the samples are older: several judgements have to agree.
        self._agreeing = self._agreeing + 1 if verdict == self._verdict else 1
        self._verdict = verdict
        if verdict == self._established or self._agreeing < (_CLEARED_AFTER if verdict == SOUND else _FOUND_AFTER):
            return
        self._established = verdict
        self._frame_fault = self._unit_fault = ""
        self.yaw_error_rad = 0.0
        if verdict.frame is not None:
            self._frame_fault = (
                f"its frame flags are wrong: they mean {FRAMES[flagged]}, but the angles are "
                f'{FRAMES[verdict.frame]}; correct the flags, or set sensors.gimbal_frame = "{verdict.frame}"'
            )
        elif verdict.is_turned and flagged != "body":
            self.yaw_error_rad, self.is_changed = self._turn_rad, True
        elif verdict.is_turned:  # about which axis is not known
            self._frame_fault = yaw_fault(self._turn_rad)
        elif verdict != SOUND:
            self._unit_fault = f"it reports {FACTORS[verdict.factor]}; correct its unit"

    def _judge_terrain(self, *, sound: bool) -> None:
        ground, off_m, before = self.ground, math.nan, self.terrain_fault
        if sound and ground is not None and not math.isnan(self._samples[-1].range_m):
            each_m = [abs(one.sighted_m[2] - ground(one.sighted_m[0], one.sighted_m[1])) for one in self._samples]
            known_m = [one for one in each_m if not math.isnan(one)]
            off_m = statistics.median(known_m) if 2 * len(known_m) > len(each_m) else math.nan
        self._off_ground = self._off_ground + 1 if off_m > _OFF_GROUND_M else 0
        if self._off_ground >= _CLEARED_AFTER:
            self.terrain_fault = _OFF_GROUND
        elif not self._off_ground:
            self.terrain_fault = ""
        self.is_news |= before != self.terrain_fault

    # -- delays, smaller errors and drifts -----------------------------------------------------------------

    def _judge_errors(self, now_s: float) -> None:
        seems = self._drift.seen or self._drift.what or self._uneven or self.wander_m(now_s)
        if now_s - self._drift_s >= _DRIFT_EVERY_S[bool(seems)]:
            self._drift_s = now_s
            self._judge_drift(now_s)
        if self._drift.what or now_s < self._fit_s:
            return
        rows = self._since(max(now_s - _WINDOW_S, self._since_s))
        span_s = now_s - float(rows[0, 0]) if len(rows) else 0.0
        self._fit_s = now_s + min(max(_GROWTH * span_s, _EVERY_MIN_S), _EVERY_MAX_S)
        self.fit(now_s)

    def _readings(
        self,
        now_s: float,
        window_s: float,
        delays_s: tuple[float, float],
        since_s: float | None = None,
        *,
        at_all_bearings: bool = False,
    ) -> Readings | None:
        """Return the readings of the last seconds, stamped without delays; None while there are too few."""
        rows = self._since(max(now_s - window_s, (self._since_s if since_s is None else since_s) + 1e-6))
        positions, attitudes, sights = _stamped(rows[:, 1:6]), _stamped(rows[:, 7:11]), _stamped(rows[:, 11:15])
        ranges, frame = _stamped(rows[:, 15:17]), list(FRAMES).index(self._frame)
        needed = [positions, sights, ranges] + ([attitudes] if frame else [])
        if min(map(len, needed)) < 2:
            return None
        sights[:, 0] -= delays_s[0]
        ranges[:, 0] -= delays_s[1]
        first_s = max(float(one[0, 0]) for one in needed) + MAX_DELAY_S
        last_s = min(float(one[-1, 0]) for one in needed) + MIN_DELAY_S
        gaps_s = [
            (one[k, 0] + MIN_DELAY_S, one[k + 1, 0] + MAX_DELAY_S)
            for one in (positions, *needed[3:])
            for k in np.flatnonzero(np.diff(one[:, 0]) > _GAP_MAX_S)
        ]
        sights, ranges = _between(sights, first_s, last_s, gaps_s), _between(ranges, first_s, last_s, gaps_s)
        if last_s - first_s < _FIT_SPAN_MIN_S or min(len(sights), len(ranges)) < _READINGS_MIN:
            return None
        if frame:
            sights[:, 1:4] = sights[:, 1:4] @ np.array([rotate(self._parent_from_mount, axis) for axis in _AXES])
            attitudes[:, 3] = np.unwrap(attitudes[:, 3])
        settings = self._settings
        pitch_rad = math.hypot(settings.pitch_sigma_rad, settings.pitch_bias_sigma_rad) if self._on_ground else 0.0
        noise = settings.yaw_sigma_rad, settings.range_sigma_m, pitch_rad, self._ground_sigma_m
        readings = _growing(Readings(positions, attitudes, sights, ranges, frame, noise, delays_s), _GROWS_S)
        return readings if at_all_bearings else self._with_right_ranges(readings)

    def _with_right_ranges(self, readings: Readings) -> Readings | None:
        """Return the readings without the ranges that are left out; None if these are nearly all."""
        if self.wrong_bearings is None:
            return readings
        right = ~self.wrong_bearings.of(readings)
        return readings._replace(ranges=readings.ranges[right]) if right.sum() >= _READINGS_MIN else None

    def fit(self, now_s: float) -> None:
        """Fit delays and constant errors to the readings of the last minutes."""
        self.found, self.is_late, latencies_s = None, False, self._settings.latencies_s
        readings = self._readings(now_s, _WINDOW_S, latencies_s)
        if readings is None:
            return
        best, sigmas = self._fit_sound(readings), self._sigmas
        strained = best.scale_m > _TURNS_M or (abs(best.shared) > _STRAINED * sigmas).any()
        span_s = float(readings.ranges[-1, 0] - readings.ranges[0, 0])
        if self._erring is not None or (strained and self._may_err and span_s > _ERRING_SPAN_S):
            best = self._fit_erring(readings, best)
            if self._erring is None and span_s > 1.2 * _DRIFT_S:  # an error that began within the window
                late = self._readings(now_s, _DRIFT_S, latencies_s)
                found = late and self._fit_erring(late, self._solve(late, self._sigmas, np.zeros(SHARED)))
                if self._erring is not None:
                    best, self._since_s = found, now_s - _DRIFT_S
            if self._erring is None and self._suspected_in == self._fits:
                self._fit_s = now_s + _EVERY_MIN_S
        tan_yaw, range_m = best.shared[2:4].tolist()
        if self._erring is None and abs(tan_yaw) > _YAW_MIN_RAD:
            return  # far beyond its prior, and yet not likely enough
        if self._erring is None or self._on_ground:
            range_m = 0.0  # it may be the target's height
        if self._erring is not None:  # of an error that is there, nothing is known before
            sigmas = np.maximum(sigmas, abs(best.shared))
        information = best.information / _READINGS_SIGMAS**2 + np.diag((_PRIORS_SIGMAS * sigmas) ** -2)
        known = np.sqrt(np.diag(np.linalg.inv(information[:4, :4]))).tolist()
        (gimbal_s, range_s), (gimbal_sigma_s, range_sigma_s) = (best.shared[:2] + latencies_s).tolist(), known[:2]
        gimbal_sigma_s, range_sigma_s = (math.hypot(one, _STAMPS_SIGMA_S) for one in (gimbal_sigma_s, range_sigma_s))
        if self._on_ground:
            range_s, range_sigma_s = latencies_s[1], 0.0
        delays_s = gimbal_s, range_s, gimbal_sigma_s, range_sigma_s
        self.found = Delays(*delays_s, math.atan(tan_yaw), known[2], range_m, known[3], self._factor)
        self.is_confirmed, self.is_changed = max(gimbal_sigma_s, range_sigma_s) < SURE_S, True
        self.is_late = self._is_late(now_s, self.found, best)

    def _is_late(self, now_s: float, found: Delays, best: Fit) -> bool:
        """Return whether delays are to replace those in use: clearly others, for long enough, and far more likely."""
        apart_s = found.gimbal_s - self.used_s[0], found.range_s - self.used_s[1]
        if self.used_s == self._settings.latencies_s:
            least = _EVIDENT_ON_HILLS if self.on_hills else _EVIDENT
        else:
            least = 1.0 if self.is_confirmed else _EVIDENT
        steps = zip(apart_s, (found.gimbal_sigma_s, found.range_sigma_s), strict=True)
        if not any(abs(step_s) > max(_STEP_MIN_S, least * sigma_s) for step_s, sigma_s in steps):
            self._late_count = 0
            return False
        self._late_count += 1
        readings = self._readings(now_s, _WINDOW_S, self.used_s)
        if readings is None:
            return False
        pinned = np.array([_PINNED_S, _PINNED_S, *self._sigmas[2:]])
        begins = (np.array([0.0, 0.0, *best.shared[2:]]), best.scale_m), (np.zeros(SHARED), 0.0)
        erring = self._erring is not None
        kept = min(  # from one start it may end in a lesser minimum
            self._solve(readings, pinned, *begin, erring=erring, factor=self._factor).cost for begin in begins
        )
        return kept - best.cost > (_GAIN if self._late_count > 1 else _GAIN_AT_ONCE)

    def _solve(
        self,
        readings: Readings,
        sigmas: FloatArray,
        start: FloatArray,
        scale_m: float = 0.0,
        *,
        erring: bool = False,
        factor: float = 1.0,
    ) -> Fit:
        """Return the fit of ranges that are multiplied by a factor."""
        found = Fit(*fit_readings(_scaled(readings, factor), sigmas, _ERRING if erring else _SMALL, start, scale_m))
        # Noise that is scaled with the ranges makes those likely that are divided, and others unlikely.
        return found._replace(cost=found.cost - _NOISE_SCALED * len(readings.ranges) * math.log(factor))

    def _fit_sound(self, readings: Readings) -> Fit:
        """Return the best fit with errors as small as the priors say."""
        before = (np.zeros(SHARED), 0.0) if self._sound is None else (self._sound.shared, self._sound.scale_m)
        start = np.array([*_STARTS_S[self._fits % len(_STARTS_S)], *(SHARED - 2) * [0.0]])
        fits = [self._solve(readings, self._sigmas, *begin) for begin in (before, (start, 0.0))]
        self._sound = min(fits, key=_cost)
        self._fits += 1
        return self._sound

    def _fit_erring(self, readings: Readings, sound: Fit) -> Fit:
        """Return the best fit with large errors; the one without them if that explains the readings as well."""
        before, range_m = self._erring, float(np.median(readings.ranges[:, 1]))
        plain = self._solve(readings, self._sigmas, np.zeros(SHARED), sound.scale_m)  # a lesser minimum is strained
        sound = min(sound, plain, key=_cost)

        def fit(factor: float, start: FloatArray, scale_m: float = 0.0) -> Fit:
            return self._solve(readings, self._sigmas, start, scale_m, erring=True, factor=factor)

        tried, by_heights_m = [(self._factor, fit(self._factor, sound.shared))], 0.0
        if before is not None:
            tried += [
                (self._factor, fit(self._factor, before.shared, scale_m)) for scale_m in (before.scale_m, _CALM_M)
            ]
        elif not self._on_ground:
            other = _FACTOR_STARTS[self._fits % len(_FACTOR_STARTS)]
            tried.append((other, fit(other, sound.shared)))
            pitch_rad, _, pitch_of_range_rad_m = _pitch_drift(readings, self._over_ground_m(readings))
            by_heights_m = pitch_rad / pitch_of_range_rad_m  # the error of the ranges, if the pitch has none
            if abs(by_heights_m) > _RANGE_MIN_M:
                tried.append((1.0, fit(1.0, np.array([0.0, 0.0, 0.0, by_heights_m, 0.0, 0.0]))))
                other = min(max(1.0 - by_heights_m / range_m, _FACTORS[0]), _FACTORS[1])
                tried.append((other, fit(other, np.zeros(SHARED))))
        factor, best = min(tried, key=lambda one: one[1].cost)
        for _ in range(0 if self._on_ground else _FACTOR_STEPS):
            other = factor - float(best.shared[3]) / range_m
            if abs(best.shared[3]) < _FACTOR_FROM_M or not _FACTORS[0] < other < _FACTORS[1]:
                break
            another = fit(other, best.shared * (1.0, 1.0, 1.0, 0.0, 1.0, 1.0))
            if another.cost > best.cost - _FACTOR_BETTER or another.scale_m > max(_CALM_M, best.scale_m):
                break
            best, factor = another, other
        (tan_yaw, bias_m), latest_s = abs(best.shared[2:4]), float(best.shared[:2].max())
        is_long = not self._on_ground and (bias_m > _RANGE_MIN_M or abs(factor - 1.0) > _FACTOR_MIN)
        is_large = is_long or tan_yaw > _YAW_MIN_RAD
        is_possible = latest_s < _DELAYS_MAX_S and bias_m < _RANGE_SHARE_MAX * factor * range_m
        is_calmer = best.scale_m < max(_CALM_M, _CALMER * sound.scale_m)
        evidence = sound.cost - best.cost
        is_better = evidence > -_EVIDENCE if before is not None else evidence > _EVIDENCE and is_calmer
        # The ends of lines that are turned wrongly lie on other hills: they fit nothing well.
        if self.on_hills or sound.scale_m > _WILD_M:
            is_better |= best.scale_m < _CALM_ON_HILLS_M and best.scale_m < _CALMER_ON_HILLS * sound.scale_m
        if is_large and is_possible and is_better and before is None and not self.on_hills:
            # A path that is stiff at first may miss a calm one; a path that bends much circles with the aircraft.
            loose = self._solve(readings, self._sigmas, np.zeros(SHARED), _LOOSE_M)
            if loose.scale_m < _CALM_M:
                evidence, sound = min(evidence, loose.cost - best.cost), min(sound, loose, key=_cost)
                is_better &= evidence > _EVIDENCE
        if is_long and is_better and before is None and evidence < _BEYOND_DOUBT_LONG:
            # A target that circles may look like one that stands, and the laser to be long. Heights know better.
            off_m = float(best.shared[3]) + range_m * (1.0 - factor)
            is_better = math.isnan(by_heights_m) or by_heights_m / off_m > _SINKS_MIN
        if is_large and is_possible and is_better:
            again, self._suspected_in = self._suspected_in == self._fits - 1, self._fits
            if before is not None or again or evidence > _ENOUGH_AT_ONCE:
                # With the readings before it, it looks like a drift.
                self._device_s = self._device_s if before is not None else float(readings.ranges[-1, 0])
                self._erring, self._factor = best, factor
                return best
        self._erring, self._factor = None, 1.0
        return sound

    def _judge_drift(self, now_s: float) -> None:
        """Compare drifts, and ranges that are wrong at some bearings only, with errors that stay the same."""
        readings = None
        if self._may_err and not self._on_ground:
            readings = self._readings(now_s, _DRIFT_S, self.used_s, self._device_s, at_all_bearings=True)
            if readings is not None:
                readings = _scaled(readings, self._factor)
        if readings is None or readings.ranges[-1, 0] - readings.ranges[0, 0] < _DRIFT_SPAN_MIN_S:
            return
        (found, text, drift), corrected = self._drift_of(readings), self.drifts
        if self._drift.judge(found, text, is_sudden=self._is_sudden):
            if corrected:  # what it has come to is constant now
                self._erring = self._drifted
            self.restart()
        if found == self._drift.what and drift is not None:
            self._correct_drift(readings, drift)

    def _correct_drift(self, readings: Readings, drift: Fit) -> None:
        """Let the error as it is now be corrected; until the next judgement it grows on."""
        (tan_yaw, range_m, yaw_rate, range_m_s), level_m = drift.shared[2:].tolist(), _level_m(readings)
        yaw_rad, off_m = _sigma_at_end(drift, 2), _sigma_at_end(drift, 3)
        yaw_sigma_rad = math.hypot(yaw_rad, yaw_rate * _DRIFT_EVERY_S[1])
        range_sigma_m = math.hypot(off_m, range_m_s * _DRIFT_EVERY_S[1])
        delays_s, known = (*self.used_s, SURE_S, SURE_S), (math.atan(tan_yaw), yaw_sigma_rad, range_m, range_sigma_m)
        self.found, self.is_late, self.is_changed = Delays(*delays_s, *known, self._factor), False, True
        self._drifted = drift
        self._wander = 2.0 * math.hypot(level_m * yaw_rad, off_m), math.hypot(level_m * yaw_rate, range_m_s)
        self._wander_s = float(readings.ranges[-1, 0])

    @property
    def drifts(self) -> bool:
        """Whether the error of yaw or range drifts, and is corrected again and again."""
        return self._drift.what in ("yaw", "range")

    @property
    def drift_news(self) -> str:
        """What drifts, and how fast; '' while nothing does."""
        return self._drift.text

    def _drift_fits(self, readings: Readings) -> tuple[Fit, Fit, Fit, Callable[..., Fit]]:
        """Return the best fits of constant errors, of a yaw and of a range that drifts; and what makes such a fit."""
        sigmas = np.array([_PINNED_S, _PINNED_S, self._sigmas[2], _DRIFTING_SIGMA_M, _PINNED_YAW, _PINNED_RANGE])
        start, known = np.zeros(SHARED), []  # constant errors that are corrected are no drift
        if self._sound is not None and (self._late_count or not self.is_confirmed):
            sigmas[:2] = self._sigmas[:2]
            start[:2] = self._sound.shared[:2] + self._settings.latencies_s - np.array(self.used_s)
        if self._erring is not None:
            known, sigmas[3] = [2, 3], self._sigmas[3]

        def fit(growth: int = 0, given: Readings = readings, sigma: float = 0.0, scale_m: float = 0.0) -> Fit:
            """Return the best fit; growth: which shared number may be large, with this standard deviation."""
            one, heavy = sigmas.copy(), np.zeros(SHARED, np.bool_)
            heavy[known] = True
            if growth:
                heavy[growth], one[growth] = True, sigma or _RATE_SIGMAS[growth - 4]
                if not sigma:  # at the end of a drift the error is large
                    heavy[growth - 2], one[growth - 2] = True, self._sigmas[growth - 2]
            return Fit(*fit_readings(given, one, heavy, start, scale_m))

        def drifting(growth: int) -> Fit:
            """Return the best fit of a drift, over when it began: a fast one fits from its own beginning only."""
            if growth == 5:  # a range drifts so slowly that two beginnings are enough
                return min(fit(growth), fit(growth, _growing(readings, _DRIFT_S)), key=_cost)
            fits: dict[float, Fit] = {}
            spans_s = [0.5 * _GROWS_S, _GROWS_S, _DRIFT_S]
            for _ in range(1 + _HALVINGS):
                fits |= {one: fit(growth, _growing(readings, one), scale_m=_LOOSE_M) for one in spans_s}
                tried_s = sorted(fits)
                best = tried_s.index(min(fits, key=lambda one: fits[one].cost))
                spans_s = [*map(statistics.mean, itertools.pairwise(tried_s[max(best - 1, 0) : best + 2]))]
            return min(fits.values(), key=_cost)

        sound = fit()
        seems = bool(self._drift.seen or self._drift.what or self._wander[0])
        by_yaw, by_range = (
            drifting(rate) if seems or _gain_of_freeing(sound, sigmas, rate) > _WORTH else sound for rate in (4, 5)
        )
        if sound.cost - min(by_yaw.cost, by_range.cost) > _SUSPICIOUS:  # it may have ended in a lesser minimum
            sound = min(sound, fit(scale_m=min(by_yaw, by_range, key=_cost).scale_m), key=_cost)
        by_yaw, by_range = (
            one if one.cost <= sound.cost else min(one, fit(rate, scale_m=sound.scale_m), key=_cost)
            for rate, one in ((4, by_yaw), (5, by_range))
        )
        return sound, by_yaw, by_range, fit

    def _drift_of(self, readings: Readings) -> tuple[str, str, Fit | None]:
        """Return what drifts, in one word and in many; '' if nothing does. And the fit that corrects it, if any."""
        eased, known = 0.5 if self._drift.what else 1.0, self.wrong_bearings
        everywhere, right = readings, self._with_right_ranges(readings)
        if right is None:
            return _NOTHING
        readings = right
        sound, by_yaw, by_range, fit = self._drift_fits(readings)
        gain, over_m = sound.cost - min(by_yaw.cost, by_range.cost), self._over_ground_m(readings)
        if self._judge_bearings(readings, over_m, sound, fit, gain):
            return _NOTHING
        if known is not None:
            self._clear_bearings(everywhere, fit)
        # Without an error that is there, the target moves more calmly; else it is the target that turned. A range
        # that drifts has the height as another witness.
        calm_m = max(sound.scale_m, _CALM_DRIFT_M)
        if by_yaw.scale_m > calm_m:
            by_yaw = sound
        level_m = _level_m(readings)
        if by_range.shared[3] > _RANGE_SHARE_MAX * level_m:
            by_range = sound
        yaw_rad, range_m = float(by_yaw.shared[2]), float(by_range.shared[3])
        yaw_gain, range_gain = sound.cost - by_yaw.cost, sound.cost - by_range.cost
        self._bound(
            readings,
            level_m,
            by_yaw if yaw_gain > _SUSPICIOUS else None,
            by_range if range_gain > _SUSPICIOUS and by_range.scale_m <= calm_m else None,
        )
        if self.jumped_s > readings.ranges[0, 0]:  # another target is no drift
            return _NOTHING
        pitch_rad, pitched_rad, pitch_of_range_rad_m = _pitch_drift(readings, over_m)
        limit_rad = eased * (_PITCHED_RAD if self.ground is None else 0.5 * _PITCHED_RAD)
        # Motion alone cannot prove it: a target that turns with the aircraft looks alike. A range that is too long
        # also puts the target below the ground, while a pitch error that shortens the level range puts it too low.
        span_s = min(float(readings.ranges[-1, 0] - readings.ranges[0, 0]), _GROWS_S)
        again = min(eased, _SEEN_AGAIN if self._drift.seen == "yaw" else 1.0)
        (before_s, before_rad), now_s = self._yaw_fitted, float(readings.ranges[-1, 0])
        self._yaw_fitted = now_s, yaw_rad
        if self._drift.seen != "yaw":  # a turn of the target looks like a drift all of a sudden
            then_rad = yaw_rad - float(by_yaw.shared[4]) * min(now_s - before_s, _GROWS_S)
            self._is_sudden = abs(then_rad - before_rad) > _SUDDEN_RAD
        grown_rad = math.copysign(1.0, yaw_rad) * float(by_yaw.shared[4]) * span_s
        yaw_grows = grown_rad > eased * _GROWN_YAW  # else it is constant, and corrected
        sinks = pitch_rad / (range_m * pitch_of_range_rad_m) if range_m else 0.0
        # A target that turns wildly explains as much; heights know better.
        is_calmer = by_range.scale_m < min(_CALM_ON_HILLS_M, _CALMER_ON_HILLS * sound.scale_m)
        is_likely = range_gain > eased * _RANGE_EVIDENCE or (is_calmer and _SINKS_MIN < sinks < _SINKS_MAX)
        is_long = is_likely and abs(range_m) > eased * _DRIFTED_M
        self._long = self._long + 1 if is_long else 0
        range_grows = abs(by_range.shared[5]) * span_s > eased * _GROWN_M
        looks_long = is_long and (range_grows or self._long > _LONG_COUNT)
        is_range = looks_long and sinks > _SINKS_MIN
        is_yaw = yaw_gain > again * _YAW_EVIDENCE and abs(yaw_rad) > eased * _DRIFTED_RAD and yaw_grows
        opposite = looks_long and pitch_rad * range_m < 0.0 and abs(pitch_rad) > _OPPOSITE_RAD
        is_pitch = abs(pitch_rad) > limit_rad and abs(pitched_rad) > _OPPOSITE_RAD and not is_range
        is_range &= range_gain > yaw_gain or not is_yaw
        for what, is_it, numbers, drift in (
            ("pitch", is_pitch or opposite, (math.degrees(pitch_rad),), None),
            ("range", is_range, (60.0 * by_range.shared[5], range_m), by_range),
            ("yaw", is_yaw, (60.0 * math.degrees(by_yaw.shared[4]), math.degrees(yaw_rad)), by_yaw),
        ):
            if is_it:
                self._is_sudden &= yaw_gain < _BEYOND_DOUBT
                return what, _DRIFTS[what].format(*numbers), drift
        return _NOTHING

    def _judge_bearings(
        self, readings: Readings, over_m: FloatArray, sound: Fit, fit: Callable[..., Fit], gain: float
    ) -> bool:
        """Find bearings at which ranges are wrong; return whether there are new ones.

        Args:
            readings: with the ranges that are not left out.
            over_m: how far above its ground each range puts the target (n,).
            sound: the best fit of these with constant errors.
            fit: makes another one, see :meth:`_drift_fits`.
            gain: the evidence of a drift, which has to be less.
        """
        known, found, gain, self._uneven = self.wrong_bearings, None, max(_WRONG_EVIDENCE, gain), False
        for one, inside in _uneven_bearings(readings, sound.off_m, over_m):
            self._uneven = True
            wrong = fit(5, _marked(readings, inside), _WRONG_SIGMA)
            if sound.cost - wrong.cost > gain and wrong.scale_m < sound.scale_m:  # maybe only a lesser minimum
                sound = min(sound, fit(0, readings, scale_m=wrong.scale_m), key=_cost)
            share, by_height = float(wrong.shared[5]), one.share
            agree = math.isnan(by_height) or abs(share - by_height) < 0.5 * abs(by_height)
            if sound.cost - wrong.cost > gain and abs(share) > _WRONG_SHARE and agree:
                gain, found = sound.cost - wrong.cost, one._replace(share=share)
        if found is not None:
            found = found if known is None else known.with_others(found)
        if found is None or found == known:
            return False
        self.wrong_bearings, self._even_count, self.is_changed = found, 0, True
        return True

    def _clear_bearings(self, everywhere: Readings, fit: Callable[..., Fit]) -> None:
        """Use all ranges again once those that are left out turn out to be right."""
        assert self.wrong_bearings is not None
        core, time_s = self.wrong_bearings, everywhere.ranges[:, 0]
        core = core._replace(half_rad=core.half_rad - _EDGE_RAD)
        inside = core.of(everywhere) & (time_s > time_s[-1] - _GROWS_S)
        if _visits(everywhere, inside) < _VISITS:
            return
        gain = fit(0, everywhere).cost - fit(5, _marked(everywhere, inside), _WRONG_SIGMA).cost
        self._even_count = 0 if gain > 0.5 * _WRONG_EVIDENCE else self._even_count + 1
        if self._even_count >= _DRIFT_CLEARED_AFTER:
            self.wrong_bearings, self.is_changed = None, True

    def _bound(self, readings: Readings, level_m: float, by_yaw: Fit | None, by_range: Fit | None) -> None:
        """Bound the error of the estimate by the drifts that are likely, though not yet certain."""
        seems = by_yaw is not None or by_range is not None
        self._unseeming = 0 if seems else self._unseeming + 1
        if not seems and self._unseeming < _UNSEEMING_COUNT:
            return
        self._wander = 0.0, 0.0
        for one, k, metres in ((by_yaw, 2, level_m), (by_range, 3, 1.0)):
            if one is not None:
                corrected = self._drifted if self.drifts else self._erring
                known = 0.0 if corrected is None else float(corrected.shared[k])
                off_m = abs(float(one.shared[k]) - known) + 2.0 * _sigma_at_end(one, k)
                self._wander = max(self._wander, (metres * off_m, metres * abs(float(one.shared[k + 2]))))
        self._wander_s = float(readings.ranges[-1, 0])

    def wander_m(self, time_s: float) -> float:
        """Return how far the estimate may be off by a drift that is suspected; 0 while the motion shows none, m."""
        off_m, rate_m_s = self._wander
        bound_m = off_m + rate_m_s * max(time_s - self._wander_s, 0.0)
        return bound_m if bound_m > _WANDER_MIN_M else 0.0

    def _over_ground_m(self, readings: Readings) -> FloatArray:
        """Return how far above its ground each range (n,) puts the target; NaN where that is not known."""
        time_s, slant_m, _ = readings.ranges.T
        rows, (bearing_rad, down_rad) = self._since(time_s[0] - _GAP_MAX_S), _looks(readings)
        over_m: FloatArray = np.interp(time_s, rows[:, 1], rows[:, 6]) - slant_m * np.sin(down_rad)
        if self.ground is not None:
            level_m = slant_m * np.cos(down_rad)
            east_m, north_m = (
                np.interp(time_s, readings.positions[:, 0], readings.positions[:, k]) + level_m * way(bearing_rad)
                for k, way in ((1, np.sin), (2, np.cos))
            )
            over_m -= list(map(self.ground, east_m.tolist(), north_m.tolist()))
        return over_m

    @property
    def _is_stuck(self) -> bool:
        return self._range_repeats.found or self._range_stays.found

    @property
    def _is_frozen(self) -> bool:
        return self._sight_repeats.found or self._yaw_repeats.found

    def _settle(self) -> None:
        before = self.laser_fault, self.gimbal_fault
        self.laser_fault = _STUCK if self._is_stuck else self._unit_fault
        frozen = _FROZEN if self._sight_repeats.found else _YAW_FROZEN if self._yaw_repeats.found else ""
        self.gimbal_fault = frozen or self._frame_fault
        if before != (self.laser_fault, self.gimbal_fault):
            self.is_news = self.is_changed = True
        if not any(before) and (self.laser_fault or self.gimbal_fault):
            repeats = self._range_repeats, self._range_stays, self._sight_repeats, self._yaw_repeats
            since_s = [one.since_s for one in repeats if one.found]
            if self._frame_fault or self._unit_fault:
                since_s.append(self._judged_s - SAMPLES_S)
                if self._judged_s - self._changed_s < _CHANGED_S:
                    since_s.append(self._changed_s)
            self.wrong_since_s = min(since_s) - _MARGIN_S


def yaw_fault(yaw_error_rad: float) -> str:
    """Return what is wrong with a gimbal whose yaw is off, and what to do."""
    return (
        f"its yaw is off by about {math.degrees(yaw_error_rad):+.0f} degrees: check its mounting and its heading, "
        "or correct sensors.mount_deg"
    )


def _stamped(rows: FloatArray) -> FloatArray:
    """Return a copy of the rows whose first column is later than in all rows before."""
    time_s = rows[:, 0]
    kept = ~np.isnan(rows[:, -1])
    kept[1:] &= ~(time_s[1:] <= np.fmax.accumulate(time_s)[:-1])
    return np.ascontiguousarray(rows[kept])


def _between(log: FloatArray, first_s: float, last_s: float, gaps_s: list[tuple[float, float]]) -> FloatArray:
    time_s = log[:, 0]
    kept = (time_s >= first_s) & (time_s <= last_s)
    for begin_s, end_s in gaps_s:
        kept &= (time_s < begin_s) | (time_s > end_s)
    return log[kept]


def _sigma_at_end(found: Fit, error: int) -> float:
    """Return the standard deviation of the error of yaw (2) or range (3) that grows."""
    pair = found.information[np.ix_([error, error + 2], [error, error + 2])] / _READINGS_SIGMAS**2
    return math.sqrt(float(np.linalg.inv(pair + np.diag([1e-9, 1e-9]))[0, 0]))


def _looks(readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return bearing and depression of the line of sight (n,) at the times of the ranges, rad."""
    looks = np.empty((len(readings.sights), 3))
    look(readings, 0.0, looks)
    looks[:, 0] = np.unwrap(looks[:, 0])
    bearing_rad, down_rad = (np.interp(readings.ranges[:, 0], readings.sights[:, 0], looks[:, k]) for k in (0, 1))
    return bearing_rad, down_rad


def _pitch_drift(readings: Readings, over_m: FloatArray) -> tuple[float, ...]:
    """Return the pitch error at the end, its change, and what a metre of range error looks like, by heights.

    All are NaN where less than half of the ground is known. over_m: how far above it each range puts the target (n,).
    """
    time_s, slant_m, _ = readings.ranges.T
    _, down_rad = _looks(readings)
    length = len(time_s) // _BLOCKS
    blocks = np.arange(len(time_s) - _BLOCKS * length, len(time_s)).reshape(_BLOCKS, length)
    off = np.median(over_m[blocks], axis=1)
    level = np.median((slant_m * np.cos(down_rad))[blocks], axis=1)
    known = ~np.isnan(off)
    if 2 * known.sum() < _BLOCKS:
        return math.nan, math.nan, math.nan
    rate, end = np.polyfit(np.linspace(-1.0, 0.0, _BLOCKS)[known], (-off / level)[known], 1).tolist()
    newest = blocks[-1]
    return end, rate, float(np.median(np.tan(down_rad[newest]) / slant_m[newest]))


def _growing(readings: Readings, span_s: float) -> Readings:
    """Return readings whose errors grow over the last seconds of a span, and not before."""
    end_s = max(readings.sights[-1, 0], readings.ranges[-1, 0])
    sights, ranges = (
        np.column_stack((rows[:, :count], np.maximum(rows[:, 0] - end_s, -span_s)))
        for rows, count in ((readings.sights, 4), (readings.ranges, 2))
    )
    return readings._replace(sights=sights, ranges=ranges)


def _scaled(readings: Readings, factor: float) -> Readings:
    return readings if factor == 1.0 else readings._replace(ranges=readings.ranges * (1.0, factor, 1.0))


def _gain_of_freeing(found: Fit, sigmas: FloatArray, rate: int) -> float:
    """Return about how much less the cost is without the priors of a rate and of its constant, to second order."""
    prior = 1.0 / np.square(sigmas)
    freed = np.isin(np.arange(SHARED), (rate - 2, rate))
    pull = np.where(freed, prior * found.shared, 0.0)  # of the readings, against the prior
    step = np.linalg.solve(found.information + np.diag(np.where(freed, 1e-9, prior)), pull)
    return 0.5 * float(pull @ step + pull @ found.shared)


def _noses_rad(readings: Readings) -> FloatArray:
    """Return where the aircraft's nose pointed (n,) at the times of the ranges."""
    noses_rad: FloatArray = np.interp(
        readings.ranges[:, 0], readings.attitudes[:, 0], np.unwrap(readings.attitudes[:, 3])
    )
    return noses_rad


def _level_m(readings: Readings) -> float:
    """Return the median range over the ground."""
    return float(np.median(readings.ranges[:, 1] * np.cos(_looks(readings)[1])))


def _visits(readings: Readings, inside: npt.NDArray[np.bool_]) -> int:
    """Return how often the laser looked there: how many groups these ranges (n,) form in time."""
    return int((np.diff(readings.ranges[inside, 0]) > _VISIT_S).sum()) + int(inside.any())


def _marked(readings: Readings, inside: npt.NDArray[np.bool_]) -> Readings:
    """Return readings some of whose ranges (n,) are wrong by a share."""
    level_m = readings.ranges[:, 1] * np.cos(_looks(readings)[1])
    return readings._replace(ranges=np.column_stack((readings.ranges[:, :2], inside * level_m)))


def _uneven_bearings(
    readings: Readings, off_m: FloatArray, over_m: FloatArray
) -> Iterator[tuple[WrongBearings, npt.NDArray[np.bool_]]]:
    """Yield at which bearings the ranges may be wrong, with which these are (n,).

    By motion they have to be looked at twice: a target that turns looks like it once. By heights once is enough; the
    share is what these show, else NaN.

    Args:
        readings: of which the ranges are looked at.
        off_m: residuals of these, by the target's motion (n,).
        over_m: how far above its ground they put the target (n,); NaN where that is not known.
    """
    time_s, slant_m, _ = readings.ranges.T
    bearing_rad, down_rad = _looks(readings)
    too_long = -over_m / (slant_m * np.maximum(np.sin(down_rad), _DOWN_MIN))
    angles_rad = [(True, bearing_rad - _noses_rad(readings))] if len(readings.attitudes) else []
    angles_rad.append((False, bearing_rad))
    by = itertools.product(angles_rad, (_DRIFT_S, _GROWS_S), (False, True))
    for (from_nose, angle_rad), lately_s, of_height in by:
        share = too_long if of_height else -off_m / slant_m
        bins, lately = np.floor(np.mod(angle_rad, math.tau) / _BIN_RAD).astype(int), time_s > time_s[-1] - lately_s
        count = np.bincount(bins[lately])
        often = np.flatnonzero(count >= _BIN_COUNT)
        mean = np.bincount(bins[lately], share[lately])[often] / count[often]
        if not len(often) or not np.ptp(mean) >= 0.5 * _WRONG_SHARE:  # medians cost ten times as much
            continue
        medians = {k: float(np.median(share[lately & (bins == k)])) for k in often.tolist()}
        if not max(medians.values()) - min(medians.values()) >= _WRONG_SHARE:
            continue
        middle = 0.5 * (max(medians.values()) + min(medians.values()))
        sides = [[k for k, one in medians.items() if (one > middle) is is_long] for is_long in (True, False)]
        long, short = (abs(float(np.median(too_long[lately & np.isin(bins, side)]))) for side in sides)
        heights_know = min(long, short) < _RIGHT_SHARE * max(long, short)
        # Motion shows that they differ, heights which of them are right; else most are, by the fit.
        wrong = sides[0] if (long > short if heights_know else middle > 0.0) else sides[1]
        inside, visits = lately & np.isin(bins, wrong), 1 if of_height and heights_know else _VISITS
        middle_rad = cmath.phase(sum(cmath.rect(1.0, (k + 0.5) * _BIN_RAD) for k in wrong))
        half_rad = max(abs(wrap_rad((k + 0.5) * _BIN_RAD - middle_rad)) for k in wrong) + 0.5 * _BIN_RAD + _EDGE_RAD
        if half_rad <= _HALF_MAX_RAD and _visits(readings, inside) >= visits:
            by_height = float(np.median(too_long[inside])) if visits == 1 else math.nan
            yield WrongBearings(from_nose, middle_rad, half_rad, by_height), inside


def _residuals_m(times_s: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return the median distance of positions (n, k, 3) from a straight line in time, for each k.

    The line is fitted twice, the second time without the farthest positions: an outlier at either end tilts it.
    """
    weights = np.ones(positions_m.shape[:2])
    for _ in range(2):
        total = weights.sum(axis=0)
        middle_s, middle_m = times_s @ weights / total, np.einsum("nk,nki->ki", weights, positions_m) / total[:, None]
        since_s, centred_m = times_s[:, None] - middle_s, positions_m - middle_m
        weighted_s = weights * since_s
        velocity_m_s = np.einsum("nk,nki->ki", weighted_s, centred_m) / (weighted_s * since_s).sum(axis=0)[:, None]
        off_m2 = ((centred_m - since_s[:, :, None] * velocity_m_s) ** 2).sum(axis=2)
        weights = (off_m2 <= np.quantile(off_m2, _TRIM_SHARE, axis=0)).astype(float)
    distance_m: FloatArray = np.sqrt(np.median(off_m2, axis=0))
    return distance_m
