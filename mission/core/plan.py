"""What the aircraft is to fly, how high, and the contract of a planner.

Source: docs/how-to/own-planner.md; docs/how-to/hills.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol, runtime_checkable

from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.numbers import convert_to_floats, require_type, value_type
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.core.sight import Sight

_SAME_HEIGHT_M = 10.0  # an autopilot is seldom farther from what it holds


@value_type(frozen=True, slots=True)
class AircraftState:
    """The aircraft over the ground at ``time_s``. curvature_per_m: of its flown line, positive to the right."""

    time_s: float
    east_m: float
    north_m: float
    course_rad: float
    ground_speed_m_s: float
    curvature_per_m: float

    def __post_init__(self) -> None:
        convert_to_floats(self, "time_s", "east_m", "north_m", "course_rad", "ground_speed_m_s", "curvature_per_m")


@dataclass(frozen=True, slots=True)
class HeightProfile:
    """Heights above home along a plan: ``from_m`` at the departure, then by ``slope`` to ``to_m``, the circle's.

    slope is metres of height for each metre flown, positive both for a climb and for a descent.
    """

    from_m: float
    to_m: float
    slope: float

    def __post_init__(self) -> None:
        convert_to_floats(self, "from_m", "to_m", "slope")

    def at_m(self, arc_m: float) -> float:
        """Return the height at a point of the plan, m."""
        change_m = self.slope * arc_m
        if self.to_m >= self.from_m:
            return min(self.from_m + change_m, self.to_m)
        return max(self.from_m - change_m, self.to_m)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Leave the present path at ``departure_s`` on ``transition``, then fly ``circle`` indefinitely.

    transition is None for a plan that is only a circle (the first one, or the circle already flown). heights is
    None where all is flown at the one configured height. precise: the transition is to be flown as closely as
    waypoints allow, because the pan of the gimbal depends on the course.
    """

    circle: Circle
    transition: Path | None = None
    departure_s: float = 0.0
    heights: HeightProfile | None = None
    precise: bool = False

    def __post_init__(self) -> None:
        convert_to_floats(self, "departure_s")
        require_type(self, "circle", Circle)
        require_type(self, "transition", Path, type(None))
        require_type(self, "heights", HeightProfile, type(None))

    @property
    def transition_m(self) -> float:
        """Length of the transition, m; 0 where there is none."""
        return 0.0 if self.transition is None else self.transition.length_m

    def circle_height_m(self, configured_m: float) -> float:
        """Return the height of the circle above home: the configured one for a plan without heights of its own."""
        return configured_m if self.heights is None else self.heights.to_m


class Flown(NamedTuple):
    """What is flown while a plan is made or checked; None: not known yet. target_m: east and north."""

    aircraft: AircraftState | None = None
    height_m: float | None = None  # above home
    present: Plan | None = None  # None before the takeover
    target_m: tuple[float, float] | None = None
    wind: Wind = Wind()
    airspeed_m_s: float = 1.0


def settled_height_m(height_m: float, plan: Plan | None) -> float:
    """Return an aircraft's height above home, m: exactly that of its plan's circle, once it is close to that."""
    if plan is None or plan.heights is None or abs(height_m - plan.heights.to_m) > _SAME_HEIGHT_M:
        return height_m
    return plan.heights.to_m


@value_type(frozen=True, slots=True, eq=False)
class Decision:
    """What a planner decided at ``time_s``: a new plan, or None to fly on as it is, and why in plain words.

    ``values`` holds the numbers behind the decision, for the journal and for replays that compare.
    """

    time_s: float
    plan: Plan | None
    reason: str
    values: Mapping[str, float] = field(default_factory=dict)


class Planner(Protocol):
    """Decides, from what is known now, whether to fly another line. Deterministic; may keep state of its own."""

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Return a new plan, or None to continue, at ``aircraft.time_s`` while ``present`` is flown, with the reason.

        Args:
            latency_s: Time that a new plan takes to reach the autopilot, s: it departs no earlier than after it.
        """


@runtime_checkable
class WindPlanner(Planner, Protocol):
    """A planner that knows winds of some speeds better than others."""

    def prepare(self, wind_speed_m_s: float) -> None:
        """Use the available tables for winds of this speed from the next decision on."""


@runtime_checkable
class PanLimitPlanner(Planner, Protocol):
    """A planner that can keep the target within the pan limits of a gimbal."""

    @property
    def plans_pan_limits(self) -> bool:
        """Whether it keeps the target within the pan limits of the present requirement."""


class PlanCheck(Protocol):
    """Fences, ground and other aircraft, as planners meet them."""

    def cleared(self, plan: Plan) -> Plan | str:
        """Return a plan as it can be flown, with its heights, or in words why it cannot be."""

    def sight(self, east_m: float, north_m: float, velocity_east_m_s: float, velocity_north_m_s: float) -> Sight:
        """Return what the ground hides of a target."""


PlannerFactory = Callable[[Aircraft, Requirement], Planner]
CheckedPlannerFactory = Callable[[Aircraft, Requirement, PlanCheck], Planner]


# The share of the rates that is counted on: in a tailwind the ground comes sooner.
RATE_RESERVE = 0.7


class Heights(Protocol):
    """Gives plans their heights, m above home."""

    def levelled(self, plan: Plan, flown_m: float | None, target_m: tuple[float, float] | None = None) -> Plan | str:
        """Return a plan with its heights above home, or in words why there are none.

        Args:
            flown_m: Present height above home, m; None before the first circle.
            target_m: Target's position (east, north), m.
        """

    def at(self, height_m: float) -> Heights:
        """Return the same rules for another height, above the reference of the configured one."""


@dataclass(frozen=True, slots=True)
class ClimbRates:
    """What the aircraft reaches: airspeed, climb and descent, m/s."""

    airspeed_m_s: float
    climb_m_s: float = 3.0
    descent_m_s: float = 2.0

    def slope(self, *, climbs: bool) -> float:
        """Return the usable change of height per metre flown."""
        return RATE_RESERVE * (self.climb_m_s if climbs else self.descent_m_s) / self.airspeed_m_s

    def profile(self, from_m: float, to_m: float) -> HeightProfile:
        """Return the heights on the way from one height to another."""
        return HeightProfile(from_m, to_m, self.slope(climbs=to_m >= from_m))


@dataclass(frozen=True, slots=True)
class OneHeight:
    """``Heights`` over flat ground. height_m None: the configured one, which plans do not carry."""

    rates: ClimbRates
    height_m: float | None = None

    def levelled(self, plan: Plan, flown_m: float | None, _target_m: tuple[float, float] | None = None) -> Plan:
        """See :class:`Heights`."""
        if self.height_m is None:
            return plan
        return replace(plan, heights=self.rates.profile(self.height_m if flown_m is None else flown_m, self.height_m))

    def at(self, height_m: float) -> OneHeight:
        """See :class:`Heights`."""
        return OneHeight(self.rates, height_m)
