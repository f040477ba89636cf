"""Checks of all inputs by the health model of the flight, before it begins."""

from __future__ import annotations

import math

from sidelong.app.assembly import tracker_of
from sidelong.app.config import Config
from sidelong.app.flight.preflight import Check
from sidelong.app.flight.session import VehicleInputs
from sidelong.app.link.message import Message
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading
from sidelong.estimators.tracking.payload_fit import yaw_fault
from sidelong.mission.core.events import ClockTick, Event
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.health.health import Health

_BAD = (InputState.STALE, InputState.INCONSISTENT)
_OF_PAYLOAD = (Input.LASER, Input.GIMBAL)
_TICK_S = 1.0


class InputHealth:
    """Judges a vehicle's inputs until ``close`` as the control step does in flight.

    A fault that shows only while the aircraft turns (a frozen gimbal, a repeated range, a wrong frame or unit) is not
    found on the ground.

    Args:
        config: The mission; it names the sensors.
        inputs: The vehicle's, decoded and checked.
    """

    def __init__(self, config: Config, inputs: VehicleInputs) -> None:
        self._inputs, self._tracker = inputs, tracker_of(config)
        self._health = Health(self._tracker.payload)
        self._tick_s = -math.inf
        inputs.listeners.append(self._on_message)

    def close(self) -> None:
        """Listen no more."""
        self._inputs.listeners.remove(self._on_message)

    def _on_message(self, message: Message, event: Event | None, admitted: Event | None) -> None:
        if event is not None:
            self._take(event, admitted)
        if message.received_s >= self._tick_s + _TICK_S or message.received_s < self._tick_s:
            self._tick_s = message.received_s
            tick = ClockTick(self._inputs.telemetry.now_s, message.received_s)
            self._take(tick, tick)

    def _take(self, event: Event, admitted: Event | None) -> None:
        door, tracker = self._inputs.plausibility, self._tracker
        now_s = door.clock.now_s
        due = self._health.received(event, now_s, tracker.ranges)
        if isinstance(admitted, PositionReading | AttitudeReading | GimbalReading | RangeReading):
            tracker.add(admitted)
        if due and now_s > -math.inf:
            self._health.changes(now_s, tracker.ranges, tracker.gimbals, door.input_faults)

    def checks(self) -> tuple[Check, ...]:
        """Return what is wrong with an input, or that nothing is."""
        wrong = [(one.input, one.text) for one in self._health.reports if one.state in _BAD]
        if self._tracker.turns:
            yaw_error_rad = self._tracker.calibration.yaw_bias_rad
            wrong.append((Input.GIMBAL, f"the gimbal: {yaw_fault(yaw_error_rad)}; a flight corrects it"))
        if not wrong:
            judged = ", ".join(one.input for one in self._health.reports) or "none received"
            return (Check("inputs", True, f"{judged}: fresh, and without contradiction"),)
        return tuple(Check(f"input {one}", False, text, before_take_off=one in _OF_PAYLOAD) for one, text in wrong)
