"""What goes into the control step and what comes out of it.

Events and commands are plain frozen values: the journal writes both, and a replay feeds the events again
and must get the same commands. ``time_s`` is on the vehicle's clock.

Source: docs/decisions/0002-pure-step-and-replay.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    TargetFixReading,
)
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Side, Wind


@dataclass(frozen=True, slots=True)
class Timed:
    """What happens at ``time_s`` of the vehicle's clock."""

    time_s: float


@dataclass(frozen=True, slots=True)
class WindReported(Timed):
    """The autopilot's own wind estimate: where the air moves to, over the ground."""

    east_m_s: float
    north_m_s: float


@dataclass(frozen=True, slots=True)
class WindPrepared(Timed):
    """The value tables for winds of this speed are in memory: from now on the planner may use them."""

    speed_m_s: float


@dataclass(frozen=True, slots=True)
class RouteGiven(Timed):
    """The route that the target is expected to follow, as way points in the local plane; without any, none.

    lap: the last way point connects to the first one. tolerance_m: one standard deviation of the target's lateral
    offset. speed_m_s: expected along the route; None: unknown. direction: in which the target follows the way points.
    """

    east_m: tuple[float, ...]
    north_m: tuple[float, ...]
    lap: bool
    tolerance_m: float
    speed_m_s: float | None
    direction: Literal["forward", "backward", "either"]


@dataclass(frozen=True, slots=True)
class NavigationReported(Timed):
    """The state of the vehicle's own position by GPS or EKF: ``fault`` in words, '' while there is none."""

    source: Literal["GPS", "EKF"]
    fault: str = ""


@dataclass(frozen=True, slots=True)
class HomeReported(Timed):
    """Where the autopilot has its home, in the local plane."""

    east_m: float
    north_m: float


@dataclass(frozen=True, slots=True)
class BankLimitReported(Timed):
    """The autopilot's bank limit, as its parameters have it now."""

    bank_rad: float


@dataclass(frozen=True, slots=True)
class ModeReported(Timed):
    """A heartbeat of the autopilot; failsafe: why it is in one, in its own words, '' if it is in none."""

    mode: str
    armed: bool
    failsafe: str = ""


@dataclass(frozen=True, slots=True)
class ControlAcquired(Timed):
    """The aircraft flies ``circle`` in ``mode``, by our command: from now on the step may move the circle.

    commanded: the circle as it was commanded, where that differs.
    """

    circle: Circle
    mode: str
    commanded: Circle | None = None


@dataclass(frozen=True, slots=True)
class PlanStatus(Timed):
    """How far the autopilot has followed plan ``number``; detail: the reason of a failure, in words.

    ready: the autopilot holds the plan and still flies the previous path. departed: it flies the plan. failed: it
    does neither, and flies the previous path; a failed departure may still be followed by departed. unconfirmed: the
    plan was commanded, but not confirmed; departed or failed follows. by_command, with ready: no upload was needed;
    departed follows when the command is obeyed.
    """

    number: int
    stage: Literal["ready", "departed", "failed", "unconfirmed"]
    detail: str = ""
    by_command: bool = False


@dataclass(frozen=True, slots=True)
class LinkReported(Timed):
    """The link to the autopilot was lost (no heartbeat) or is back."""

    connected: bool


@dataclass(frozen=True, slots=True)
class ClockTick(Timed):
    """A second of this computer's clock, link_s, has passed: the vehicle's own may stand still."""

    link_s: float


@dataclass(frozen=True, slots=True)
class RoundTripReported(Timed):
    """A request to the vehicle and its answer now take ``round_trip_s`` of the vehicle's clock."""

    round_trip_s: float


@dataclass(frozen=True, slots=True)
class YieldRequested(Timed):
    """An event outside the mode shows that another operator flies now (RC takeover, a foreign mission)."""

    reason: str


@dataclass(frozen=True, slots=True)
class OperatorRequest(Timed):
    """A request of the operator; who: the operator's name on the page, '' if it came from elsewhere."""

    action: Literal["hold", "resume", "side", "confirm", "end"]
    side: Side | None = None
    who: str = ""


@dataclass(frozen=True, slots=True)
class MissionChange(Timed):
    """A change of what is flown and asked for, by a person or by the gimbal's report; None leaves a value as it is.

    It was checked as a configuration is, and what the planner needs for it is at hand. side: left, right, either, or
    bearings from the target such as 120-200. height_m is above what the configured one is above. pan_limit_deg: what
    the gimbal reports, degrees to each side of the nose.
    """

    radius_m: float | None = None
    range_min_m: float | None = None
    range_max_m: float | None = None
    height_m: float | None = None
    side: str | None = None
    who: str = ""
    pan_limit_deg: float | None = None


@dataclass(frozen=True, slots=True)
class AlarmReported(Timed):
    """An alarm of :mod:`sidelong.mission.control.alarms` was raised or cleared, or a person acknowledged it.

    text: what is wrong and what to do. who: as of ``OperatorRequest``.
    """

    key: str
    stage: Literal["raised", "cleared", "acknowledged"]
    text: str = ""
    who: str = ""


@dataclass(frozen=True, slots=True)
class BatteryReported(Timed):
    """The battery's charge, the flight time until its reserve by the observed consumption, and the time to home.

    text: all that is known of it, in words. rejected: whether the charge is not to be acted on.
    """

    percent: float
    left_s: float
    home_s: float
    text: str = ""
    rejected: bool = False


@dataclass(frozen=True, slots=True)
class TrafficReported(Timed):
    """All aircraft near a single flight, by their latest reports: whenever one reports, once a second at most."""

    aircraft: tuple[Neighbour, ...]


Event = (
    PositionReading
    | AttitudeReading
    | RangeReading
    | GimbalReading
    | TargetFixReading
    | WindReported
    | WindPrepared
    | RouteGiven
    | NavigationReported
    | HomeReported
    | BankLimitReported
    | ModeReported
    | ControlAcquired
    | PlanStatus
    | LinkReported
    | ClockTick
    | RoundTripReported
    | YieldRequested
    | OperatorRequest
    | MissionChange
    | AlarmReported
    | BatteryReported
    | TrafficReported
    | FleetAdvice
    | NeighbourPlanned
)


@dataclass(frozen=True, slots=True, eq=False)
class UploadPlan:
    """Bring plan ``number`` to the autopilot without flying it yet; report ready or failed.

    commanded: the plan's circle, corrected so that the autopilot flies the required one. wind: for which waypoints
    are laid out. home_m: of the autopilot's present home above the home that the plan's heights count from.
    """

    time_s: float
    number: int
    plan: Plan
    commanded: Circle
    present: Plan
    wind: Wind
    reason: str
    home_m: float = 0.0


@dataclass(frozen=True, slots=True)
class ActivatePlan(Timed):
    """Fly plan ``number`` now; report departed or failed."""

    number: int


@dataclass(frozen=True, slots=True, eq=False)
class DecisionRecord:
    """A decision of the planner with the costs behind it, for the journal and for comparisons."""

    time_s: float
    moves: bool
    reason: str
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Announce(Timed):
    """Announce something to the operator in plain words; ``kind`` lets a display colour or filter it."""

    kind: Literal[
        "decision",
        "track",
        "link",
        "yield",
        "plan",
        "operator",
        "refused",
        "end",
        "position",
        "sensor",
        "takeover",
        "alarm",
        "clear",
        "health",
        "route",
    ]
    text: str


@dataclass(frozen=True, slots=True)
class HealthChanged(Timed):
    """The state of an input has changed; text: what has happened and what to do, in one sentence.

    lasted_s: of the previous state; 0 if there was none.
    """

    input: Input
    state: InputState
    text: str
    lasted_s: float = 0.0

    @property
    def announcement(self) -> Announce:
        """The change as an announcement to the operator."""
        return Announce(self.time_s, "link" if self.input is Input.LINK else "health", self.text)


@dataclass(frozen=True, slots=True)
class Yield(Timed):
    """Another operator flies: send nothing to the autopilot any more."""

    reason: str

    @property
    def announcement(self) -> Announce:
        """What a record shows of it."""
        return Announce(self.time_s, "yield", f"yielded: {self.reason}")


@dataclass(frozen=True, slots=True)
class End(Timed):
    """The mission is over: stay on the circle (hold) or fly home (return)."""

    action: Literal["hold", "return"]
    reason: str

    @property
    def announcement(self) -> Announce:
        """What a record shows of it."""
        return Announce(self.time_s, "end", f"ended: {self.reason}")


Command = UploadPlan | ActivatePlan | Yield | End
"""What the exchange with the autopilot has to do."""

StepOutput = Command | DecisionRecord | Announce | HealthChanged
"""What one control step puts out: commands, and records of it for the journal and the operator."""
