"""What an operator sees, in one record. Source: docs/watch-endings.md; docs/health.md#inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.readings import AttitudeReading
from sidelong.mission.core.fleet import Neighbour
from sidelong.mission.core.inputs import UNFULFILLED, Input, InputReport, InputState
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.route.route import RouteProgress

_STANDING_M_S = 0.3  # a slower target's course is noise
_EDGE_RAD = math.radians(3.0)  # of the allowed angles: the target's course is hardly known better


class Phase(StrEnum):
    """Where the mission stands."""

    WAITING = "waiting"  # not taken over yet
    WATCHING = "watching"
    HOLDING = "holding"  # by an operator's wish
    YIELDED = "yielded"
    ENDED = "ended"

    @property
    def in_control(self) -> bool:
        """Whether sidelong controls the aircraft."""
        return self in (Phase.WATCHING, Phase.HOLDING)


@dataclass(frozen=True, slots=True)
class Alarm:
    """One active alarm."""

    key: str  # such as ``target``
    text: str  # the present fault
    advice: str  # recommended action
    since_s: float
    countdown_s: float | None = None  # until the aircraft acts automatically; None: it does not
    acknowledged: bool = False


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """What no decision reads, as the autopilot and the link report it; None: not reported."""

    battery_percent: int | None = None
    battery_v: float | None = None
    gps: str | None = None  # the fix in words
    gps_good: bool | None = None
    link_percent: int | None = None  # of the frames sent to this station that arrived over the link in use
    round_trip_s: float | None = None
    endurance_s: float | None = None  # until the battery's reserve
    home_s: float | None = None  # flight time to home
    home_m: tuple[float, float] | None = None  # east and north
    silent_s: float = 0.0  # without a message of the aircraft, by this computer's clock
    alarms: tuple[Alarm, ...] = ()
    battery_a: float | None = None
    reserve_percent: float | None = None
    battery_doubt: str = ""  # why its reported charge is not acted on, in words; '' if it is


def breach_in(health: tuple[InputReport, ...]) -> str:
    """Return the first of the health reports by which the requirement is not fulfilled, in words; '' if none."""
    bad = (one.text for one in health if one.input in UNFULFILLED and one.state is InputState.INCONSISTENT)
    return next(bad, "")


@dataclass(frozen=True, slots=True)
class Present:
    """The state of the mission at one moment. Times are of the vehicle's clock, positions of the local plane.

    Band, side and angles are by the estimate, with the definitions of :mod:`sidelong.app.analysis.score`.
    """

    time_s: float
    phase: Phase
    requirement: Requirement
    aircraft: AircraftState | None
    estimate: TargetEstimate | None
    course_rad: float | None  # the target's course made good; None until it has moved far enough
    present_course_rad: float | None  # None until it has moved
    plan: Plan | None  # that is flown
    coming: Plan | None  # on its way to the autopilot
    decision: Decision | None
    wind: Wind
    moves: int
    uploads: int
    upload_failures: int
    latency_s: float
    mode: str
    height_m: float  # the aircraft's, above home; NaN: unknown
    attitude: AttitudeReading | None  # the latest one of the aircraft; None before the first
    airframe: Aircraft  # its limits, as plans keep them now
    height_asked_m: float | None  # as an operator has changed it; None: as configured
    range_s: float  # time of the latest reading of the laser in use, -inf before the first
    gimbal_s: float  # the same of the gimbal
    nis: float  # normalised innovation squared of the latest sighting that was compared, NaN before the first
    sightings: int
    rejected: int
    delays: Delays | None
    give_up_after_s: float
    give_up_action: str
    connected: bool = True
    target: str = ""  # which of a fleet's targets is to be watched
    turn_payload: bool = False  # the payload looks at another target
    over: str = ""  # why the mission was yielded or has ended
    separation: str = ""  # which other aircraft is too near, in words
    health: tuple[InputReport, ...] = ()
    unknown: str = ""  # why it is not known how well the target is watched; '' while it is known
    position_age_s: float = 0.0  # of the latest position, by this computer's clock while the vehicle's stands still
    route: RouteProgress | None = None
    orders: str = ""  # why plans do not get through to the autopilot; '' while they do
    home_m: tuple[float, float] | None = None  # the autopilot's, east and north; None: not reported
    home_moved_m: tuple[float, float] = (0.0, 0.0)  # how far it is from that at the takeover, and how far above it
    other_object: str = ""  # why the payload may follow another object; '' if it follows the target
    vehicle: VehicleStatus | None = None  # None where there is no vehicle, as in a replay
    traffic: tuple[Neighbour, ...] = ()  # foreign aircraft near the own one
    waypoints_m: tuple[tuple[float, float], ...] = ()  # ahead, of the mission flown or on its way: east and north

    @property
    def side(self) -> Side:
        """The required side."""
        return self.requirement.side

    @property
    def impaired_inputs(self) -> tuple[str, ...]:
        """Each input that is not ok, in words: its state and for how long. The link has indicators of its own."""
        now_s = self.time_s + self.position_age_s
        return tuple(
            f"{report.input} {report.state} for {max(now_s - report.since_s, 0.0):.0f} s"
            for report in self.health
            if report.state is not InputState.OK and report.input is not Input.LINK
        )

    @property
    def from_target_m(self) -> tuple[float, float] | None:
        """East and north of the aircraft from the target; None where one of them is unknown."""
        if self.aircraft is None or self.estimate is None:
            return None
        east_m, north_m = self.estimate.position_m(self.time_s)
        return self.aircraft.east_m - east_m, self.aircraft.north_m - north_m

    @property
    def range_m(self) -> float | None:
        """Horizontal distance to the estimated target, m; None: no estimate, or no position of the aircraft."""
        return None if self.from_target_m is None else math.hypot(*self.from_target_m)

    @property
    def stands(self) -> bool:
        """Whether the target has made no course good, and its speed is not known to differ from none (2 sigma)."""
        estimate = self.estimate
        if estimate is None or self.course_rad is not None:
            return False
        sigma_m_s = math.sqrt(max(float(estimate.covariance[2, 2]), float(estimate.covariance[3, 3]), 0.0))
        return estimate.speed_m_s < max(_STANDING_M_S, 2.0 * sigma_m_s)

    @property
    def watch_course_rad(self) -> float | None:
        """The target's course that defines the sides: the present one until it has made one good; None: it stands."""
        if self.stands:
            return None
        return self.present_course_rad if self.course_rad is None else self.course_rad

    @property
    def angle_rad(self) -> float | None:
        """Bearing of the aircraft from the target, less that of the middle of the allowed ones; None: unknown."""
        course_rad, from_target_m = self.watch_course_rad, self.from_target_m
        middle_rad = self.requirement.middle_rad(math.nan if course_rad is None else course_rad)
        if from_target_m is None or math.isnan(middle_rad):
            return None
        return wrap_rad(math.atan2(*from_target_m) - middle_rad)

    @property
    def beyond_side_rad(self) -> float:
        """How far the observation angle is beyond the allowed one, negative: within it; NaN: unknown."""
        angle_rad = self.angle_rad
        return math.nan if angle_rad is None else abs(angle_rad) - self.requirement.allowed_rad

    @property
    def is_side_known(self) -> bool:
        """Whether the target has made good a course, and the aircraft is not at the edge; or either side will do."""
        requirement = self.requirement
        made_good = self.course_rad is not None or requirement.sector is not None
        known = made_good and abs(self.beyond_side_rad) >= _EDGE_RAD
        return self.from_target_m is not None and (known or requirement.either_side)

    @property
    def breach(self) -> str:
        """What the aircraft itself breaches, in words: the requirement is then not fulfilled; '' if nothing."""
        return breach_in(self.health)

    @property
    def _is_judged(self) -> bool:
        """Whether band and side are known: not while an input or the link fails, or the payload looks elsewhere."""
        if self.estimate is None or self.estimate.quality is TrackQuality.LOST:
            return False
        return self.connected and not (self.unknown or self.turn_payload)

    @property
    def in_band(self) -> bool | None:
        """Whether the range is in the required band, and the aircraft breaches no limit of its own; None: unknown."""
        range_m = self.range_m
        if range_m is None or not self._is_judged:
            return None
        return not self.breach and self.requirement.range_min_m <= range_m <= self.requirement.range_max_m

    @property
    def on_side(self) -> bool | None:
        """Whether the aircraft is on the required side, and breaches no limit of its own; None: unknown."""
        if not (self._is_judged and self.is_side_known):
            return None
        return not self.breach and (self.requirement.either_side or self.beyond_side_rad <= 0.0)

    @property
    def unseen_s(self) -> float | None:
        """Time since the last accepted sighting; None: never, or the payload looks at another target."""
        return None if self.estimate is None or self.turn_payload else self.time_s - self.estimate.last_sighting_s

    @property
    def is_lost(self) -> bool:
        """Whether the track is lost."""
        return self.unseen_s is not None and self.estimate is not None and self.estimate.quality is TrackQuality.LOST

    @property
    def gives_up_in_s(self) -> float | None:
        """Time until the mission ends because the target is not seen; None: it does not."""
        unseen_s = self.unseen_s
        return self.give_up_after_s - unseen_s if unseen_s is not None and self.phase is Phase.WATCHING else None
