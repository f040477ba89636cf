"""Raises and clears the alarms of a flight, and watches over its battery.

Each change goes through the control loop as an event: so it is in the journal, and on all displays. A ground station
gets the text of a raised alarm as STATUSTEXT.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import replace

from sidelong.app.analysis.present import PresentWatch
from sidelong.app.config import Config
from sidelong.app.link.queries import VehicleStatus
from sidelong.estimators.estimate import TrackQuality
from sidelong.mission.control.alarms import Alarm, Alarms, Situation, battery_is_low
from sidelong.mission.control.endurance import Endurance, time_to_s
from sidelong.mission.control.snapshot import Phase, Snapshot
from sidelong.mission.core.events import AlarmReported, BatteryReported

_LOOK_EVERY_S = 0.5
_STATUS_EVERY_S = 0.2  # of the wall clock: a fast simulation looks more often
_BATTERY_EVERY_S, _LOW_BATTERY_EVERY_S = 10.0, 1.0  # the controller needs more than one report to fly home
_TEXT_EVERY_S = 5.0


class AlarmWatch:
    """An ``Observer`` that judges what it is shown.

    Args:
        config: The mission.
        home_m: Home in the local plane, east and north.
        status: Returns the vehicle's status as received last.
        put: Passes an event on to the control loop.
        send: Sends a text to the ground station.
        clock_s: The wall clock.
    """

    def __init__(
        self,
        config: Config,
        home_m: tuple[float, float],
        status: Callable[[], VehicleStatus],
        put: Callable[[AlarmReported | BatteryReported], object],
        send: Callable[[str], object],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._config, self._home_m, self._status = config, home_m, status
        self._put, self._send, self._clock_s = put, send, clock_s
        self._alarms, self._present = Alarms(), PresentWatch()
        self._endurance = Endurance(config.planner.battery_reserve_percent)
        self._snapshot: Snapshot | None = None
        self._received_at_s = clock_s()
        self._known: VehicleStatus | None = None
        self._known_at_s = -math.inf
        self._looked_at_s = clock_s()
        self._looked_s = self._reported_s = self._sent_s = -math.inf
        self.left_s: float | None = None
        self.home_s: float | None = None

    @property
    def active(self) -> tuple[Alarm, ...]:
        """The alarms that are raised."""
        return self._alarms.active

    def describe(self, status: VehicleStatus) -> VehicleStatus:
        """Return the vehicle's status with its alarms and its endurance."""
        return replace(status, alarms=self.active, endurance_s=self.left_s, home_s=self.home_s, home_m=self._home_m)

    def acknowledge(self, wish: AlarmReported) -> None:
        """Take an operator's acknowledgement."""
        if self._alarms.acknowledge(wish.key):
            self._put(wish)

    async def run(self) -> None:
        """Check also while the vehicle's clock does not advance, until cancelled."""
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            if self._snapshot is not None and self._clock_s() >= self._looked_at_s + _LOOK_EVERY_S:
                self._look(self._snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Take what is flown; cheap but for once in half a second."""
        before, self._snapshot = self._snapshot, snapshot
        if before is None or snapshot.time_s != before.time_s:
            self._received_at_s = self._clock_s()
        link_changed = before is None or snapshot.sensor_status.connected != before.sensor_status.connected
        if link_changed or snapshot.time_s >= self._looked_s + _LOOK_EVERY_S:
            self._look(snapshot)

    def _look(self, snapshot: Snapshot) -> None:
        self._looked_s, self._looked_at_s = snapshot.time_s, self._clock_s()
        if not math.isfinite(snapshot.time_s):
            return
        if self._known is None or self._clock_s() >= self._known_at_s + _STATUS_EVERY_S:
            self._known, self._known_at_s = self._status(), self._clock_s()
        status = self._known
        self._watch_battery(snapshot, status)
        raised, cleared = self._alarms.update(self._situation(snapshot, status))
        for alarm in cleared:
            self._put(AlarmReported(snapshot.time_s, alarm.key, "cleared", alarm.text))
        for alarm in raised:
            self._put(AlarmReported(snapshot.time_s, alarm.key, "raised", f"{alarm.text}: {alarm.advice}"))
        if raised and snapshot.phase.in_control and snapshot.time_s >= self._sent_s + _TEXT_EVERY_S:
            self._sent_s = snapshot.time_s
            self._send(f"sidelong: {raised[0].text}")

    def _watch_battery(self, snapshot: Snapshot, status: VehicleStatus) -> None:
        if status.battery_percent is None or snapshot.aircraft is None:
            return
        self._endurance.take(snapshot.time_s, status.battery_percent)
        self.left_s = self._endurance.left_s(snapshot.time_s)
        airspeed_m_s = self._config.aircraft.airspeed_m_s
        self.home_s = time_to_s(snapshot.aircraft, self._home_m, airspeed_m_s, snapshot.wind)
        if self.left_s is None:
            return
        every_s = _LOW_BATTERY_EVERY_S if battery_is_low(self.left_s, self.home_s) else _BATTERY_EVERY_S
        if snapshot.time_s >= self._reported_s + every_s:
            self._reported_s = snapshot.time_s
            self._put(BatteryReported(snapshot.time_s, status.battery_percent, self.left_s, self.home_s))

    def _situation(self, snapshot: Snapshot, status: VehicleStatus) -> Situation:
        estimate, sensors, planner = snapshot.estimate, snapshot.sensor_status, self._config.planner
        now_s, watch = snapshot.time_s, self._present.of(snapshot)
        elsewhere = snapshot.turn_payload  # the payload looks at another target
        unseen_s = None if estimate is None or elsewhere else now_s - estimate.last_sighting_s
        gives_up = unseen_s is not None and snapshot.phase is Phase.WATCHING
        return Situation(
            now_s,
            in_hand=snapshot.phase.in_control,
            connected=sensors.connected,
            silent_s=self._clock_s() - self._received_at_s,
            yielded=snapshot.over if snapshot.phase is Phase.YIELDED else "",
            separation=snapshot.separation,
            in_band=watch.in_band,
            on_side=watch.on_side,
            beyond_side_rad=watch.beyond_side_rad,
            range_m=math.nan if watch.range_m is None else watch.range_m,
            unseen_s=unseen_s,
            lost=estimate is not None and estimate.quality is TrackQuality.LOST and not elsewhere,
            gives_up_in_s=planner.give_up_after_s - (unseen_s or 0.0) if gives_up else None,
            at_give_up=planner.at_end,
            health=() if elsewhere else snapshot.health,
            gps=status.gps or "",
            good_gps=status.gps_good,
            battery_percent=status.battery_percent,
            endurance_s=self.left_s,
            home_s=self.home_s,
        )
