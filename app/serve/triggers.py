"""What a person does at the transmitter or ground station that starts, resumes or ends a watch.

Only a change counts: a switch that is already up when it is first received, or a mode that is already flown, does
nothing. A mode that sidelong itself has selected is not a request either.
"""

from __future__ import annotations

from typing import Literal

from sidelong.app.config import ControlSection
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT, mode_name

Request = Literal["watch", "release"]

_UP_US, _DOWN_US = 1700, 1300  # between them the switch stays what it was
_VALID_US = (800, 2200)  # a receiver without a signal sends less or nothing
_DO_AUX_FUNCTION = 218
_HIGH, _LOW = 2.0, 0.0
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
_REPEATED_S = 2.0  # a command that is not acknowledged comes again


class Triggers:
    """Requests to one vehicle, ``system_id``: ``take`` every message received from it and from other stations."""

    def __init__(self, config: ControlSection, system_id: int, own_modes: tuple[str, ...] = ()) -> None:
        self._config, self.system_id, self._own_modes = config, system_id, own_modes
        self._up: bool | None = None
        self._mode: str | None = None
        self._commanded: tuple[float, Request] | None = None

    def take(self, message: Message) -> Request | None:
        """Return what a message requests, None if nothing."""
        config = self._config
        if message.name in _COMMANDS and config.aux_function is not None:
            return self._aux(message, config.aux_function)
        if message.system_id != self.system_id or message.component_id != AUTOPILOT_COMPONENT:
            return None
        if message.name == "RC_CHANNELS" and config.rc_channel is not None:
            return self._switch(int(message.fields.get(f"chan{config.rc_channel}_raw") or 0))
        if message.name == "HEARTBEAT" and config.flight_mode is not None:
            return self._mode_changed(message, config.flight_mode)
        return None

    def _switch(self, pulse_us: int) -> Request | None:
        if not _VALID_US[0] <= pulse_us <= _VALID_US[1]:
            self._up = None  # out of range: what it is afterwards is no person's doing
            return None
        up = True if pulse_us >= _UP_US else False if pulse_us <= _DOWN_US else self._up
        before, self._up = self._up, up
        if before is None or up == before:
            return None
        return "watch" if up else "release"

    def _mode_changed(self, message: Message, wanted: str) -> Request | None:
        mode = mode_name(*(int(message.fields[name]) for name in ("autopilot", "base_mode", "custom_mode")))
        before, self._mode = self._mode, mode
        chosen = before is not None and mode != before and mode.upper() == wanted.upper()
        return "watch" if chosen and mode not in self._own_modes else None

    def _aux(self, message: Message, function: int) -> Request | None:
        fields = message.fields
        if int(fields["command"]) != _DO_AUX_FUNCTION or int(fields["target_system"]) not in (0, self.system_id):
            return None
        level = float(fields["param2"])
        if int(fields["param1"]) != function or level not in (_LOW, _HIGH):
            return None
        request: Request = "watch" if level == _HIGH else "release"
        before, self._commanded = self._commanded, (message.received_s, request)
        repeated = before is not None and before[1] == request and message.received_s - before[0] < _REPEATED_S
        return None if repeated else request
