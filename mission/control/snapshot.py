"""Mission status for displays and summaries. Source: docs/watch-endings.md."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.control.sensor_status import SensorStatus
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Requirement, Side, Wind
from sidelong.mission.route.progress import RouteProgress


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


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Everything a display needs, at one moment."""

    time_s: float
    phase: Phase
    side: Side
    aircraft: AircraftState | None
    estimate: TargetEstimate | None
    present: Plan | None
    coming: Plan | None
    decision: Decision | None
    wind: Wind
    moves: int
    uploads: int
    upload_failures: int
    latency_s: float
    mode: str
    sensor_status: SensorStatus
    requirement: Requirement
    radius_m: float
    pan_limit_rad: float
    height_m: float | None  # as a person has changed it; None: as configured
    target: str = ""  # which of a fleet's targets it is to watch
    turn_payload: bool = False  # to that target: it looks at another one
    over: str = ""  # why the mission was yielded or has ended
    separation: str = ""  # which other aircraft is too near, in words
    health: tuple[InputReport, ...] = ()
    unknown: str = ""
    """Why it is not known how well the target is watched; empty while it is known."""
    position_age_s: float = 0.0
    """Time since the latest position; by this computer's clock while the vehicle's stands still."""
    route: RouteProgress | None = None
    """The target's progress along its route; None without a route."""

    @property
    def impaired_inputs(self) -> tuple[str, ...]:
        """Each input that is not ok, in words: its state and for how long. The link has indicators of its own."""
        now_s = self.time_s + self.position_age_s
        return tuple(
            f"{one.input} {one.state} for {max(now_s - one.since_s, 0.0):.0f} s"
            for one in self.health
            if one.state is not InputState.OK and one.input is not Input.LINK
        )
