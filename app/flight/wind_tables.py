"""Value tables for the measured wind, computed by another process while the flight continues.

With a table for another wind, the planner changes its plans several times as often. If the measured wind stays far
from that of every table for a while, a new table is computed outside the control loop. The control step receives an
event when it is ready, so a replay of the journal uses the table from the same moment.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.app.flight.one_task import OneTask
from sidelong.app.planners.planner_kind import PlannerKind
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.snapshot import Phase, Snapshot
from sidelong.mission.core.events import WindPrepared

# Wind speeds are prepared for in steps of this share of the airspeed, and no more of them than that.
_STEP, _AT_MOST = 0.05, 5
_AVERAGED_OVER_S = 30.0


class WindTables:
    """Wind tables of one flight, driven by its snapshots. winds_m_s: wind speeds with a table, in addition to 0.

    put: passes the event that a table is ready; note: reports errors to the operator.
    """

    def __init__(
        self,
        kind: PlannerKind,
        controller: StandoffController,
        winds_m_s: list[float],
        put: Callable[[WindPrepared], object],
        note: Callable[[str], object],
    ) -> None:
        self._kind, self._controller, self._put, self._note = kind, controller, put, note
        self._ready_m_s = [0.0, *winds_m_s]
        self._airspeed_m_s = controller.settings.aircraft.airspeed_m_s
        self._mean_m_s = math.nan
        self._since_s = self._latest_s = 0.0
        self._prepared = 0
        self._making = OneTask()

    def show(self, snapshot: Snapshot) -> None:
        """Take the current wind, and start a table if one is missing."""
        if snapshot.phase is not Phase.WATCHING or snapshot.requirement.sector is not None:
            return
        wind_m_s, now_s = snapshot.wind.speed_m_s, snapshot.time_s
        if math.isnan(self._mean_m_s):
            self._mean_m_s, self._since_s, self._latest_s = wind_m_s, now_s, now_s
        share = min((now_s - self._latest_s) / _AVERAGED_OVER_S, 1.0)
        self._mean_m_s += share * (wind_m_s - self._mean_m_s)
        self._latest_s = now_s
        if now_s - self._since_s < _AVERAGED_OVER_S or self._prepared == _AT_MOST or self._making.is_running:
            return
        step_m_s = _STEP * self._airspeed_m_s
        nearest_m_s = min(self._ready_m_s, key=lambda one: abs(one - self._mean_m_s))
        if abs(nearest_m_s - self._mean_m_s) > 0.75 * step_m_s:
            self._prepared += 1
            speed_m_s = round(round(self._mean_m_s / step_m_s) * step_m_s, 2)
            self._making.begin(lambda: self._make(speed_m_s))

    def stop(self) -> None:
        """Give up what is under way."""
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
