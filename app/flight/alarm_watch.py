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

from sidelong.app.config import Config
from sidelong.mission.control.alarms import Alarms, Endurance, battery_is_low, time_to_s
from sidelong.mission.control.present import Present, VehicleStatus
from sidelong.mission.core.events import AlarmReported, BatteryReported

_LOOK_EVERY_S = 0.5
_STATUS_EVERY_S = 0.2  # of the wall clock: a fast simulation looks more often
_BATTERY_EVERY_S, _LOW_BATTERY_EVERY_S = 10.0, 1.0  # the controller needs more than one report to fly home
_TEXT_EVERY_S = 5.0


class AlarmWatch:
    """Judges the flight and completes what is shown of it by the vehicle's status and the alarms.

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
        self._alarms = Alarms()
        self._endurance = Endurance(config.planner.battery_reserve_percent)
        self._snapshot: Present | None = None
        self._received_at_s = clock_s()
        self._known = VehicleStatus()
        self._known_at_s = -math.inf
        self._looked_at_s = clock_s()
        self._looked_s = self._reported_s = self._sent_s = -math.inf
        self.left_s: float | None = None
        self.home_s: float | None = None

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

    def completed(self, present: Present) -> Present:
        """Take what is flown and return it with the vehicle's status; cheap but for once in half a second."""
        before, self._snapshot = self._snapshot, present
        if before is None or present.time_s != before.time_s:
            self._received_at_s = self._clock_s()
        link_changed = before is None or present.connected != before.connected
        if link_changed or present.time_s >= self._looked_s + _LOOK_EVERY_S:
            self._look(present)
        return replace(present, vehicle=self.status)

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's status as received last, with its alarms and its endurance."""
        return replace(
            self._known,
            endurance_s=self.left_s,
            home_s=self.home_s,
            home_m=self._home_m,
            silent_s=self._clock_s() - self._received_at_s,
            alarms=self._alarms.active,
        )

    def _look(self, present: Present) -> None:
        self._looked_s, self._looked_at_s = present.time_s, self._clock_s()
        if not math.isfinite(present.time_s):
            return
        if self._clock_s() >= self._known_at_s + _STATUS_EVERY_S:
            self._known, self._known_at_s = self._status(), self._clock_s()
        self._watch_battery(present)
        raised, cleared = self._alarms.update(replace(present, vehicle=self.status))
        for alarm in cleared:
            self._put(AlarmReported(present.time_s, alarm.key, "cleared", alarm.text))
        for alarm in raised:
            self._put(AlarmReported(present.time_s, alarm.key, "raised", f"{alarm.text}: {alarm.advice}"))
        if raised and present.phase.in_control and present.time_s >= self._sent_s + _TEXT_EVERY_S:
            self._sent_s = present.time_s
            self._send(f"sidelong: {raised[0].text}")

    def _watch_battery(self, present: Present) -> None:
        if self._known.battery_percent is None or present.aircraft is None:
            return
        self._endurance.take(present.time_s, self._known.battery_percent)
        self.left_s = self._endurance.left_s(present.time_s)
        airspeed_m_s = self._config.aircraft.airspeed_m_s
        self.home_s = time_to_s(present.aircraft, self._home_m, airspeed_m_s, present.wind)
        if self.left_s is None:
            return
        every_s = _LOW_BATTERY_EVERY_S if battery_is_low(self.left_s, self.home_s) else _BATTERY_EVERY_S
        if present.time_s >= self._reported_s + every_s:
            self._reported_s = present.time_s
            self._put(BatteryReported(present.time_s, self._known.battery_percent, self.left_s, self.home_s))
