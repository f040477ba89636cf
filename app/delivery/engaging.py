"""Bringing the aircraft onto a circle of ours: from the ground, from the air, or onto the circle it flies already."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import replace

from pymavlink import mavutil

from app.autopilots.autopilot import Autopilot, Home
from app.autopilots.queries import is_flying, mode_of
from app.config import Config
from app.delivery.command_guidance import OrbitCommandBackend
from app.delivery.mission_guidance import MissionItemBackend
from app.errors import FlightError, InputError
from app.link.link import RawItem, UploadResult
from app.link.telemetry import Telemetry
from app.link.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.core.circle import Circle
from mission.core.events import ControlAcquired
from mission.core.plan import Plan

_mav = mavutil.mavlink
_TAKE_OFF_HEIGHT_M = 50.0
_ARM_EVERY_S = 1.0
_POLL_S = 0.1
_ARM_WITHIN_S, _TAKE_OFF_WITHIN_S = 120.0, 240.0  # of the vehicle's time
_MODE_WITHIN_S = 5.0
_HIGH_ENOUGH = 0.7  # of the height wanted, to begin watching
_AT_HEIGHT_M = 5.0
_TOLD_WITHIN_S = 2.0
_LIKE_OURS = (0.7, 1.3)  # a circle flown already with a radius within this share of ours was commanded by us
_ROUND = 2.5  # so many radii from its centre an aircraft counts as circling


class Takeover:
    """One vehicle's way into the mission. cleared gives a plan its heights, or names what is in its way."""

    def __init__(
        self,
        vehicle: Vehicle,
        autopilot: Autopilot,
        telemetry: Telemetry,
        config: Config,
        plane: LocalPlane,
        home: Home,
        cleared: Callable[[Plan], Plan | str],
        note: Callable[[str], object],
    ) -> None:
        self._vehicle, self._autopilot, self._telemetry = vehicle, autopilot, telemetry
        self._config, self._plane, self._home = config, plane, home
        self._cleared, self._note = cleared, note

    async def engage(self, missions: MissionItemBackend, commands: OrbitCommandBackend) -> ControlAcquired:
        """Return what is engaged in, once it is flown. Raises InputError or FlightError."""
        guided = self._config.planner.guidance == "command"
        if not is_flying(self._vehicle):
            circle = commanded = self._circle_at_home()
            await self._take_off(missions, self._first(circle))
        else:
            circle, commanded, adopted = await self._flown(missions)
            first = self._first(circle)
            if not guided and not adopted:
                await self._load(missions, replace(first, circle=commanded), ())
                await self._in_mission_mode()
                await missions.select()
                await self._until_circling(missions.line_first, first)
        if guided and not await commands.engage(replace(self._first(circle), circle=commanded)):
            raise FlightError(f"the circle was not taken over{self._last_status_text()}.")
        mode = self._autopilot.circle_mode if guided else self._autopilot.mission_mode
        return ControlAcquired(self._telemetry.now_s, circle, mode, commanded)

    @property
    def _height_m(self) -> float:
        return float(self._vehicle.latest["GLOBAL_POSITION_INT"].fields["relative_alt"]) * 1e-3

    def _first(self, circle: Circle) -> Plan:
        """Return the first plan. Raises InputError when something is in its way."""
        cleared = self._cleared(Plan(circle))
        if isinstance(cleared, str):
            raise InputError(f"the first circle cannot be flown: {cleared}; change the fences or where it begins.")
        return cleared

    # -- from the air --------------------------------------------------------------------------------------

    async def _flown(self, missions: MissionItemBackend) -> tuple[Circle, Circle, bool]:
        """Return the circle wanted, the circle commanded for it, and whether its mission was taken over as it is."""
        told = adopted = None
        if mode_of(self._vehicle) == self._autopilot.mission_mode:
            told = adopted = await missions.adopt()
        elif mode_of(self._vehicle) == self._autopilot.circle_mode:
            told = await self._told_circle()
        if told is None:
            self._note("already flying: taking over from where it is")
            circle = self._circle_here()
            return circle, circle, False
        self._note("already circling: taking over the circle that is flown")
        radius_m = self._config.aircraft.radius_m
        ours = _LIKE_OURS[0] < told.radius_m / radius_m < _LIKE_OURS[1]
        wanted = Circle(told.east_m, told.north_m, radius_m if ours else told.radius_m, told.clockwise)
        return wanted, told, adopted is not None

    async def _told_circle(self) -> Circle | None:
        """Return the circle flown by command, as far as the autopilot tells it."""
        message = await self._vehicle.wait_for(
            lambda message: self._autopilot.told_circle(message) is not None, _TOLD_WITHIN_S
        )
        order = self._autopilot.told_circle(message) if message is not None else None
        if order is None:
            return None
        east_m, north_m = self._plane.east_north_m(order.x * 1e-7, order.y * 1e-7)
        radius_m = abs(order.signed_radius_m) or self._config.aircraft.radius_m
        here_east_m, here_north_m, course_rad = self._place()
        off_m = math.hypot(here_east_m - east_m, here_north_m - north_m)
        if off_m > _ROUND * radius_m:
            return None
        turning_rad = math.atan2(here_east_m - east_m, here_north_m - north_m) - course_rad
        clockwise = order.signed_radius_m > 0.0 if order.signed_radius_m else math.sin(turning_rad) < 0.0
        return Circle(east_m, north_m, radius_m, clockwise)

    def _circle_here(self) -> Circle:
        east_m, north_m, course_rad = self._place()
        return Circle.tangent_to(east_m, north_m, course_rad, self._config.aircraft.radius_m, self._clockwise)

    def _place(self) -> tuple[float, float, float]:
        fields = self._vehicle.latest["GLOBAL_POSITION_INT"].fields
        course_rad = math.atan2(fields["vy"], fields["vx"])
        return *self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7), course_rad

    @property
    def _clockwise(self) -> bool:
        return self._config.requirement.requirement().side.clockwise

    # -- from the ground -----------------------------------------------------------------------------------

    def _circle_at_home(self) -> Circle:
        east_m, north_m = self._plane.east_north_m(self._home.latitude_deg, self._home.longitude_deg)
        return Circle(east_m, north_m, self._config.aircraft.radius_m, self._clockwise)

    async def _take_off(self, missions: MissionItemBackend, first: Plan) -> None:
        await self._load(missions, first, (self._take_off_item(),))
        await self._arm()
        try:
            await self._in_mission_mode()
        except FlightError:
            await self._autopilot.disarm(self._vehicle)  # still on the ground; refused if it is not
            raise
        self._note("taking off")
        await self._until_circling(missions.line_first, first)

    async def _load(self, missions: MissionItemBackend, first: Plan, lead_in: tuple[RawItem, ...]) -> None:
        result = await missions.load(missions.line(first), lead_in)
        if result is not UploadResult.ACCEPTED:
            raise FlightError(f"the first mission was not taken ({result}); nothing was commanded.")

    def _take_off_item(self) -> RawItem:
        return RawItem(
            _mav.MAV_CMD_NAV_TAKEOFF,
            _mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            15.0,
            0.0,
            0.0,
            math.nan,
            round(self._home.latitude_deg * 1e7),
            round(self._home.longitude_deg * 1e7),
            min(_TAKE_OFF_HEIGHT_M, self._config.aircraft.height_m),
        )

    async def _arm(self) -> None:
        self._note("arming")
        deadline_s = self._telemetry.now_s + _ARM_WITHIN_S
        simulated = not self._config.link.connections
        while not (answer := await self._autopilot.arm(self._vehicle)).accepted:
            if self._telemetry.now_s > deadline_s:
                raise FlightError(f"the autopilot does not arm ({answer}){self._last_status_text()}.")
            await asyncio.sleep(_ARM_EVERY_S / (self._config.simulation.speed if simulated else 1.0))

    async def _in_mission_mode(self) -> None:
        answer = await self._autopilot.start_mission(self._vehicle)
        # An accepted command proves nothing: PX4 accepts, and stays in HOLD with a mission it does not like.
        if not answer.accepted or not await self._mode_is(self._autopilot.mission_mode):
            raise FlightError(f"the mission was not started ({answer}){self._last_status_text()}.")

    async def _mode_is(self, mode: str) -> bool:
        deadline_s = time.monotonic() + _MODE_WITHIN_S
        while mode_of(self._vehicle) != mode:
            if time.monotonic() > deadline_s:
                return False
            await asyncio.sleep(_POLL_S)
        return True

    async def _until_circling(self, first: int, plan: Plan) -> None:
        deadline_s, wall_s = self._telemetry.now_s + _TAKE_OFF_WITHIN_S, time.monotonic() + _TAKE_OFF_WITHIN_S
        while not self._circling(first, plan):
            if self._telemetry.now_s > deadline_s or time.monotonic() > wall_s:
                raise FlightError(f"the first circle was not reached{self._last_status_text()}.")
            await asyncio.sleep(_POLL_S)

    def _circling(self, first: int, plan: Plan) -> bool:
        said = self._vehicle.latest.get("MISSION_CURRENT")
        at_item = said is not None and said.fields["seq"] >= first
        if plan.heights is not None:  # over hills only its own height is high enough
            return at_item and self._height_m > plan.heights.to_m - _AT_HEIGHT_M
        return at_item and self._height_m > _HIGH_ENOUGH * self._config.aircraft.height_m

    def _last_status_text(self) -> str:
        said = self._vehicle.latest.get("STATUSTEXT")
        return f": {said.fields['text']}" if said is not None else ""
