"""Plans as circles, each moved by one command: nothing is uploaded, so a plan departs as soon as it is made."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from app.autopilots.autopilot import Autopilot, CircleOrder, Home
from app.autopilots.queries import mode_of
from app.delivery.guidance import SwapError
from app.delivery.leading_circle import leading_circle
from app.link.link import LinkError
from app.link.message import Message
from app.link.telemetry import AUTOPILOT_COMPONENT
from app.link.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.core.circle import Circle
from mission.core.events import UploadPlan
from mission.core.plan import AircraftState, Plan

_PERIOD_S = 1.0  # of the vehicle's time
_MODE_S, _POLL_S = 5.0, 0.05
_SAME_E7 = 200  # two metres
_REMEMBERED = 4
_FOREIGN_COUNT = 3  # words in a row about a circle that is not ours


class OrbitCommandBackend:
    """``PlanBackend`` by one command a circle. ``engage`` comes first.

    aircraft tells where it is now; while a transition is flown, the circle that leads along it is commanded every
    second, then the plan's own one, once.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        autopilot: Autopilot,
        plane: LocalPlane,
        home: Home,
        *,
        height_m: float,
        bank_max_rad: float,
        aircraft: Callable[[], AircraftState | None],
    ) -> None:
        self._vehicle, self._autopilot, self._plane, self._home = vehicle, autopilot, plane, home
        self._height_m, self._bank_max_rad, self._aircraft = height_m, bank_max_rad, aircraft
        self._next: UploadPlan | None = None
        self._following: asyncio.Task[None] | None = None
        self._ordered: deque[CircleOrder] = deque(maxlen=_REMEMBERED)
        self._foreign_count = 0

    @property
    def mode(self) -> str:
        return self._autopilot.circle_mode

    async def engage(self, first: Plan) -> bool:
        """Take the aircraft over from any mode onto a circle; True when it flies in our mode."""
        answer = await self._autopilot.fly_circle(self._vehicle, self._order(first.circle, first), take_over=True)
        deadline_s = asyncio.get_running_loop().time() + _MODE_S
        while answer.accepted and mode_of(self._vehicle) != self.mode:
            if asyncio.get_running_loop().time() > deadline_s:
                return False
            await asyncio.sleep(_POLL_S)
        return answer.accepted

    async def prepare(self, command: UploadPlan) -> None:
        self._next = command

    async def depart(self, number: int) -> None:
        command = self._next
        if command is None or command.number != number:
            raise SwapError("it is not the plan that was made ready")
        self._leave_off()
        done = await self._lead(command)
        if not done:
            self._following = asyncio.create_task(self._follow(command))

    def stop(self) -> None:
        self._leave_off()

    def foreign(self, message: Message) -> str | None:
        """Notice a circle that was not commanded from here."""
        if message.component_id != AUTOPILOT_COMPONENT or not self._ordered or mode_of(self._vehicle) != self.mode:
            return None
        told = self._autopilot.told_circle(message)
        if told is None:
            return None
        if any(abs(told.x - one.x) <= _SAME_E7 and abs(told.y - one.y) <= _SAME_E7 for one in self._ordered):
            self._foreign_count = 0
            return None
        self._foreign_count += 1
        return "another station has moved the circle" if self._foreign_count >= _FOREIGN_COUNT else None

    def _leave_off(self) -> None:
        if self._following is not None:
            self._following.cancel()
            self._following = None

    async def _follow(self, command: UploadPlan) -> None:
        done, due_s = False, -math.inf
        while not done:
            await self._vehicle.wait_for(lambda message: message.name == "GLOBAL_POSITION_INT", _PERIOD_S)
            aircraft = self._aircraft()
            if aircraft is None or aircraft.time_s < due_s:
                continue
            due_s = aircraft.time_s + _PERIOD_S
            try:
                done = await self._lead(command)
            except (SwapError, LinkError):
                continue  # the circle before is flown on; the next second tries again

    async def _lead(self, command: UploadPlan) -> bool:
        """Command the circle that serves now; True when it was the last of the plan."""
        aircraft = self._aircraft()
        if aircraft is None:
            raise SwapError("the aircraft's place is not known")
        wanted = command.plan.circle
        circle = leading_circle(command.plan, aircraft, self._bank_max_rad)
        done = circle is None
        circle = circle or wanted
        # The autopilot flies another radius than commanded; what is known of that holds for every circle.
        circle = replace(circle, radius_m=circle.radius_m * command.commanded.radius_m / wanted.radius_m)
        if mode_of(self._vehicle) != self.mode:
            raise SwapError(f"the flight mode is {mode_of(self._vehicle)}")
        answer = await self._autopilot.fly_circle(self._vehicle, self._order(circle, command.plan), take_over=False)
        if not answer.accepted:
            raise SwapError(f"the autopilot's answer to a circle: {answer}")
        return done

    def _order(self, circle: Circle, plan: Plan) -> CircleOrder:
        height_m = self._height_m if plan.heights is None else plan.heights.to_m
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(circle.east_m, circle.north_m)
        order = CircleOrder(
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            height_m,
            self._home.altitude_m + height_m,
            circle.radius_m if circle.clockwise else -circle.radius_m,
        )
        self._ordered.append(order)
        return order
