"""What the page is shown of a snapshot."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.analysis.summary import SummaryCollector
from sidelong.app.config import Config
from sidelong.app.view.state import StateEncoder, setting
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.control.present import Phase
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.requirement import Requirement, Sector, Side
from sidelong.mission.route.route import RouteProgress, route_of

LEFT = Requirement(100.0, 500.0, Side.LEFT, 3.0)


@pytest.fixture(scope="module")
def snapshots(flight):
    """Return a snapshot each 0.1 s of a flight in which the circle is moved once."""
    taken = []
    for _, _, controller in flight(150.0):
        if not taken or controller.time_s > taken[-1].time_s:
            taken.append(controller.snapshot())
    return taken


@pytest.fixture
def watching(snapshots):
    return snapshots[-1]


def state_of(snapshot, requirement=LEFT):
    return StateEncoder(15.0, 100.0).state(replace(snapshot, requirement=requirement), 0.0)


def test_every_state_is_strict_json(snapshots):
    encoder = StateEncoder(15.0, 100.0)
    for snapshot in snapshots:
        json.dumps(encoder.state(snapshot, 0.0), allow_nan=False)


def test_the_shares_of_the_time_are_those_of_the_summary(snapshots):
    """Also where a minute of the flight is unknown: it counts as neither in band nor on side."""
    failed_s = snapshots[-1].time_s - 60.0
    taken = [replace(one, unknown="no range" if one.time_s > failed_s else "") for one in snapshots]
    encoder, collector = StateEncoder(15.0, 100.0), SummaryCollector(taken[0].requirement)
    for snapshot in taken:
        state = encoder.state(snapshot, 0.0)
        collector.observe(snapshot)
    start_s = next(one.time_s for one in taken if one.phase.in_control)
    found = collector.scored(None, None, start_s)
    assert found.time_unknown > 0.3
    assert state["share_in_band"] == pytest.approx(found.time_in_band, abs=0.01)
    assert state["share_on_side"] == pytest.approx(found.time_on_side, abs=0.01)


def test_inputs_that_are_not_ok_are_sent_in_words(watching):
    reports = [
        InputReport(one, state, watching.time_s - 7.0, 1.0, "")
        for one, state in ((Input.LASER, InputState.OK), (Input.GIMBAL, InputState.SWITCHED))
    ]
    assert state_of(replace(watching, health=tuple(reports)))["inputs"] == ["gimbal switched for 7 s"]


def test_anything_not_known_is_null(snapshots):
    first = state_of(snapshots[0])
    assert first["time_s"] is None
    assert first["aircraft"] is None
    assert first["target"] is None
    assert first["nis"] is None
    assert first["range_age_s"] is None


def test_the_route_and_the_expected_path_along_it_are_sent(watching):
    route = route_of(np.array([0.0, 0.0, 400.0]), np.array([0.0, 300.0, 300.0]), lap=True)
    on = state_of(replace(watching, route=RouteProgress(route, True, 290.0, 4.0, 0.9, math.nan)))["route"]
    assert (on["on"], on["along_m"], on["length_m"], on["to_end_s"]) == (True, 290.0, 1200.0, None)
    assert on["ahead"][2] == pytest.approx([30.0, 300.0], abs=3.0)  # 10 s later, around the corner
    assert on["of_use"]
    unused = RouteProgress(route, True, 290.0, 4.0, 0.9, math.nan, of_use=False)
    assert not state_of(replace(watching, route=unused))["route"]["of_use"]
    off = state_of(replace(watching, route=RouteProgress(route, False, math.nan, math.nan, 0.1, math.nan)))["route"]
    assert (off["on"], off["along_m"], off["ahead"]) == (False, None, [])
    (drawn,) = setting(Config(), None, "", routes=[route])["routes"]
    assert drawn[0] == drawn[-1] == [0.0, 0.0]


def test_the_target_is_carried_on_from_its_estimate(watching):
    estimate = TargetEstimate(
        watching.time_s - 2.0, 50.0, 80.0, 3.0, -1.0, np.diag([4.0, 1.0, 1.0, 1.0]), TrackQuality.GOOD, 0.0
    )
    target = state_of(replace(watching, estimate=estimate))["target"]
    assert target["at_m"] == [56.0, 78.0]
    aircraft = watching.aircraft
    assert target["range_m"] == pytest.approx(math.hypot(aircraft.east_m - 56.0, aircraft.north_m - 78.0), abs=0.06)
    assert target["ellipse"][:2] == pytest.approx([2.0 * 2.4477, 2.4477], abs=0.01)
    assert target["ellipse"][2] == pytest.approx(math.pi / 2, abs=1e-3)  # longest east and west


@pytest.mark.parametrize(
    ("aircraft_m", "side", "angle_deg"),
    [
        ((0.0, 200.0), Side.LEFT, 0.0),
        ((0.0, 200.0), Side.RIGHT, -180.0),
        ((200.0, 0.0), Side.LEFT, 90.0),
        ((-200.0, 0.0), Side.LEFT, -90.0),
    ],
)
def test_the_observation_angle_counts_from_abeam_of_a_target_that_drives_east(watching, aircraft_m, side, angle_deg):
    estimate = TargetEstimate(watching.time_s, 0.0, 0.0, 3.0, 0.0, np.eye(4), TrackQuality.GOOD, watching.time_s)
    aircraft = replace(watching.aircraft, east_m=aircraft_m[0], north_m=aircraft_m[1])
    now = replace(watching, aircraft=aircraft, estimate=estimate, course_rad=None, present_course_rad=math.pi / 2)
    target = state_of(now, replace(LEFT, side=side))["target"]
    assert math.degrees(target["angle_rad"]) == pytest.approx(angle_deg, abs=0.01)


def test_in_a_sector_the_angle_counts_from_its_middle(watching):
    sector = Sector(math.radians(60.0), math.radians(120.0))
    estimate = TargetEstimate(watching.time_s, 0.0, 0.0, 3.0, 0.0, np.eye(4), TrackQuality.GOOD, watching.time_s)
    aircraft = replace(watching.aircraft, east_m=200.0, north_m=0.0)
    state = state_of(replace(watching, aircraft=aircraft, estimate=estimate), replace(LEFT, sector=sector))
    assert state["target"]["angle_rad"] == pytest.approx(0.0, abs=1e-3)


def test_a_coming_plan_has_its_line_and_its_time(snapshots):
    coming = [snapshot for snapshot in snapshots if snapshot.coming is not None]
    assert coming
    plan = state_of(coming[0])["coming"]
    line = coming[0].coming.transition
    assert plan["in_s"] == pytest.approx(coming[0].coming.departure_s - coming[0].time_s, abs=0.06)
    assert plan["line"][0] == pytest.approx([line.east_m[0], line.north_m[0]], abs=0.06)
    assert plan["line"][-1] == pytest.approx([line.east_m[-1], line.north_m[-1]], abs=0.06)
    assert len(plan["line"]) < 150


def test_the_flown_transition_is_shown_only_until_the_circle_is_reached(snapshots):
    after = [snapshot for snapshot in snapshots if snapshot.plan is not None and snapshot.plan.transition is not None]
    assert state_of(after[0])["present"]["line"]
    assert not state_of(after[-1])["present"]["line"]


def test_ages_are_those_of_the_sensors_in_use(watching):
    ages = {"range_s": watching.time_s - 3.0, "gimbal_s": watching.time_s - 0.5}
    state = StateEncoder(15.0, 100.0).state(replace(watching, **ages), silent_s=1.25)
    assert (state["range_age_s"], state["gimbal_age_s"], state["link_age_s"]) == (3.0, 0.5, 1.25)


def test_a_yielded_mission_reports_so(watching):
    assert state_of(replace(watching, phase=Phase.YIELDED))["phase"] == "yielded"


def test_fences_are_drawn_once_the_plane_is_known():
    corners = [(47.0, 8.0), (47.001, 8.0), (47.001, 8.001)]
    config = Config.model_validate({"fences": {"keep_in": [corners], "rally": corners[:1]}})
    assert setting(config, None, "")["keep_in"] == setting(config, None, "")["rally"] == []
    assert setting(config, LocalPlane(47.0, 8.0), "")["rally"] == [[0.0, 0.0]]
    (outline,) = setting(config, LocalPlane(47.0, 8.0), "")["keep_in"]
    assert outline[0] == [0.0, 0.0]
    assert outline[1] == pytest.approx([0.0, 111.2], abs=0.2)
    assert outline[2] == pytest.approx([76.1, 111.2], abs=0.3)


def test_the_ground_ahead_is_that_below_the_path_up_to_the_end_of_the_next_lap(snapshots):
    coming = next(one for one in snapshots if one.coming is not None)
    encoder, plan = StateEncoder(15.0, 100.0), coming.coming
    rises_m = np.tile(np.linspace(-400.0, 400.0, 81, dtype=np.float32), (81, 1))  # a metre in ten to the east
    encoder.ground = Ground(rises_m, -4000.0, -4000.0, 100.0, 100.0)
    ahead = encoder.state(coming, 0.0)["ahead"]
    lap_m = math.tau * plan.circle.radius_m
    assert lap_m + 0.8 * plan.transition.length_m < ahead["length_m"] < lap_m + 1.01 * plan.transition.length_m
    assert ahead["ground_m"][0] == pytest.approx(0.1 * plan.transition.east_m[0], abs=3.0)
    on_lap_m = 0.1 * (plan.circle.east_m + plan.circle.radius_m), 0.1 * (plan.circle.east_m - plan.circle.radius_m)
    assert max(ahead["ground_m"][-20:]) == pytest.approx(on_lap_m[0], abs=2.0)
    assert min(ahead["ground_m"][-20:]) == pytest.approx(on_lap_m[1], abs=2.0)
    assert set(ahead["height_m"]) == {100.0}
    assert StateEncoder(15.0, 100.0).state(coming, 0.0)["ahead"] is None
