"""Bringing the aircraft onto a circle of ours: from the ground, from the air, or onto the circle it flies already.

A script that stands still between events: each ``yield`` waits for the next one, ``until_s`` states when it has to be
called at the latest.

Source: docs/retries.md#4-control-of-the-aircraft; docs/how-to/takeover.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import Announce, ControlAcquired
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.exchange.dialect import AutopilotDialect, CircleOrder, ExchangeSettings
from sidelong.mission.exchange.mission_items import MissionItemBackend
from sidelong.mission.exchange.mission_write import WriteResult
from sidelong.mission.exchange.orbit_command import OrbitCommandBackend
from sidelong.mission.exchange.outbox import Outbox, TakeoverFailed
from sidelong.mission.exchange.reports import CommandAcknowledged, TakeoverRequested, VehicleReport
from sidelong.mission.exchange.vehicle_command import (
    ACCEPTED,
    IN_PROGRESS,
    NOT_NOW,
    CommandExchange,
    VehicleCommand,
    describe_result,
)
from sidelong.mission.upload.mission_item import MissionItem, e7

_TAKE_OFF, _RELATIVE = 22, 3  # MAV_CMD_NAV_TAKEOFF, MAV_FRAME_GLOBAL_RELATIVE_ALT
_ARM, _DISARM = (VehicleCommand(400, (armed,)) for armed in (1.0, 0.0))  # MAV_CMD_COMPONENT_ARM_DISARM
_RUN_PREARM_CHECKS = 401  # reports by STATUSTEXT what prevents arming
_TAKE_OFF_HEIGHT_M = 50.0
_ARM_WITHIN_S, _TAKE_OFF_WITHIN_S = 120.0, 240.0  # of the vehicle's time
_MODE_WITHIN_S, _REPORTED_WITHIN_S, _START_AGAIN_S = 5.0, 2.0, 0.5  # of the link's clock
_STARTED_S = 2.0  # a mode that was accepted is reported so soon, of the link's clock
_HIGH_ENOUGH = 0.7  # of the height wanted, to begin watching
_AT_HEIGHT_M = 5.0
_LIKE_OURS = (0.7, 1.3)  # a circle flown already with a radius within this share of ours was commanded by us
_ROUND = 2.5  # within this many radii of its centre an aircraft counts as circling
_TICK_S = 0.1

Script = Iterator[None]


class _FailedError(Exception):
    """The way onto the circle has ended; wrong_input: before anything was sent, by the configuration."""

    def __init__(self, reason: str, wrong_input: bool = False) -> None:
        super().__init__(reason)
        self.wrong_input = wrong_input


class Takeover:
    """One vehicle's way into the mission. ``begin`` starts it; ``ControlAcquired`` or ``TakeoverFailed`` ends it."""

    def __init__(
        self,
        outbox: Outbox,
        dialect: AutopilotDialect,
        settings: ExchangeSettings,
        missions: MissionItemBackend,
        orbits: OrbitCommandBackend,
    ) -> None:
        self._outbox, self._dialect = outbox, dialect
        self._settings, self._missions, self._orbits = settings, missions, orbits
        self._script: Script | None = None
        self.mode = ""  # as it was reported last
        self._height_m = -math.inf
        self._aircraft: AircraftState | None = None
        self._command: CommandExchange | None = None
        self._circle_reported: CircleOrder | None = None
        self._arm_period_s, self._round_trip_s = 1.0, 0.0
        self._until_s = math.inf

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        command_s = self._command.next_timer_s if self._command is not None else math.inf
        return min(command_s, self._until_s) if self._script is not None else math.inf

    def begin(self, request: TakeoverRequested) -> None:
        """Start the takeover."""
        self.mode, self._arm_period_s = request.mode, request.arm_period_s
        self._round_trip_s = request.round_trip_s
        self._script = self._take_over(request.flying)
        self.step()

    def observe(self, aircraft: AircraftState, height_m: float) -> None:
        """Process the aircraft's position."""
        self._aircraft, self._height_m = aircraft, height_m

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if isinstance(report, CommandAcknowledged) and self._command is not None:
            self._command.receive(report)
        self._circle_reported = self._dialect.reported_circle(report) or self._circle_reported

    def stop(self) -> None:
        """Stop: send nothing more."""
        self._script = self._command = None

    def step(self) -> None:
        """Continue until the takeover has to wait for a report or a timer."""
        if self._script is None:
            return
        if self._command is not None:
            self._command.expire()
        self._until_s = math.inf
        try:
            next(self._script)
        except StopIteration:
            self.stop()
        except _FailedError as failed:
            self._outbox.report(TakeoverFailed(self._outbox.time_s, str(failed), failed.wrong_input))
            self.stop()

    # -- the script ----------------------------------------------------------------------------------------

    def _take_over(self, flying: bool) -> Script:
        by_command = self._settings.by_command
        if not flying:
            settings, home = self._settings, self._settings.home
            centre_m = settings.plane.east_north_m(home.latitude_deg, home.longitude_deg)
            circle = commanded = Circle(*centre_m, settings.aircraft.radius_m, settings.clockwise)
            yield from self._take_off(circle)
        else:
            flown, adopted = yield from self._flown_circle()
            circle, commanded = self._wanted(flown)
            if not by_command and not adopted:
                first, mode = replace(self._first(circle), circle=commanded), self.mode
                load = self._load(first, ())
                # PX4 itself leaves the mission mode when its mission is replaced.
                yield from load if mode == self._dialect.mission_mode else self._while_in(mode, load)
                yield from self._start_mission()
                self._outbox.send("MISSION_SET_CURRENT", seq=self._missions.line_first)
                yield from self._while_in(self._dialect.mission_mode, self._until_circling(first, _MODE_WITHIN_S))
        if by_command:
            yield from self._take_over_by_command(replace(self._first(circle), circle=commanded))
        mode = self._dialect.circle_mode if by_command else self._dialect.mission_mode
        backend = self._orbits if by_command else self._missions
        backend.take_control()
        self._outbox.report(ControlAcquired(self._outbox.time_s, circle, mode, commanded))

    def _note(self, text: str) -> None:
        self._outbox.report(Announce(self._outbox.time_s, "takeover", text))

    def _first(self, circle: Circle) -> Plan:
        """Return the first plan, unless something is in its way."""
        cleared = self._settings.cleared(Plan(circle))
        if isinstance(cleared, str):
            reason = f"the first circle cannot be flown: {cleared}; change the fences or where it begins"
            raise _FailedError(reason, wrong_input=True)
        return cleared

    def _until(
        self, holds: Callable[[], bool], link_s: float = math.inf, vehicle_s: float = math.inf
    ) -> Iterator[None]:
        link_end_s, vehicle_end_s = self._outbox.link_s + link_s, self._outbox.time_s + vehicle_s
        while not holds() and self._outbox.link_s < link_end_s and self._outbox.time_s < vehicle_end_s:
            self._until_s = min(link_end_s, self._outbox.link_s + _TICK_S)
            yield

    def _while_in(self, mode: str, part: Script) -> Script:
        """Run a part of the script, unless the pilot changes the flight mode during it."""
        for _ in part:
            yield
            if self.mode != mode:
                raise _FailedError(f"the flight mode was changed to {self.mode} in the meantime")

    def _commanded(self, command: VehicleCommand | CommandExchange) -> Generator[None, None, CommandExchange]:
        exchange = command if isinstance(command, CommandExchange) else CommandExchange(self._outbox, command)
        self._command = exchange
        while not exchange.done:
            yield
        return exchange

    # -- from the air --------------------------------------------------------------------------------------

    def _flown_circle(self) -> Generator[None, None, tuple[Circle | None, bool]]:
        """Return the circle that is flown already, None if there is none, and whether its mission was adopted."""
        yield from self._until(lambda: self._aircraft is not None, _MODE_WITHIN_S)
        if self._aircraft is None:
            raise _FailedError("the aircraft's place is not known")
        if self.mode == self._dialect.mission_mode:
            self._missions.adopt(self._round_trip_s)
            while self._missions.reading:
                yield
            yield from self._until(lambda: self._missions.flown_index is not None, _REPORTED_WITHIN_S)
            flown = self._missions.adopted()
            return flown, flown is not None
        if self.mode == self._dialect.circle_mode:
            yield from self._until(lambda: self._circle_reported is not None, _REPORTED_WITHIN_S)
            return self._reported_circle(), False
        return None, False

    def _wanted(self, flown: Circle | None) -> tuple[Circle, Circle]:
        """Return the circle wanted, and the circle commanded for it."""
        radius_m = self._settings.aircraft.radius_m
        if flown is None:
            self._note("already flying: taking over from where it is")
            here, clockwise = self._here(), self._settings.clockwise
            either = [
                Circle.tangent_to(here.east_m, here.north_m, here.course_rad, radius_m, sense)
                for sense in (clockwise, not clockwise)
            ]
            free = (candidate for candidate in either if not isinstance(self._settings.cleared(Plan(candidate)), str))
            circle = next(free, either[0])
            self._first(circle)
            return circle, circle
        self._note("already circling: taking over the circle that is flown")
        ours = _LIKE_OURS[0] < flown.radius_m / radius_m < _LIKE_OURS[1]
        wanted = Circle(flown.east_m, flown.north_m, radius_m if ours else flown.radius_m, flown.clockwise)
        self._first(wanted)
        return wanted, flown

    def _reported_circle(self) -> Circle | None:
        order, here = self._circle_reported, self._here()
        if order is None:
            return None
        east_m, north_m = self._settings.plane.east_north_m(order.x * 1e-7, order.y * 1e-7)
        radius_m = abs(order.signed_radius_m) or self._settings.aircraft.radius_m
        off_east_m, off_north_m = here.east_m - east_m, here.north_m - north_m
        if math.hypot(off_east_m, off_north_m) > _ROUND * radius_m:
            return None
        turning_rad = math.atan2(off_east_m, off_north_m) - here.course_rad
        clockwise = order.signed_radius_m > 0.0 if order.signed_radius_m else math.sin(turning_rad) < 0.0
        return Circle(east_m, north_m, radius_m, clockwise)

    def _here(self) -> AircraftState:
        assert self._aircraft is not None
        return self._aircraft

    def _take_over_by_command(self, first: Plan) -> Script:
        command = yield from self._commanded(self._orbits.take_over(first))
        mode = self._dialect.circle_mode
        if command.accepted:
            yield from self._until(lambda: self.mode == mode, _MODE_WITHIN_S)
        if not command.accepted or self.mode != mode:
            raise _FailedError(f"the circle was not taken over ({describe_result(command.result)})")

    # -- from the ground -----------------------------------------------------------------------------------

    def _take_off(self, circle: Circle) -> Script:
        first = self._first(circle)
        place = e7((self._settings.home.latitude_deg, self._settings.home.longitude_deg))
        height_m = min(_TAKE_OFF_HEIGHT_M, self._settings.height_m)
        take_off = MissionItem(_TAKE_OFF, _RELATIVE, 15.0, 0.0, 0.0, math.nan, *place, height_m)
        yield from self._load(first, (take_off,))
        yield from self._arm()
        try:
            yield from self._start_mission()
        except _FailedError:
            yield from self._commanded(_DISARM)  # still on the ground; refused if it is not
            raise
        self._note("taking off")
        yield from self._until_circling(first, _TAKE_OFF_WITHIN_S)

    def _load(self, first: Plan, lead_in: tuple[MissionItem, ...]) -> Script:
        self._missions.load(first, lead_in)
        while self._missions.load_result is None:
            yield
        result = self._missions.load_result
        if result is not WriteResult.ACCEPTED:
            raise _FailedError(f"the first mission was not taken ({result}); nothing was commanded")

    def _arm(self) -> Script:
        self._note("arming")
        deadline_s, reasons_asked = self._outbox.time_s + _ARM_WITHIN_S, False
        while True:
            command = yield from self._commanded(_ARM)
            if command.accepted:
                return
            if command.result == IN_PROGRESS or self._outbox.time_s > deadline_s:
                if command.result in (IN_PROGRESS, None):  # it may have been carried out
                    yield from self._commanded(_DISARM)
                raise _FailedError(f"the autopilot did not arm ({describe_result(command.result)})")
            if not reasons_asked:
                reasons_asked = True
                yield from self._commanded(VehicleCommand(_RUN_PREARM_CHECKS, ()))
            yield from self._until(lambda: False, self._arm_period_s)

    def _start_mission(self) -> Script:
        link_end_s = self._outbox.link_s + _MODE_WITHIN_S
        mode = self._dialect.mission_mode
        expected = (self.mode, mode, self._dialect.circle_mode)
        # PX4 checks a new mission some time after it has taken it. Until then it refuses the mode, or accepts the
        # command and stays in HOLD. Where an accepted command is final, another mode is the pilot's choice.
        final = self._dialect.quirks.stores_items_one_by_one
        while True:
            command = yield from self._commanded(self._dialect.start_mission())
            if command.accepted:
                yield from self._until(lambda: self.mode == mode, _MODE_WITHIN_S if final else _STARTED_S)
            if self.mode == mode or self._outbox.link_s >= link_end_s or (final and command.accepted):
                break
            if self.mode not in expected:
                raise _FailedError(f"the flight mode was changed to {self.mode} in the meantime")
            if command.result not in (ACCEPTED, NOT_NOW):
                break
            yield from self._until(lambda: False, _START_AGAIN_S)
        if not command.accepted or self.mode != mode:
            raise _FailedError(f"the mission was not started ({describe_result(command.result)})")

    def _until_circling(self, first: Plan, again_s: float) -> Script:
        """Wait for the first circle; ask for it again, should that have been lost."""
        link_end_s = self._outbox.link_s + _TAKE_OFF_WITHIN_S
        deadline_s = self._outbox.time_s + _TAKE_OFF_WITHIN_S

        def circling() -> bool:
            index = self._missions.flown_index
            at_item = index is not None and index >= self._missions.line_first
            if first.heights is not None:  # over hills only its own height is high enough
                return at_item and self._height_m > first.heights.to_m - _AT_HEIGHT_M
            return at_item and self._height_m > _HIGH_ENOUGH * self._settings.height_m

        while not circling():
            if self._outbox.link_s > link_end_s or self._outbox.time_s > deadline_s:
                raise _FailedError("the first circle was not reached")
            yield from self._until(circling, min(again_s, _TAKE_OFF_WITHIN_S), _TAKE_OFF_WITHIN_S)
            index, line_first = self._missions.flown_index, self._missions.line_first
            is_elsewhere = index is not None and index < line_first
            if not circling() and again_s < _TAKE_OFF_WITHIN_S and is_elsewhere:
                self._outbox.send("MISSION_SET_CURRENT", seq=self._missions.line_first)
