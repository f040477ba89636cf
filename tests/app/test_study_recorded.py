import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sidelong.app.commands.study import study
from sidelong.app.errors import InputError
from sidelong.app.study.judging import judged
from sidelong.app.study.laws import run_law
from sidelong.app.study.recorded import prepared, recorded_targets
from sidelong.app.study.scene import scene
from sidelong.app.study.settings import (
    LVFG,
    StudySettings,
)
from sidelong.sitl.world.track import RecordedTrack, read_track

TARGETS = Path(__file__).parents[2] / "app" / "study" / "tracks"
MEASURES = (
    *("time_in_band", "time_on_side", "time_on_side_now", "min_range_m", "moves_per_hour"),
    "reversals_per_hour",
)


@pytest.fixture
def command():
    app = typer.Typer()
    app.command()(study)
    return lambda *words: CliRunner().invoke(app, words)


def write(file, rows, header="t_s,east_m,north_m"):
    file.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return file


def eastward(speed_m_s, duration_s=120):
    return [(t, speed_m_s * t, 0.0) for t in range(duration_s + 1)]


def of_track(time_s, east_m, north_m=None):
    return prepared(
        "x", RecordedTrack(list(time_s), list(east_m), list(north_m if north_m is not None else 0.0 * east_m))
    )


def test_every_recorded_target_is_reported_and_those_too_fast_are_skipped(command, tmp_path):
    summary = tmp_path / "study.json"
    result = command(
        *("--targets", str(TARGETS), "--airspeed", "12", "--radius", "40", "--target-speed", "5"),
        *("--planner", "lvfg", "--planner", "paper", "--duration", "60", "--jobs", "1", "--json", str(summary)),
    )
    assert result.exit_code == 0, result.output
    given = json.loads(summary.read_text())
    assert (given["targets"], given["skipped"], given["runs"]) == (5, 2, 5)
    assert [skipped["file"] for skipped in given["skipped_targets"]] == ["cycle_016.csv", "cycle_021.csv"]
    assert "skipped cycle_016.csv: 95th percentile of speed 6.5 m/s is above 5 m/s" in " ".join(result.output.split())
    for planner in given["planners"].values():
        assert (planner["targets"], planner["skipped"]) == (5, 2)
        for measure in MEASURES:
            assert {"mean", "worst"} <= set(planner[measure])
        assert 0.0 <= planner["time_on_side"]["worst"] <= planner["time_on_side"]["mean"] <= 1.0
        assert planner["min_range_m"]["worst"] <= planner["min_range_m"]["mean"]
        assert planner["moves_per_hour"]["worst"] >= planner["moves_per_hour"]["mean"]


def test_noise_is_drawn_again_while_the_target_is_the_same(command, tmp_path):
    settings = StudySettings(tracks=recorded_targets([TARGETS / "run_011.csv"], 5.0).flown, runs=1, noise_draws=2)
    one, other = scene(settings, 0), scene(settings, 1)
    assert one.target is other.target
    assert one.duration_s == pytest.approx(1199.5)
    assert one.sensor_rng.normal() != other.sensor_rng.normal()
    assert one.start_rng.uniform() != other.start_rng.uniform()


def test_a_random_targets_further_draws_keep_its_motion():
    settings = StudySettings(runs=2, noise_draws=2)
    first, again = (scene(settings, number) for number in (1, 3))
    assert first.target.at(777.0) == again.target.at(777.0)
    assert first.sensor_rng.normal() != again.sensor_rng.normal()


def test_a_tracks_noise_is_its_own_whatever_else_is_flown(tmp_path):
    whole = recorded_targets([TARGETS], 20.0).flown
    number = [target.name for target in whole].index("run_011")
    alone = StudySettings(tracks=recorded_targets([TARGETS / "run_011.csv"], 20.0).flown, runs=1)
    among = StudySettings(tracks=whole, runs=len(whole))
    assert scene(alone, 0).sensor_rng.normal() == scene(among, number).sensor_rng.normal()


def test_columns_may_stand_in_any_order_and_rows_may_have_holes(tmp_path):
    rows = [(0.0, 5.0, f"{t / 2}", t, 3.0 * t) for t in range(0, 121, 2)]
    file = write(tmp_path / "a.csv", rows, "height_m, North_M ,note,t_s,east_m")
    with file.open("a") as more:
        more.write("1,,x,130,400\n\n,,,,\n7,5\n")
    track = read_track(file)
    assert track.time_s[-1] == 120.0
    assert track.east_m[-1] == 360.0
    assert set(track.north_m) == {5.0}


def test_semicolons_byte_order_marks_and_time_from_anywhere_are_read(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("\ufefft_s;east_m;north_m\n1005;3;4\n1000;1;2\n1000;9;9\n", encoding="utf-8")
    track = read_track(file)
    assert list(track.time_s) == [0.0, 5.0]
    assert list(track.east_m) == [1.0, 3.0]


def test_a_fast_car_is_no_spike(tmp_path):
    track = read_track(write(tmp_path / "car.csv", eastward(30.0)))
    assert len(track.time_s) == 121


def test_a_jump_is_taken_out_and_a_gap_bridged():
    time_s = np.r_[np.arange(0.0, 101.0), np.arange(400.0, 501.0)]
    east_m = 2.0 * time_s
    east_m[50:] += 700.0
    target = of_track(time_s, east_m)
    assert target.duration_s == pytest.approx(499.5)
    assert target.speed_p95_m_s == pytest.approx(2.0, abs=0.01)
    assert np.abs(np.gradient(target.east_m, 0.5)).max() < 2.01
    # The step with the jump, two metres of motion of it, is left out.
    assert target.at(450.0).east_m == pytest.approx(898.0, abs=1.0)


def test_the_track_is_smoothed_over_two_and_a_half_seconds():
    time_s = np.arange(0.0, 60.5, 0.5)
    north_m = np.where(np.arange(time_s.size) == 60, 10.0, 0.0)
    target = of_track(time_s, 0.0 * time_s, north_m)
    np.testing.assert_allclose(target.north_m[57:64], [0, 2, 2, 2, 2, 2, 0], atol=1e-12)


def test_the_course_is_held_while_the_target_stands():
    east_m = np.r_[np.zeros(20), np.linspace(0.0, 100.0, 100), np.full(200, 100.0)]
    time_s = 0.5 * np.arange(east_m.size)
    target, still = of_track(time_s, east_m), of_track(time_s, 0.0 * east_m)
    np.testing.assert_allclose(target.sampled(time_s)[:, 4], math.pi / 2)
    assert not still.sampled(time_s)[:, 4].any()


def log_next_to(north_m, seconds=100, side_m=300.0):
    """A target going north, then (an array of places) as reported; the aircraft stays due west of it."""
    time_s = 0.1 * np.arange(10 * seconds)
    place_m = np.interp(time_s, np.arange(north_m.size), north_m)
    zero = np.zeros(time_s.size)
    return np.stack([time_s, zero - side_m, place_m, zero, place_m, zero], axis=1)


def test_the_side_follows_the_course_made_good_and_not_the_present_one():
    # North for 50 s at 4 m/s, then back: the course made good in 20 s turns after 10 s.
    north_m = np.r_[4.0 * np.arange(50), 200.0 - 4.0 * np.arange(51)]
    tracks = (of_track(np.arange(101.0), 0.0 * north_m, north_m),)
    found = judged(StudySettings(tracks=tracks, runs=1), log_next_to(north_m), [1.0, 9.0, 19.0, 40.0], [], False)
    judged_s = 100.0 - 2.5
    assert found.time_on_side == pytest.approx((50.0 + 10.0 - 2.5) / judged_s, abs=0.02)
    assert found.time_on_side_now == pytest.approx((50.0 - 2.5) / judged_s, abs=0.02)
    assert found.time_in_band == 1.0
    assert found.moves_per_hour == pytest.approx(4 * 36.0)
    assert found.reversals_per_hour == pytest.approx(36.0)  # 8 s; 10 s and 21 s are not


def test_time_before_the_target_has_moved_is_not_judged():
    # It stands for 50 s, then goes south: the aircraft is on the wrong side all the time that counts.
    north_m = np.r_[np.zeros(50), -4.0 * np.arange(51)]
    tracks = (of_track(np.arange(101.0), 0.0 * north_m, north_m),)
    found = judged(StudySettings(tracks=tracks, runs=1), log_next_to(north_m), [], [], False)
    assert found.time_on_side == found.time_on_side_now == 0.0


def test_a_target_that_never_moves_has_no_side_and_spoils_no_mean(command, tmp_path):
    write(tmp_path / "still.csv", [(t, 0.0, 0.0) for t in range(0, 200, 5)])
    summary = tmp_path / "study.json"
    words = ("--targets", str(tmp_path), "--planner", "lvfg", "--jobs", "1", "--json", str(summary))
    assert command(*words).exit_code == 0
    given = json.loads(summary.read_text())["planners"]["lvfg"]
    assert given["time_on_side"]["mean"] is given["time_on_side_now"]["worst"] is None
    assert given["time_in_band"]["mean"] == 1.0
    write(tmp_path / "walk.csv", eastward(1.5))
    assert command(*words).exit_code == 0
    assert json.loads(summary.read_text())["planners"]["lvfg"]["time_on_side"]["mean"] > 0.2


def test_what_cannot_be_flown_is_skipped_and_reported(command, tmp_path):
    write(tmp_path / "good.csv", eastward(2.0))
    write(tmp_path / "short.csv", eastward(2.0, 5))
    write(tmp_path / "broken.csv", [("noon", 1, 2)])
    (tmp_path / "empty.gpx").write_text("<gpx></gpx>")
    write(tmp_path / "manifest.csv", [("good.csv", "walk")], "file,kind")
    (tmp_path / "notes.txt").write_text("hello")
    found = recorded_targets([tmp_path], 5.0)
    assert [target.name for target in found.flown] == ["good"]
    assert [file for file, _ in found.skipped] == ["broken.csv", "empty.gpx", "short.csv"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--targets", "nowhere"), "nowhere"),
        (("--targets", str(TARGETS), "--target-speed", "0.1"), "--target-speed"),
        (("--targets", str(Path(__file__).parent)), "no .csv or .gpx track"),
        (("--targets", str(TARGETS), "--airspeed", "1"), "--airspeed"),
        (("--targets", str(TARGETS), "--airspeed", "30", "--radius", "50"), "radius_m"),
        (("--targets", str(TARGETS), "--radius", "300"), "radius_m"),
    ],
)
def test_wrong_input_is_one_sentence(command, words, named):
    result = command(*words)
    assert isinstance(result.exception, InputError)
    assert named in str(result.exception)
    assert "\n" not in str(result.exception)


def test_the_whole_track_is_flown():
    tracks = recorded_targets([TARGETS / "hike_014.csv"], 5.0).flown
    settings = StudySettings(tracks=tracks, runs=1, duration_s=math.inf, perfect_sensors=True)
    flown = run_law(settings, LVFG, 0, keep_track=True).track
    assert flown.time_s[-1] == pytest.approx(tracks[0].duration_s, abs=0.2)
    end = tracks[0].at(flown.time_s[-1])
    assert tuple(flown.target_m[-1]) == pytest.approx((end.east_m, end.north_m))


def test_tables_without_a_tracks_columns_are_not_called_missing(tmp_path):
    write(tmp_path / "a.csv", eastward(2.0), header="t_s,x,y")
    with pytest.raises(InputError, match=r"no \.csv or \.gpx track with its columns"):
        recorded_targets([tmp_path], 5.0)
