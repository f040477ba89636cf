"""Circles by command: whose circle the autopilot reports it flies."""

import math

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, UploadPlan
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Wind
from sidelong.mission.exchange.dialect import ExchangeSettings, Home
from sidelong.mission.exchange.orbit_command import OrbitCommandBackend
from sidelong.mission.exchange.outbox import ExternalControl, Outbox
from sidelong.mission.exchange.reports import PositionTargetReported

AIRCRAFT = Aircraft(22.0, 80.0, math.radians(45.0))
SETTINGS = ExchangeSettings(
    LocalPlane(47.0, 8.0), Home(47.0, 8.0, 400.0), AIRCRAFT, 100.0, 15.0, True, True, lambda plan: plan
)
HERE = AircraftState(0.0, 0.0, 0.0, 0.0, 22.0, 0.0)


def plan_at(east_m):
    return Plan(Circle(east_m, 0.0, 80.0, True), None, 0.0)


def taken_over():
    """Return a backend that flies the first circle, and its outbox."""
    outbox = Outbox()
    backend = OrbitCommandBackend(outbox, ArduPlane(), SETTINGS)
    outbox.begin(0.0, 0.0)
    backend.take_over(plan_at(0.0))
    backend.take_control()
    backend.observe(HERE, "GUIDED")
    return backend, outbox


def reported(backend, outbox, link_s, east_m):
    """Let the autopilot report the circle that it flies; return whether another station is suspected for good."""
    outbox.begin(link_s, link_s)
    order = SETTINGS.order(plan_at(east_m).circle, plan_at(east_m))
    backend.receive(PositionTargetReported(link_s, link_s, order.x, order.y))
    return any(isinstance(one, ExternalControl) for one in outbox.derived)


def test_a_circle_of_ours_stays_ours_however_late_the_next_ones_arrive():
    """A slow vehicle still flies the first one long after others were ordered that it has not received yet."""
    backend, outbox = taken_over()
    assert not reported(backend, outbox, 0.5, 0.0)
    for number in range(1, 21):
        outbox.begin(float(number), float(number))
        backend.upload(
            UploadPlan(
                number, number, plan_at(50.0 * number), plan_at(50.0 * number).circle, plan_at(0.0), Wind(), ""
            )
        )
        backend.activate(ActivatePlan(number, number))
        backend.expire()
        assert not reported(backend, outbox, number + 0.5, 0.0)


def test_a_circle_of_no_one_here_is_someone_elses():
    backend, outbox = taken_over()
    assert not reported(backend, outbox, 0.5, 0.0)
    assert [reported(backend, outbox, 1.0 + 0.5 * k, -700.0) for k in range(4)] == [False, False, True, True]
