"""The object tracker on rendered pictures whose truth is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.camera.tracker import ObjectTracker, _Candidate, _Trial
from sidelong.app.camera.view import View
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.terrain.ground import Ground
from sidelong.sitl.world.picture import CameraPose, Scenery

RATE_HZ, VIEW_RAD, SIZE_PX = 15.0, math.radians(12.0), (640, 360)
SPEED_M_S, MIDDLE_M = 3.0, 0.75  # of the target, and the height of its middle
_PATH = np.array([(SPEED_M_S * t, 0.15 * t) for t in range(120)])


def run(
    scenery: Scenery,
    begin_s: float,
    end_s: float,
    tracker: ObjectTracker,
    clicked_off_px: tuple[float, float] = (0.0, 0.0),
) -> list[tuple[float, str, float]]:
    """Follow the target from a circling camera that looks at where it is; return time, state and error in metres."""
    rows = []
    for k in range(int((end_s - begin_s) * RATE_HZ)):
        time_s = begin_s + k / RATE_HZ
        target = scenery.target_m(time_s)
        angle = 0.05 * time_s
        here = (target[0] + 250.0 * math.sin(angle), target[1] + 250.0 * math.cos(angle), 100.0)
        east_m, north_m = target[0] - here[0], target[1] - here[1]
        yaw_rad, pitch_rad = math.atan2(east_m, north_m), math.atan2(-here[2], math.hypot(east_m, north_m))
        picture = scenery.picture(time_s, CameraPose(here, yaw_rad, pitch_rad), VIEW_RAD, SIZE_PX)
        focal_px = 0.5 * SIZE_PX[0] / math.tan(0.5 * VIEW_RAD)
        view = View(here, from_roll_pitch_yaw(0.0, pitch_rad, yaw_rad), focal_px, SIZE_PX, None)
        if k == 0:
            x_px, y_px = (0.5 * side + off for side, off in zip(SIZE_PX, clicked_off_px, strict=True))
            assert tracker.start(picture, time_s, view, x_px, y_px, None)
        tracked = tracker.update(picture, time_s, view, (SPEED_M_S, 0.15))
        off_m = math.nan
        if tracked.state == "object":
            above_m = *here[:2], here[2] - MIDDLE_M
            seen_m = replace(view, position_m=above_m).ground(tracked.box.x_px, tracked.box.y_px)
            off_m = math.dist(seen_m, target)
        rows.append((time_s, tracked.state, off_m))
    return rows


def scenery(**how) -> Scenery:
    return Scenery(_PATH, lambda _e, _n: 0.0, 3, **{"trees": 0.0, "lookalikes": 0.0, **how})


@pytest.mark.parametrize("kind", ["kcf", "csrt"])
def test_follows_a_target_that_moves_and_turns_in_the_picture(kind):
    rows = run(scenery(), 5.0, 15.0 if kind == "kcf" else 9.0, ObjectTracker(kind))
    assert all(state == "object" for _, state, _ in rows)
    assert max(off_m for *_, off_m in rows) < 4.0


@pytest.mark.parametrize("clicked_off_px", [(-18.0, 0.0), (18.0, 8.0)])
def test_finds_the_middle_of_a_target_that_was_clicked_at_its_edge_and_stays_there(clicked_off_px):
    rows = run(scenery(), 5.0, 25.0, ObjectTracker(), clicked_off_px)
    assert all(state == "object" for _, state, _ in rows)
    assert max(off_m for *_, off_m in rows[15:]) < 0.6


@pytest.mark.parametrize(("begin_s", "end_s"), [(10.0, 14.0), (22.5, 29.3)])  # the second time it turns end on
def test_finds_the_target_again_after_an_occlusion(begin_s, end_s):
    world = scenery()
    world.hidden_s.append((begin_s, end_s))
    rows = run(world, begin_s - 5.0, end_s + 8.0, ObjectTracker())
    assert all(state == "lost" for time_s, state, _ in rows if begin_s + 0.5 < time_s < end_s - 0.1)
    later = [(state, off_m) for time_s, state, off_m in rows if time_s > end_s + 6.0]
    assert all(state == "object" and off_m < 5.0 for state, off_m in later)


def test_what_is_behind_a_hill_is_not_in_the_picture():
    hill_m = 100.0
    ridge = scenery(sees=lambda one_m, other_m: not min(one_m[1], other_m[1]) < hill_m < max(one_m[1], other_m[1]))
    for north_m, is_seen in ((90.0, True), (110.0, False)):
        pose = CameraPose((0.0, north_m, 60.0), math.pi, -math.atan2(60.0, north_m))
        picture = ridge.picture(0.0, pose, VIEW_RAD, SIZE_PX)
        assert np.any(picture[..., 2] > 1.8 * picture[..., 1].astype(float)) == is_seen


def test_follows_no_look_alike_that_stood_next_to_the_target():
    world = scenery(lookalikes=1.5)
    assert world.standing
    world.hidden_s.append((10.0, 16.0))
    rows = run(world, 5.0, 27.0, ObjectTracker())
    assert all(off_m < 8.0 for *_, off_m in rows if not math.isnan(off_m))
    assert rows[-1][1] == "object"


def test_is_lost_again_when_what_was_found_is_hidden_at_once():
    tracker = ObjectTracker()
    run(scenery(), 5.0, 6.0, tracker)
    tracker._trial = _Trial((6.0, *tracker._at_m), _Candidate())
    tracker._lose()
    assert tracker.state == "lost"


def test_is_lost_rather_than_follow_something_else_while_the_target_is_gone():
    world = scenery(lookalikes=1.5)
    world.hidden_s.append((10.0, 60.0))
    rows = run(world, 5.0, 18.5, ObjectTracker())
    assert {state for time_s, state, _ in rows if time_s > 10.5} == {"lost"}


def test_a_target_hidden_for_long_is_looked_for_where_it_is_if_it_went_straight_on():
    world, tracker = scenery(), ObjectTracker()
    world.hidden_s.append((10.0, 60.0))
    rows = run(world, 8.0, 21.0, tracker)
    assert rows[-1][1] == "lost"
    looked_m = [tracker.expected_m(10.0 + hidden_s) for hidden_s in np.arange(15.0, 35.0)]
    went_m = [world.target_m(10.0 + hidden_s) for hidden_s in np.arange(15.0, 35.0)]
    off_m = [math.dist(*two) for two in zip(looked_m, went_m, strict=True)]
    assert sum(off < 10.0 for off in off_m) >= 6


def test_a_pixel_over_hills_is_where_its_line_of_sight_first_meets_the_ground():
    east_m, north_m = np.meshgrid(np.arange(-600.0, 601.0, 25.0), np.arange(-600.0, 601.0, 25.0))
    hills = Ground(
        (25.0 * np.sin(east_m / 90.0) * np.cos(north_m / 110.0)).astype(np.float32), -600.0, -600.0, 25.0, 25.0
    )
    for bearing_rad in np.radians(np.arange(0.0, 360.0, 15.0)):
        view = View((0.0, 0.0, 70.0), from_roll_pitch_yaw(0.0, -0.2, bearing_rad), 3000.0, SIZE_PX, hills)
        for pixel in ((320.0, 180.0), (30.0, 300.0), (600.0, 20.0)):
            at_m = view.ground(*pixel)
            assert view.pixel(*at_m) == pytest.approx(pixel, abs=0.1)
            assert hills.sees((0.0, 0.0, 70.0), (*at_m, view.ground_m(*at_m) + 0.3))
