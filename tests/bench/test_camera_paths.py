"""How well a camera's tracker follows a target from one-sided circles, figures of eight, and circles around it.

``python -m pytest tests/bench/test_camera_paths.py -s``. A study flies each path by laser and gimbal. Along it the
simulator renders the same scenery, and the gimbal follows the camera's tracker alone: what is lost changes no path.
When the tracker has not been on the target for 20 s, an operator clicks the target again.

PATHS_TRACKS: targets; PATHS_S: length of each flight, s; SIDELONG_TARGETS: a folder of recorded tracks, without it
the targets are those of the benchmark. PATHS_FILE: a CSV file to which each flight is added, and whose flights are
not flown again; ``python docs/generate/camera_paths.py`` draws it.
"""

from __future__ import annotations

import csv
import math
import os
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from sidelong.app.camera.camera import Pictured, TargetCamera
from sidelong.app.study.benchmark import TRACKS
from sidelong.app.study.closed_loop import run
from sidelong.app.study.judging import JudgedTrack
from sidelong.app.study.laws import run_law
from sidelong.app.study.recorded import recorded_targets
from sidelong.app.study.settings import LVFG, ORBIT, PARK, PREDICTIVE, StudySettings, studied
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    Source,
)
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import flat_ground
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.sitl.payload.camera import GimbalCamera
from sidelong.sitl.settings import CameraSettings
from sidelong.sitl.world.picture import Image, Scenery
from tests.bench.size import SMOKE, size
from tests.camera.flight import clicked

FLIGHTS, DURATION_S = size(6, 1, "PATHS_TRACKS"), float(size(300, 30, "PATHS_S"))
ONE_SIDED, EIGHTS = "one-sided circles", "figures of eight"
PATHS: dict[str, tuple[str, float]] = {ONE_SIDED: (PREDICTIVE, 180.0), EIGHTS: (PREDICTIVE, 120.0)} | {
    one: (one, 180.0) for one in (LVFG, PARK, ORBIT)
}
"""Planner, and the pan limit that it plans for, degrees."""

_SPEED_MAX_M_S, _GRAVITY_M_S2, _SEED = 3.5, 9.81, 5
_STEP_S, _TELEMETRY_STEPS, _PIPELINE_S, _REPORT_EVERY_S = 0.02, 5, 0.15, 0.4
_CLICK_S, _BY_HAND_S, _CLICK_AGAIN_S, _WRONG_M = 2.0, 2.0, 20.0, 10.0
_GIMBAL, _CAMERA = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154), Source(IMAGE_TRACKER, 100)
_COLUMNS = (
    *("losses per hour", "lost %", "other object %", "clicks again per hour", "in middle half %", "on side %"),
    *("angle of view deg/s", "scale %/s", "range of scale p95/p5", "mean range m"),
)


def tracks():
    """Return the targets to fly next to."""
    folder = Path(os.environ.get("SIDELONG_TARGETS", TRACKS))
    flown = [one for one in recorded_targets([folder], _SPEED_MAX_M_S).flown if one.duration_s > DURATION_S]
    return tuple(flown[k] for k in np.linspace(0, len(flown) - 1, FLIGHTS).astype(int))


def path(kind: str, number: int) -> tuple[JudgedTrack, float]:
    """Fly next to a target; return the path and the height above it."""
    planner, pan_limit_deg = PATHS[kind]
    config = studied(
        airspeed_m_s=12.0, radius_m=40.0, target_speed_max_m_s=_SPEED_MAX_M_S, pan_limit_deg=pan_limit_deg
    )
    settings = StudySettings(
        (planner,), FLIGHTS, _SEED, config, duration_s=DURATION_S, tracks=tracks(), autopilot="arduplane"
    )
    result = (
        run(settings, planner, number, None, True)
        if planner == PREDICTIVE
        else run_law(settings, planner, number, True)
    )
    assert result.track is not None
    return result.track, config.aircraft.height_m


class Filmed:
    """A flown path with a gimbal camera.

    Attributes:
        rows: of each picture: time s, 1 object 0 lost, m of what is followed from the target (nan: lost), 1 in the
            middle half.
        clicks: by how often the operator had to click again.
    """

    def __init__(self, track: JudgedTrack, height_m: float) -> None:
        self._times_s, self._height_m = track.time_s, height_m
        steps_s = np.arange(0.0, track.time_s[-1], 1.0)
        target_m = np.stack([np.interp(steps_s, track.time_s, axis) for axis in track.target_m.T], axis=1)
        self.scenery = Scenery(target_m, lambda _e, _n: 0.0, _SEED)
        settings = CameraSettings()
        self._gimbal = GimbalCamera(settings, self.scenery)
        self._gimbal.on_picture = lambda time_s, picture: self._pictures.append((time_s, picture))
        self._pictures: deque[tuple[float, Image]] = deque()
        self._tracker = Tracker(TrackerSettings())
        self._tracker.stand_on(flat_ground(2.0))
        view_rad = math.radians(settings.view_deg)
        level = 1.0, 0.0, 0.0, 0.0
        self._camera = TargetCamera(view_rad, level, _PIPELINE_S, None, self._tracker.estimate)
        velocity_m_s = np.gradient(track.aircraft_m, track.time_s, axis=0)
        course_rad = np.unwrap(np.arctan2(*velocity_m_s.T))
        bank_rad = np.arctan(np.hypot(*velocity_m_s.T) * np.gradient(course_rad, track.time_s) / _GRAVITY_M_S2)
        self._columns = np.column_stack([track.aircraft_m, velocity_m_s, course_rad, bank_rad]).T
        self._report_s, self._by_hand_until_s, self._on_target_s = 0.0, _CLICK_S, 0.0
        self.rows: list[tuple[float, float, float, float]] = []
        self.clicks = 0

    def fly(self) -> None:
        """Fly it to the end."""
        for step in range(int(self._times_s[-1] / _STEP_S)):
            time_s = step * _STEP_S
            east_m, north_m, east_m_s, north_m_s, course_rad, bank_rad = (
                float(np.interp(time_s, self._times_s, column)) for column in self._columns
            )
            craft = SimpleNamespace(
                east_m=east_m, north_m=north_m, height_m=self._height_m, yaw_rad=course_rad, roll_rad=bank_rad
            )
            craft.gimbal_error_rad = lambda _bearing_rad: (0.0, 0.0)
            self._gimbal.step(time_s, _STEP_S, craft, (*self.scenery.target_m(time_s), 0.0))
            if step % _TELEMETRY_STEPS == 0:
                self._add(PositionReading(time_s, east_m, north_m, self._height_m, east_m_s, north_m_s, 0.0))
                self._add(AttitudeReading(time_s, bank_rad, 0.0, math.remainder(course_rad, math.tau)))
                turned = tuple(map(float, self._gimbal.attitude(0).q))
                self._add(GimbalReading(time_s, turned, "earth", _GIMBAL))
                self._point(time_s)
            while self._pictures and self._pictures[0][0] <= time_s - _PIPELINE_S:
                self._take(*self._pictures.popleft())

    def _add(self, reading: PositionReading | AttitudeReading | GimbalReading) -> None:
        self._camera.event(reading)
        self._tracker.add(reading)

    def _point(self, time_s: float) -> None:
        if math.isfinite(self._by_hand_until_s):
            self._gimbal.commanded = False
            return
        wanted = self._camera.pointing(time_s)
        if wanted is not None:
            self._gimbal.point(*wanted, is_of_earth=True)

    def _take(self, taken_s: float, picture: Image) -> None:
        found = self._camera.picture(picture, taken_s)
        if found is None or taken_s < self._by_hand_until_s:
            return
        if math.isfinite(self._by_hand_until_s):
            if clicked(self._camera, found.view, picture, self.scenery.target_m(taken_s)):
                self._by_hand_until_s, self._on_target_s = -math.inf, taken_s
            return
        off_m = self._judge(taken_s, found)
        if found.tracked.state == "object" and taken_s >= self._report_s:
            self._report_s = taken_s + _REPORT_EVERY_S
            bearing_rad, depression_rad = found.view.direction(found.tracked.box.x_px, found.tracked.box.y_px)
            sight = from_roll_pitch_yaw(0.0, -depression_rad, bearing_rad)
            self._add(GimbalReading(taken_s, sight, "earth", _CAMERA))
        if off_m < _WRONG_M:
            self._on_target_s = taken_s
        elif taken_s > self._on_target_s + _CLICK_AGAIN_S:
            self.clicks += 1
            self._by_hand_until_s = taken_s + _BY_HAND_S
            self._camera.stop()

    def _judge(self, taken_s: float, found: Pictured) -> float:
        target_m, off_m = self.scenery.target_m(taken_s), math.nan
        at, (width, height) = found.view.pixel(*target_m), found.view.size_px
        is_middle = at is not None and abs(at[0] / width - 0.5) < 0.25 and abs(at[1] / height - 0.5) < 0.25
        if found.tracked.state == "object":
            seen_m = found.view.ground(found.tracked.box.x_px, found.tracked.box.y_px)
            off_m = math.inf if seen_m is None else math.dist(seen_m, target_m)
        self.rows.append((taken_s, found.tracked.state == "object", off_m, is_middle))
        return off_m


def views(track: JudgedTrack, height_m: float) -> np.ndarray:
    """Return how the target is seen each second, (n, 2): angle from its course, rad, unwrapped, and range, m."""
    steps_s = np.arange(0.0, track.time_s[-1], 1.0)
    axes = (*track.aircraft_m.T, *track.target_m.T)
    east_m, north_m, target_east_m, target_north_m = (np.interp(steps_s, track.time_s, axis) for axis in axes)
    bearing_rad = np.arctan2(east_m - target_east_m, north_m - target_north_m)
    course_rad = np.nan_to_num(track.judged.course_rad[np.searchsorted(track.time_s, steps_s)])
    angle_rad = np.unwrap(bearing_rad - course_rad)
    return np.column_stack(
        [angle_rad, np.hypot(np.hypot(east_m - target_east_m, north_m - target_north_m), height_m)]
    )


def measured(kind: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Fly one path next to one target; return the values of the columns, and how the target was seen."""
    track, height_m = path(kind, number)
    filmed = Filmed(track, height_m)
    filmed.fly()
    rows, seen = np.array(filmed.rows), views(track, height_m)
    is_object, off_m = rows[:, 1] > 0.0, rows[:, 2]
    hours = (rows[-1, 0] - rows[0, 0]) / 3600.0
    losses = float(np.sum(is_object[:-1] & ~is_object[1:])) / hours
    wrong = float(np.mean(np.nan_to_num(off_m) > _WRONG_M))
    turned_deg, scaled = np.degrees(np.abs(np.diff(seen[:, 0]))), np.abs(np.diff(np.log(seen[:, 1])))
    scales = np.percentile(seen[:, 1], (95, 5))
    known = track.judged.side_known
    on_side = 100.0 * float(track.judged.on_side[known].mean()) if known.any() else math.nan
    shares = (
        100.0 * float(np.mean(~is_object)),
        100.0 * wrong,
        filmed.clicks / hours,
        100.0 * float(rows[:, 3].mean()),
    )
    changes = float(turned_deg.mean()), 100.0 * float(scaled.mean()), float(scales[0] / scales[1])
    return np.array([losses, *shares, on_side, *changes, float(seen[:, 1].mean())]), seen


def flights_of(file: Path) -> dict[tuple[str, str], list[float]]:
    """Return the values of the flights in a file, by path and target; add those that are missing."""
    if not file.exists():
        file.write_text(",".join(("path", "target", *_COLUMNS)) + "\n")
    with file.open(newline="") as read:
        known = {
            (kind, name): [float(value) for value in values] for kind, name, *values in list(csv.reader(read))[1:]
        }
    for number, target in enumerate(tracks()):
        for kind in PATHS:
            if (kind, target.name) not in known:
                values = known[kind, target.name] = measured(kind, number)[0].tolist()
                with file.open("a", newline="") as added:
                    csv.writer(added).writerow([kind, target.name, *(f"{value:.3f}" for value in values)])
    return known


@pytest.mark.timeout(14_400)
def test_one_sided_circles_change_the_view_less_than_circles_around_the_target(tmp_path):
    cv2.setNumThreads(1)
    flown, means = flights_of(Path(os.environ.get("PATHS_FILE", tmp_path / "paths.csv"))), {}
    print("\npath: " + ", ".join(_COLUMNS), end="")
    for kind in PATHS:
        rows = np.array([values for (path_flown, _), values in flown.items() if path_flown == kind])
        means[kind] = np.nanmean(rows, axis=0)
        errors = np.nanstd(rows, axis=0) / math.sqrt(len(rows))
        cells = (f"{mean:.1f} +- {error:.1f}" for mean, error in zip(means[kind], errors, strict=True))
        print(f"\n{kind}: " + ", ".join(cells), end="", flush=True)
    if not SMOKE:
        assert means[ONE_SIDED][4] >= 95.0
