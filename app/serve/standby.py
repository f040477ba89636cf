"""A connected vehicle between two watches: whether it is ready, by the same checks as before a launch."""

from __future__ import annotations

import asyncio
import time

from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import check_takeover, checks
from sidelong.app.flight.session import Session
from sidelong.app.flight.source_rates import SourceRates
from sidelong.app.flight.streams import ask_for_streams, wants_few
from sidelong.app.link.message import Message
from sidelong.app.link.parameters import read_table
from sidelong.app.link.queries import home_of, is_flying
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT

_LISTEN_S = 1.0
_SILENT_S = 5.0
_AGAIN_S = 10.0
_RESTARTED_MS = 5000  # a clock that is set back by more is that of another start


class VehicleGoneError(Exception):
    """The vehicle is silent, or has started again: connect again."""


class Standby:
    """Judges one session again and again.

    Attributes:
        missing: What keeps the vehicle from being watched with, in words; '' where it is ready, None before the first
            check.
    """

    def __init__(self, session: Session, config: Config) -> None:
        self._session, self._config = session, config
        self._received_s = time.monotonic()
        self._boot_ms = -1
        self._restarted = self._was_missing = False
        self.missing: str | None = None
        session.vehicle.listeners.append(self._on_message)

    async def run(self) -> None:
        """Judge until cancelled. Raises VehicleGoneError."""
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
                missing = [str(one) for one in found if not (one.ready or (flying and one.before_take_off))]
                self._judge("; ".join(missing) or self._takeover_refused())
                if missing and time.monotonic() - asked_s > _AGAIN_S and asking.done():
                    asked_s = time.monotonic()  # the autopilot may have started after its link
                    asking = asyncio.create_task(ask_for_streams(vehicle, few))
        finally:
            sources.close()
            asking.cancel()
            vehicle.listeners.remove(self._on_message)

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
