"""Changes of the mission in flight, by an operator or by the gimbal's report.

They are checked like a configuration, and prepared outside the control loop. A missing value table is computed by
another process. The control loop does not wait for it: the change reaches the control step once the table is ready.

With a table for another wind, the planner changes its plans several times as often. If the measured wind stays far
from that of every table for a while, a new table is computed. A replay of the journal uses it from the same moment.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from sidelong.app.assembly import winds_m_s
from sidelong.app.config import Config, check_flyable, with_values
from sidelong.app.errors import InputError
from sidelong.app.flight.streams import OneTask
from sidelong.app.payload.session import contradiction, usable_pan_limit_deg
from sidelong.app.planners.planner_kind import PlannerKind
from sidelong.app.planners.registry import planner_by_name
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.mission_change import describe_change
from sidelong.mission.control.planning import WINDS_MAX
from sidelong.mission.control.present import Phase, Present
from sidelong.mission.core.events import Announce, MissionChange, WindPrepared

GIMBAL = "gimbal"


@dataclass(eq=False)
class MissionChanges:
    _config: Config
    _controller: StandoffController
    _now_s: Callable[[], float]
    _put: Callable[[MissionChange], object]
    _say: Callable[[Announce], object]
    _making_ready: OneTask = field(default_factory=OneTask)

    @property
    def is_busy(self) -> bool:
        """Whether tables for a change are being computed."""
        return self._making_ready.is_running

    def take(self, change: MissionChange) -> None:
        """Check a change, prepare it in the background and pass it to the core, or announce why it is refused."""
        height_alone = replace(change, height_m=None) == MissionChange(change.time_s, who=change.who)
        if self.is_busy and not height_alone:
            self._announce(
                f"{describe_change(change)} refused: the change before is still being made ready; ask again"
            )
            return
        try:
            changed = self._checked(change)
        except InputError as error:
            self._announce(f"{describe_change(change)} refused: {error}")
            return
        if height_alone:  # needs nothing to be made ready
            self._apply(change, changed)
        else:
            self._making_ready.begin(lambda: self._carry_out(change, changed))

    def stop(self) -> None:
        """Give up the change that is being prepared."""
        self._making_ready.stop()

    def _checked(self, change: MissionChange) -> Config:
        """Return the configuration as changed. Raises InputError with what keeps it from being flown."""
        keys = {
            "aircraft": ("radius_m", "height_m", "pan_limit_deg"),
            "requirement": ("range_min_m", "range_max_m", "side"),
        }
        values = {section: {key: getattr(change, key) for key in own} for section, own in keys.items()}
        changed = with_values(self._config, values, "change")
        check_flyable(changed)
        objection = self._controller.objection(change)
        if objection is not None:
            raise InputError(f"{objection}.")
        return changed

    async def _carry_out(self, change: MissionChange, changed: Config) -> None:
        kind, aircraft = planner_by_name(changed.planner.name), changed.aircraft.aircraft()
        try:
            winds = [*winds_m_s(changed), *self._controller.planning.prepared_winds_m_s]
            await kind.make_ready(aircraft, changed.requirement.requirement(), winds)
            changed = self._checked(change)  # the height may have been changed in the meantime
        except (OSError, InputError) as error:
            self._announce(f"{describe_change(change)} refused: {error}")
            return
        self._apply(change, changed)

    def _apply(self, change: MissionChange, changed: Config) -> None:
        self._config = changed
        self._put(replace(change, time_s=self._now_s()))

    def _announce(self, text: str) -> None:
        self._say(Announce(self._now_s(), "operator", text))


@dataclass(eq=False)
class PanLimitInput:
    _configured_deg: float | None  # aircraft.pan_limit_deg, which has precedence
    _reported: Callable[[], tuple[float, float] | None]  # least and greatest yaw off the nose, rad
    _changes: MissionChanges
    _note: Callable[[str], object]
    _is_settled: bool = False

    def show(self, snapshot: Present) -> None:
        """Plan for the pan limit that the gimbal reports, once, unless the configuration has one."""
        if snapshot.phase is Phase.YIELDED:
            self._is_settled = snapshot.airframe.has_pan_limit  # a change on its way is refused
        if self._is_settled or snapshot.phase is not Phase.WATCHING or self._changes.is_busy:
            return
        reported_rad = self._reported()
        if reported_rad is None:
            return
        self._is_settled, limit_deg = True, usable_pan_limit_deg(reported_rad)
        if limit_deg is None:
            return
        if self._configured_deg is None:
            self._note(f"the gimbal pans {limit_deg:g} degrees to each side: a plan for that is being prepared")
            self._changes.take(MissionChange(snapshot.time_s, who=GIMBAL, pan_limit_deg=limit_deg))
        elif words := contradiction(self._configured_deg, reported_rad):
            self._note(words)


_STEP = 0.05  # between two wind speeds that are prepared for, as a share of the airspeed
_AVERAGED_OVER_S = 30.0


@dataclass(eq=False)
class WindTables:
    """Wind tables of one flight, driven by its snapshots."""

    _kind: PlannerKind
    _controller: StandoffController
    _winds_m_s: list[float]  # wind speeds with a table, in addition to 0
    _put: Callable[[WindPrepared], object]
    _note: Callable[[str], object]

    def __post_init__(self) -> None:
        self._ready_m_s, self._mean_m_s = [0.0, *self._winds_m_s], math.nan
        self._since_s = self._latest_s = 0.0
        self._prepared, self._making = 0, OneTask()

    def show(self, snapshot: Present) -> None:
        """Prepare a value table, in another process, for a mean wind that none of the present ones fits."""
        if snapshot.phase is not Phase.WATCHING or snapshot.requirement.sector is not None:
            return
        wind_m_s, now_s = snapshot.wind.speed_m_s, snapshot.time_s
        if math.isnan(self._mean_m_s):
            self._mean_m_s, self._since_s, self._latest_s = wind_m_s, now_s, now_s
        share = min((now_s - self._latest_s) / _AVERAGED_OVER_S, 1.0)
        self._mean_m_s += share * (wind_m_s - self._mean_m_s)
        self._latest_s = now_s
        if now_s - self._since_s < _AVERAGED_OVER_S or self._prepared == WINDS_MAX or self._making.is_running:
            return
        step_m_s = _STEP * self._controller.settings.aircraft.airspeed_m_s
        nearest_m_s = min(self._ready_m_s, key=lambda ready_m_s: abs(ready_m_s - self._mean_m_s))
        if abs(nearest_m_s - self._mean_m_s) > 0.75 * step_m_s:
            self._prepared += 1
            speed_m_s = round(round(self._mean_m_s / step_m_s) * step_m_s, 2)
            self._making.begin(lambda: self._make(speed_m_s))

    def stop(self) -> None:
        self._making.stop()

    async def _make(self, speed_m_s: float) -> None:
        settings, made_for = self._controller.settings, None
        try:
            while made_for is not settings:  # radius or band may change in the meantime
                made_for = settings
                await self._kind.make_ready(made_for.aircraft, made_for.requirement, [speed_m_s])
                settings = self._controller.settings
        except OSError as error:
            self._note(f"no table for a wind of {speed_m_s:g} m/s: {str(error) or 'it took too long'}")
            return
        self._ready_m_s.append(speed_m_s)
        self._put(WindPrepared(self._latest_s, speed_m_s))
