"""The pan limits that a gimbal reports become those of the plan: a change like an operator's."""

from __future__ import annotations

import math
from collections.abc import Callable

from sidelong.app.flight.changes import MissionChanges
from sidelong.app.payload.pan_limits import contradiction, usable_pan_limit_deg
from sidelong.mission.control.snapshot import Phase, Snapshot
from sidelong.mission.core.events import MissionChange

GIMBAL = "gimbal"


class PanLimitInput:
    """Pan limits of one flight, driven by its snapshots.

    Args:
        configured_deg: ``aircraft.pan_limit_deg``, which has precedence; None: not configured.
        reported: Returns the least and the greatest yaw off the nose, rad; None while nothing is reported.
        changes: Prepares the plan for them.
        note: Receives what is done, and where the configuration contradicts the gimbal.
    """

    def __init__(
        self,
        configured_deg: float | None,
        reported: Callable[[], tuple[float, float] | None],
        changes: MissionChanges,
        note: Callable[[str], object],
    ) -> None:
        self._configured_deg, self._reported, self._changes, self._note = configured_deg, reported, changes, note
        self._is_settled = False

    def show(self, snapshot: Snapshot) -> None:
        """Plan for the limits, once they are known and the target is watched."""
        if snapshot.phase is Phase.YIELDED:
            self._is_settled = snapshot.pan_limit_rad < math.pi  # a change on its way is refused
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
