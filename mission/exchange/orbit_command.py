r"""Plans as circles, each moved by one command: nothing is uploaded, so a plan departs as soon as it is made.

A circle leads the aircraft along its plan from where it is; commanding it every second flies the plan::

      plan  ____---- * a point of the plan ahead
       __---     . '
      '       . '        The circle touches the aircraft's course and passes through that point, so the autopilot is
    ->|   . '            on it already and only banks. If no command follows, it is flown indefinitely.
   aircraft

A nearly straight piece has no circle of a useful size: there the aircraft is sent to a circle of the plan's radius
around a point ahead, far enough to fly straight to it.

Source: Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992;
DO_ORBIT and DO_REPOSITION, <https://mavlink.io/en/messages/common.html#MAV_CMD_DO_ORBIT>.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, PlanStatus, UploadPlan
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.exchange.dialect import AutopilotDialect, CircleOrder, ExchangeSettings
from sidelong.mission.exchange.outbox import ExternalControl, Outbox
from sidelong.mission.exchange.ownership import Suspicion
from sidelong.mission.exchange.reports import CommandAcknowledged, VehicleReport
from sidelong.mission.exchange.vehicle_command import CommandExchange, describe_result
from sidelong.mission.geometry.progress import dead_reckoned, nearest_arc_m, point_at

_LOOK_AHEAD_S = 3.5
_RESPONSE_S = 0.6  # from a command to the bank it asks for
_STRAIGHT_RADII = 4.0  # a circle larger than this many of the plan's radii is flown as a straight line
_AHEAD_RADII = 4.0


def leading_circle(plan: Plan, aircraft: AircraftState, bank_max_rad: float) -> Circle | None:
    """Return the circle to command now; None if the plan's own circle is to be flown from now on."""
    radius_m, speed_m_s = plan.circle.radius_m, aircraft.ground_speed_m_s
    min_m = min(speed_m_s**2 / (GRAVITY_M_S2 * math.tan(bank_max_rad)), radius_m)
    state = dead_reckoned(aircraft, _RESPONSE_S, 1.0 / min_m)
    arc_m = nearest_arc_m(plan, state)
    if arc_m >= plan.transition_m:
        return None
    goal = point_at(plan, arc_m + speed_m_s * _LOOK_AHEAD_S, state)
    east_m, north_m = goal.east_m - state.east_m, goal.north_m - state.north_m
    course_rad = state.course_rad
    right_m = east_m * math.cos(course_rad) - north_m * math.sin(course_rad)
    ahead_m = east_m * math.sin(course_rad) + north_m * math.cos(course_rad)
    squared_m2 = right_m**2 + ahead_m**2
    curvature_per_m = 2.0 * right_m / squared_m2 if squared_m2 > 1.0 else 0.0
    if ahead_m < 0.0:  # it lies behind: turn round as tightly as may be
        curvature_per_m = math.copysign(1.0 / min_m, right_m)
    if abs(curvature_per_m) * radius_m * _STRAIGHT_RADII < 1.0:
        far = _AHEAD_RADII * radius_m / math.sqrt(squared_m2)
        return Circle(state.east_m + far * east_m, state.north_m + far * north_m, radius_m, plan.circle.clockwise)
    flown_m = max(1.0 / abs(curvature_per_m), min_m)
    return Circle.tangent_to(state.east_m, state.north_m, course_rad, flown_m, curvature_per_m > 0.0)


_PERIOD_S = 1.0  # of the vehicle's time
_SAME_E7 = 200  # two metres
_REMEMBERED, _REMEMBERED_S = 4, 10.0  # at least this many commands, and all within this time of the link's clock


class OrbitCommandBackend:
    """Flies plans by one command a circle. ``take_over`` comes first."""

    def __init__(self, outbox: Outbox, dialect: AutopilotDialect, settings: ExchangeSettings) -> None:
        self._outbox, self._dialect, self._settings = outbox, dialect, settings
        self._plan: UploadPlan | None = None  # on board, as far as a plan can be before it is flown
        self._flown: UploadPlan | None = None  # its transition is being flown
        self._departing = self._was_last = False
        self._due_s = -math.inf  # the next circle, of the vehicle's time
        self._command: CommandExchange | None = None
        self._ordered: deque[tuple[float, CircleOrder]] = deque()
        self._reported: CircleOrder | None = None  # the last circle of ours that the autopilot reported to fly
        self._suspicion = Suspicion()
        self._aircraft: AircraftState | None = None
        self._mode = ""
        self._in_control = self._closed = self._waits = False

    @property
    def idle(self) -> bool:
        """Whether nothing is under way that should end before the program does."""
        return self._command is None

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once, inf: never."""
        if self._suspicion.active:
            return math.inf
        if self._waits:
            return -math.inf
        return self._command.next_timer_s if self._command is not None else math.inf

    def take_over(self, first: Plan) -> CommandExchange:
        """Return the command that takes the aircraft over from any flight mode onto a circle."""
        order = self._order(first.circle, first)
        return CommandExchange(self._outbox, self._dialect.fly_circle(order, take_over=True))

    def take_control(self) -> None:
        """Begin to detect other operators: sidelong has control of the vehicle now."""
        self._in_control = True
        self._suspicion.forget()

    def upload(self, command: UploadPlan) -> None:
        """Bring a plan to the autopilot without flying it yet."""
        self._plan = command
        self._outbox.report(PlanStatus(self._outbox.time_s, command.number, "ready", by_command=True))

    def activate(self, command: ActivatePlan) -> None:
        """Fly a plan now."""
        plan = self._plan
        if plan is None or plan.number != command.number or self._closed:
            self._announce(command.number, "failed", "it is not the plan that was made ready")
            return
        self._flown, self._departing, self._due_s, self._command = plan, True, -math.inf, None
        self._waits = True

    def close(self) -> None:
        """Start nothing new."""
        self._closed, self._flown, self._departing = True, None, False

    def observe(self, aircraft: AircraftState, mode: str) -> None:
        """Process the aircraft's position and flight mode."""
        self._aircraft, self._mode = aircraft, mode
        if self._flown is not None and self._command is None and aircraft.time_s >= self._due_s:
            self._waits = True

    def expire(self) -> None:
        """Continue what is due: repeat or give up a command, and send the next circle of a transition."""
        self._waits = False
        if self._suspicion.active:
            return  # another operator may be in command: send nothing until that is known
        if self._command is not None:
            self._command.expire()
            self._judge()
        if self._flown is not None and self._command is None and self._outbox.time_s >= self._due_s:
            self._lead(self._flown)

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot."""
        if isinstance(report, CommandAcknowledged) and self._command is not None:
            self._command.receive(report)
            self._judge()
        circle = self._dialect.reported_circle(report)
        if circle is None or not self._in_control or self._mode != self._dialect.circle_mode:
            return
        ours = [order for _, order in self._ordered]
        if self._reported is not None:
            ours.append(self._reported)  # flown on, however long what was ordered since takes to arrive
        if any(max(abs(circle.x - order.x), abs(circle.y - order.y)) <= _SAME_E7 for order in ours):
            self._reported = circle
            if self._suspicion.active:
                self._suspicion.active = False
                self._waits = True
        elif self._suspicion.is_confirmed_by(self._outbox.link_s):
            self._outbox.report(ExternalControl(self._outbox.time_s, "another station has moved the circle"))

    def _lead(self, plan: UploadPlan) -> None:
        aircraft = self._aircraft
        if aircraft is None or self._mode != self._dialect.circle_mode:
            self._failed("the aircraft's place is not known" if aircraft is None else f"the mode is {self._mode}")
            return
        wanted = plan.plan.circle
        circle = leading_circle(plan.plan, aircraft, self._settings.aircraft.bank_max_rad)
        self._was_last = circle is None
        circle = circle or wanted
        # The autopilot flies another radius than commanded; what is known of that holds for every circle.
        circle = replace(circle, radius_m=circle.radius_m * plan.commanded.radius_m / wanted.radius_m)
        self._due_s = aircraft.time_s + _PERIOD_S
        order = self._order(circle, plan.plan, plan.home_m)
        self._command = CommandExchange(self._outbox, self._dialect.fly_circle(order, take_over=False))

    def _judge(self) -> None:
        command, plan = self._command, self._flown
        if command is None or not command.done:
            return
        self._command = None
        if plan is None:
            return
        if not command.accepted:
            self._failed(f"the autopilot's answer to a circle: {describe_result(command.result)}")
            return
        if self._was_last:
            self._flown = None
        if self._departing:
            self._departing = False
            self._suspicion.forget()
            self._announce(plan.number, "departed")

    def _failed(self, why: str) -> None:
        """Give a departure up; on the way, the circle before is flown on, and the next second tries again."""
        if self._departing and self._flown is not None:
            number, self._flown, self._departing = self._flown.number, None, False
            self._announce(number, "failed", why)
        self._due_s = self._outbox.time_s + _PERIOD_S

    def _order(self, circle: Circle, plan: Plan, home_m: float = 0.0) -> CircleOrder:
        order, now_s = self._settings.order(circle, plan, home_m), self._outbox.link_s
        while len(self._ordered) >= _REMEMBERED and now_s - self._ordered[0][0] > _REMEMBERED_S:
            self._ordered.popleft()
        self._ordered.append((now_s, order))
        return order

    def _announce(self, number: int, stage: str, detail: str = "") -> None:
        self._outbox.report(PlanStatus(self._outbox.time_s, number, stage, detail))  # type: ignore[arg-type]
