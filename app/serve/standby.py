"""A connected vehicle: whether it is ready, by the checks before a launch, and what is requested through it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from sidelong.app.config import Config, ControlSection
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import Check, SourceRates, check_takeover, checks
from sidelong.app.flight.session import Session
from sidelong.app.flight.streams import ask_for_streams, wants_few
from sidelong.app.link.message import Message
from sidelong.app.link.raw_links import DO_AUX_FUNCTION
from sidelong.app.link.stored import read_table
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, FAILSAFE_STATES, mode_name
from sidelong.app.link.vehicle import home_of, is_flying

_LISTEN_S = 1.0
_SILENT_S = 5.0
_AGAIN_S = 10.0
_RESTARTED_MS = 5000  # a clock that is set back by more is that of another start
_UP_US, _DOWN_US = 1700, 1300
_VALID_US = (800, 2200)  # a receiver without a signal sends less or nothing
_NO_SIGNAL = 0  # RC_CHANNELS.rssi; 255: not known
_RC_RECEIVER = 0x10000  # MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_CHANNELS = 18
_UP_FOR_MS, _DOWN_FOR_MS = 2000, 1000  # how long a movement has to last
_REPORTED_AFTER_MS = 1000  # the receiver has to be reported healthy this long after the movement began, or later
_SWITCH_GAP_MS = 3000  # after a longer silence a movement begins again
_JUMP_US, _JUMPS = 150, 2  # this many other channels jump this far in the same report
_MODE_HEARTBEATS = 3  # two seconds
_HIGH, _LOW = 2.0, 0.0
MODES = ("HEARTBEAT", "CURRENT_MODE")  # what states the mode, once a second and at each change
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_REPEATED_S = 2.0  # a command that is not acknowledged comes again

Request = Literal["watch", "release", "confirm"]


class VehicleGoneError(Exception):
    """The vehicle is silent, or has started again: connect again."""


class Standby:
    """Judges one session again and again."""

    def __init__(self, session: Session, config: Config) -> None:
        self._session, self._config = session, config
        self._received_s = time.monotonic()
        self._boot_ms = -1
        self._restarted = self._was_missing = False
        self.missing: str | None = None  # what keeps it from being watched with; '': ready; None: not checked yet
        self.found: tuple[Check, ...] = ()  # the latest checks
        session.vehicle.listeners.append(self._on_message)

    async def run(self) -> None:
        """Judge until cancelled, between two watches. Raises VehicleGoneError."""
        self.missing, self._was_missing = None, False
        session, config, few = self._session, self._config, wants_few(self._config.link)
        vehicle, autopilot = session.vehicle, session.autopilot
        asking = asyncio.create_task(ask_for_streams(vehicle, few))
        sources = SourceRates(vehicle)
        try:
            table, _ = await asyncio.gather(read_table(vehicle, autopilot, session.release), home_of(vehicle))
            needed = table.as_on_board(autopilot.required_parameters(table.values, config.aircraft.airspeed_m_s))
            asked_s = time.monotonic()
            while True:
                rates = await sources.received(_LISTEN_S, config.sharing)
                if self._restarted or time.monotonic() - self._received_s > _SILENT_S:
                    raise VehicleGoneError
                home = await home_of(vehicle)
                unmet = () if config.link.set_parameters else needed
                found = checks(config, vehicle, autopilot, table, home, rates, unmet)
                flying = is_flying(vehicle)
                self.found = tuple(check for check in found if check.ready or not (flying and check.before_take_off))
                missing = [str(check) for check in self.found if not check.ready]
                self._judge("; ".join(missing) or self._takeover_refused())
                if missing and time.monotonic() - asked_s > _AGAIN_S and asking.done():
                    asked_s = time.monotonic()  # the autopilot may have started after its link
                    asking = asyncio.create_task(ask_for_streams(vehicle, few))
        finally:
            sources.close()
            asking.cancel()

    def _judge(self, missing: str) -> None:
        """Take what is missing; a source of few messages may be silent for once."""
        if self.missing != "" or self._was_missing or not missing:
            self.missing = missing
        self._was_missing = bool(missing)

    def _takeover_refused(self) -> str:
        try:
            check_takeover(self._session.vehicle, self._config.link.take_over_from)
        except InputError as refusal:
            return str(refusal)
        return ""

    def _on_message(self, message: Message) -> None:
        if message.component_id != AUTOPILOT_COMPONENT:
            return
        self._received_s = time.monotonic()
        boot_ms = message.fields.get("time_boot_ms") if message.name == "GLOBAL_POSITION_INT" else None
        if boot_ms is not None:
            self._restarted |= int(boot_ms) < self._boot_ms - _RESTARTED_MS
            self._boot_ms = int(boot_ms)


# -- what a person does at the transmitter or the ground station ------------------------------------------------


@dataclass(slots=True)
class _Switch:
    """A switch of the transmitter; a movement counts once it has lasted, with a receiver that is healthy.

    A receiver that loses its transmitter may preset any channel. What the autopilot then reports is an unhealthy
    receiver, up to a second or two later, or several channels that jump at once. After that the switch has to be low
    again before it starts anything.
    """

    up: bool | None = None  # its position, None while it is not known
    moved: tuple[bool, int] | None = None  # the position that it was moved to, and when, ms of the vehicle's clock
    healthy_ms: int | None = None  # when the receiver was last healthy; None: not since it was reported unhealthy
    now_ms: int = 0
    others_us: tuple[int, ...] = ()

    def forget(self) -> None:
        self.up = self.moved = None

    def take_health(self, fields: Mapping[str, Any]) -> None:
        healthy = int(fields["onboard_control_sensors_present"]) & int(fields["onboard_control_sensors_health"])
        self.healthy_ms = self.now_ms if healthy & _RC_RECEIVER else None
        if self.healthy_ms is None:
            self.forget()

    def take(self, fields: Mapping[str, Any], channel: int) -> Request | None:
        before_ms, self.now_ms, others_us = self.now_ms, int(fields["time_boot_ms"]), self.others_us
        others = (number for number in range(1, _CHANNELS + 1) if number != channel)
        self.others_us = tuple(int(fields.get(f"chan{number}_raw") or 0) for number in others)
        if self.now_ms < before_ms - _RESTARTED_MS:  # the autopilot has started again
            self.healthy_ms = None
            self.forget()
        pulse_us = int(fields.get(f"chan{channel}_raw") or 0)
        if not _VALID_US[0] <= pulse_us <= _VALID_US[1] or fields.get("rssi") == _NO_SIGNAL:
            self.forget()
            return None
        up = True if pulse_us >= _UP_US else False if pulse_us <= _DOWN_US else None
        if up is None or up == self.up:  # in the middle the switch stays what it was
            self.moved = None
            return None
        if self.moved is None or self.moved[0] != up or self.now_ms - before_ms > _SWITCH_GAP_MS:
            self.moved = up, self.now_ms
            if sum(abs(a - b) > _JUMP_US for a, b in zip(others_us, self.others_us, strict=False)) >= _JUMPS:
                self.up = None
        return self._lasted(up, self.now_ms - self.moved[1])

    def _lasted(self, up: bool, held_ms: int) -> Request | None:
        healthy_ms = -1 if self.healthy_ms is None else self.healthy_ms
        assert self.moved is not None
        if up and (held_ms < _UP_FOR_MS or healthy_ms < self.moved[1] + _REPORTED_AFTER_MS):
            return None
        if not up and (held_ms < _DOWN_FOR_MS or healthy_ms < 0):
            return None
        before, self.up, self.moved = self.up, up, None
        return None if before is None else "watch" if up else "release"


@dataclass(eq=False)
class Triggers:
    """What is requested of one vehicle's service by a switch, a flight mode or a command of a ground station.

    Only a change counts: a switch that is already up when it is first received, or a mode that is already flown, does
    nothing, nor does a mode that sidelong has selected or that comes with a failsafe.
    """

    _config: ControlSection  # which of them are obeyed
    system_id: int
    _own_modes: tuple[str, ...] = ()  # those that sidelong selects
    _own_id: tuple[int, int] = (0, 0)  # system and component that sidelong speaks as
    _rc: _Switch = field(default_factory=_Switch)
    _unhealthy: bool = False  # the receiver, as the autopilot reports
    _mode: str | None = None
    _heartbeat: Mapping[str, Any] = field(default_factory=dict)  # the latest, with the latest mode
    _chosen: int | None = None  # heartbeats since the mode was selected; None: it was not
    _commanded: tuple[float, Request] | None = None

    def take(self, message: Message) -> Request | None:
        """Return the request that a message of the vehicle or a ground station makes, if any."""
        config = self._config
        if message.name in _COMMANDS and config.aux_function is not None:
            return self._aux(message, config.aux_function)
        if message.system_id != self.system_id or message.component_id != AUTOPILOT_COMPONENT:
            return None
        if message.name == "SYS_STATUS":
            fields = message.fields
            present = int(fields["onboard_control_sensors_present"]) & int(fields["onboard_control_sensors_enabled"])
            self._unhealthy = bool(present & ~int(fields["onboard_control_sensors_health"]) & _RC_RECEIVER)
            self._rc.take_health(fields)
        elif message.name == "RC_CHANNELS" and config.rc_channel is not None:
            return self._rc.take(message.fields, config.rc_channel)
        elif message.name in MODES and config.flight_mode is not None:
            beats, fields = message.name == "HEARTBEAT", message.fields
            if beats or self._heartbeat:
                self._heartbeat = fields if beats else {**self._heartbeat, "custom_mode": fields["custom_mode"]}
                return self._mode_changed(self._heartbeat, config.flight_mode, beats)
        return None

    def _mode_changed(self, fields: Mapping[str, Any], wanted: str, beats: bool) -> Request | None:
        mode = mode_name(*(int(fields[name]) for name in ("autopilot", "base_mode", "custom_mode")))
        before, self._mode = self._mode, mode
        failing = self._unhealthy or int(fields.get("system_status") or 0) in FAILSAFE_STATES
        if mode.upper() != wanted.upper() or mode in self._own_modes or failing:
            self._chosen = None
        elif self._chosen is None and before not in (None, mode):
            self._chosen = 0
        if self._chosen is not None and beats:
            self._chosen += 1
            if self._chosen == _MODE_HEARTBEATS:
                return "watch"
        left = before is not None and before.upper() == wanted.upper() != mode.upper()
        return "release" if left and mode not in self._own_modes else None

    def _aux(self, message: Message, function: int) -> Request | None:
        fields = message.fields
        to_system, to_component = int(fields["target_system"]), int(fields["target_component"])
        addressees = ((self.system_id, AUTOPILOT_COMPONENT), self._own_id)
        if to_system and not any(one[0] == to_system and to_component in (0, one[1]) for one in addressees):
            return None
        level = float(fields["param2"])
        asked = int(fields["command"]), float(fields["param1"])
        if asked != (DO_AUX_FUNCTION, function) or level not in (_LOW, _HIGH):
            return None
        request: Request = "watch" if level == _HIGH else "release"
        before, self._commanded = self._commanded, (message.received_s, request)
        repeated = before is not None and before[1] == request and message.received_s - before[0] < _REPEATED_S
        return None if repeated else request
