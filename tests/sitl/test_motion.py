"""Target motions: speeds, turns, and how a recorded track is made plausible."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.sitl.world.motion import MOTIONS, built_in_motion
from sidelong.sitl.world.track import RecordedTrack, TrackMotion, read_track
from sidelong.sitl.world.track_file import TrackError

START_M = (250.0, 300.0)


def path(motion, seconds, step_s=0.1):
    return np.array([motion.at(step_s * i) for i in range(round(seconds / step_s))])


def speeds(points, step_s=0.1):
    return np.hypot(*np.diff(points, axis=0).T) / step_s


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(MOTIONS)), st.floats(0.0, 8.0), st.integers(0, 1000))
def test_every_motion_starts_at_its_start_and_keeps_to_its_speed(name, speed_m_s, seed):
    points = path(built_in_motion(name, START_M, speed_m_s, np.random.default_rng(seed)), 300.0)
    assert tuple(points[0]) == START_M
    assert speeds(points).max() <= speed_m_s + 1e-9


def test_the_walk_stops_strolls_and_runs_as_defined():
    rng = np.random.default_rng(4)
    speed = speeds(path(built_in_motion("walk", START_M, 5.0, rng), 40_000.0, 1.0), 1.0)
    still, fastest = (speed < 1e-9).mean(), (speed > 5.0 - 1e-6).mean()
    assert still == pytest.approx(1 / 3, abs=0.08)
    assert fastest == pytest.approx(1 / 3, abs=0.08)
    assert ((speed > 1e-9) & (speed < 1.0 - 1e-6)).mean() < 0.01  # only seconds that hold the end of a leg


def test_a_u_turn_comes_back():
    points = path(built_in_motion("u-turn", START_M, 3.0, np.random.default_rng(1)), 300.0)
    away_m = np.hypot(*(points - START_M).T)
    assert away_m.max() == pytest.approx(360.0, abs=12.0)
    assert away_m[1500:].min() < 20.0


def test_the_demonstration_walks_stops_and_turns_back_within_three_minutes():
    points = path(built_in_motion("demo", START_M, 3.0, np.random.default_rng(1)), 180.0)
    speed = speeds(points)
    away_m = np.hypot(*(points - START_M).T)
    assert speed[:1190].min() == pytest.approx(3.0)
    assert (speed < 1e-9).sum() == pytest.approx(150, abs=2)  # 15 s
    assert away_m[-1] < away_m[1300] - 100.0  # it is on its way back


def test_a_circle_closes():
    points = path(built_in_motion("circle", START_M, 3.0, np.random.default_rng(1)), 2 * math.pi * 60.0 / 3.0 + 0.1)
    assert math.dist(points[-1], START_M) < 0.4
    assert np.ptp(points[:, 0]) == pytest.approx(120.0, abs=0.2)


def test_the_same_seed_walks_the_same_way():
    one, other, third = (
        path(built_in_motion("walk", START_M, 3.0, np.random.default_rng(seed)), 600.0) for seed in (1, 1, 2)
    )
    assert (one == other).all()
    assert not (one == third).all()


def track(*points):
    time_s, east_m, north_m = zip(*points, strict=True)
    return RecordedTrack(time_s, east_m, north_m)


def test_a_gap_is_bridged_and_a_jump_is_walked():
    jump = track((0.0, 0.0, 0.0), (10.0, 20.0, 0.0), (11.0, 80.0, 0.0), (100.0, 80.0, 0.0))
    points = path(TrackMotion(jump, START_M, 5.0, 0.0), 60.0)
    assert tuple(points[0]) == START_M
    assert points[50] - START_M == pytest.approx([10.0, 0.0])
    assert speeds(points).max() <= 5.0 + 1e-9
    assert points[-1] - START_M == pytest.approx([80.0, 0.0])


def test_a_track_may_be_entered_later_and_ends_where_it_ends():
    line = track((0.0, 5.0, 5.0), (100.0, 105.0, 5.0))
    motion = TrackMotion(line, START_M, 5.0, 50.0)
    assert motion.at(0.0) == pytest.approx(START_M)
    assert motion.at(10.0) == pytest.approx((START_M[0] + 10.0, START_M[1]))
    assert motion.at(500.0) == pytest.approx((START_M[0] + 50.0, START_M[1]))


def test_the_lively_part_is_found():
    slow = [(10.0 * i, 1.0 * i, 0.0) for i in range(30)]
    lively = [(300.0 + 10.0 * i, 30.0 + 40.0 * i, 0.0) for i in range(30)]
    assert 240.0 <= track(*slow, *lively).first_motion_s() <= 300.0
    assert track(*slow).first_motion_s() == 0.0


def test_of_a_flights_own_export_the_target_is_taken(tmp_path):
    def track(name: str, latitude_deg: float) -> str:
        points = (
            f'<trkpt lat="{latitude_deg}" lon="{8.5 + 1e-5 * i}"><time>2026-11-21T09:00:{i:02}Z</time></trkpt>'
            for i in range(20)
        )
        return f"<trk><name>{name}</name><trkseg>{''.join(points)}</trkseg></trk>"

    file = tmp_path / "flight.gpx"
    space = 'xmlns="http://www.topografix.com/GPX/1/1"'
    file.write_text(f"<gpx {space}>{track('aircraft', 47.41)}{track('target', 47.4)}{track('aircraft', 47.42)}</gpx>")
    read = read_track(file)
    assert len(read.time_s) == 20
    assert read.north_m == pytest.approx([0.0] * 20, abs=0.01)
    file.write_text(f"<gpx {space}>{track('a ride', 47.41)}</gpx>")
    assert len(read_track(file).time_s) == 20


def test_a_gpx_track_is_read_without_its_spike(tmp_path):
    points = [(0, 45.0, 14.0), (10, 45.0001, 14.0), (20, 45.5, 14.0), (30, 45.0003, 14.0), (40, 45.0004, 14.0)]
    body = "".join(
        f'<trkpt lat="{lat}" lon="{lon}"><time>2010-08-06T10:36:{second:02d}Z</time></trkpt>'
        for second, lat, lon in points
    )
    file = tmp_path / "ride.gpx"
    file.write_text(f'<gpx xmlns="http://www.topografix.com/GPX/1/0"><trk><trkseg>{body}</trkseg></trk></gpx>')
    ride = read_track(file)
    assert list(ride.time_s) == [0.0, 10.0, 30.0, 40.0]
    assert ride.north_m[-1] == pytest.approx(44.45, abs=0.05)


@pytest.mark.parametrize(
    "text",
    ["time_s,east_m,north_m\n0,1,2\n5,3,4\n", "time,lat,lon\n2024-01-01T00:00:00Z,1,2\n2024-01-01T00:00:05Z,1,2\n"],
)
def test_a_csv_track_is_read(tmp_path, text):
    file = tmp_path / "track.csv"
    file.write_text(text)
    assert list(read_track(file).time_s) == [0.0, 5.0]


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("a.csv", "x,y\n1,2\n", "header"),
        ("a.csv", "time_s,east_m,north_m\n0,1,2\n", "two"),
        ("a.csv", "time_s,east_m,north_m\n0,one,2\n", "readable"),
        ("a.gpx", "<gpx><trk>", "readable"),
        ("a.gpx", "<gpx></gpx>", "two"),
        (
            "d.csv",
            "t_s,east_m,north_m\n0,0,0\nhello,1,1\n",
            "line 3, hello,1,1: 'hello' is neither seconds nor a time",
        ),
        (
            "d.csv",
            "t_s;east_m;north_m\n0;0;0\n1;1;one\n",
            "line 3, 1,1,one: could not convert string to float: 'one'",
        ),
    ],
)
def test_what_is_no_track_is_reported_by_name(tmp_path, name, text, word):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(TrackError, match=word) as caught:
        read_track(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(TrackError, match="cannot be read"):
        read_track(tmp_path / "none.gpx")
