"""The truth next to a simulated flight."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from sidelong.app.analysis.truth import read_truth
from sidelong.app.errors import InputError
from sidelong.estimators.frames import LocalPlane
from tests.command_line import sidelong

PLANE = LocalPlane(47.4, 8.5)
HEADER = (
    "time_boot_s,target_east_m,target_north_m,target_lat_deg,target_lon_deg,"
    "uav_lat_deg,uav_lon_deg,uav_relative_alt_m,slant_range_m,bearing_deg,laser_valid,laser_outlier"
)


def row(time_s: float) -> str:
    """Target due north at 3 m/s from the origin, aircraft standing 100 m east."""
    target = PLANE.latitude_longitude_deg(0.0, 3.0 * time_s)
    aircraft = PLANE.latitude_longitude_deg(100.0, 0.0)
    return f"{time_s:.3f},0,0,{target[0]:.8f},{target[1]:.8f},{aircraft[0]:.8f},{aircraft[1]:.8f},120,0,0,1,0"


def truth_file(tmp_path, rows):
    path = tmp_path / "truth.csv"
    path.write_text("\n".join([HEADER, *rows, ""]))
    return path


def test_positions_and_velocity_are_interpolated(tmp_path):
    truth = read_truth(truth_file(tmp_path, [row(0.1 * i) for i in range(100)]))
    moment = truth.at(4.25, PLANE)
    assert moment.target_north_m == pytest.approx(12.75, abs=0.003)
    assert moment.target_east_m == pytest.approx(0.0, abs=0.003)
    assert moment.aircraft_east_m == pytest.approx(100.0, abs=0.003)
    assert moment.target_velocity_north_m_s == pytest.approx(3.0, abs=0.003)
    assert moment.target_velocity_east_m_s == pytest.approx(0.0, abs=0.003)


def test_there_is_no_truth_outside_its_time(tmp_path):
    truth = read_truth(truth_file(tmp_path, [row(10.0), row(11.0)]))
    assert truth.at(9.99, PLANE) is None
    assert truth.at(11.01, PLANE) is None
    assert truth.at(11.0, PLANE).target_velocity_north_m_s == pytest.approx(3.0, abs=0.003)
    assert [m.time_s for m in truth.moments(PLANE, 0.0, 99.0, 0.25)] == [10.0, 10.25, 10.5, 10.75]


def test_rows_that_are_cut_or_no_numbers_are_passed_over(tmp_path):
    rows = [row(1.0), "a,b", row(2.0).replace("8.5", "nan"), row(3.0), row(4.0)[:20]]
    assert list(read_truth(truth_file(tmp_path, rows)).time_s) == [1.0, 3.0]


def test_damage_never_ends_in_anything_but_an_input_error(tmp_path):
    rng = random.Random(1)
    path = truth_file(tmp_path, [row(i) for i in range(30)])
    whole = path.read_bytes()
    for _ in range(200):
        begin = rng.randrange(len(whole))
        path.write_bytes(whole[:begin] + rng.choice([b"", rng.randbytes(9) + whole[begin + 9 :]]))
        try:
            truth = read_truth(path)
        except InputError:
            continue
        assert truth.time_s[0] < truth.time_s[-1]


def test_another_table_is_an_input_error(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("time_boot_s,speed\n1,2\n")
    with pytest.raises(InputError, match="lacks the column target_lat_deg"):
        read_truth(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_truth(tmp_path / "missing.csv")


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe is no file; give a CSV file"):
        read_truth(tmp_path / "pipe")


@pytest.mark.parametrize("command", ["replay", "report"])
def test_the_truth_of_another_flight_is_refused(tmp_path, command):
    data = Path(__file__).parents[1] / "data"
    log, other = tmp_path / "cut.tlog", data / "arduplane-follow-bike.truth.csv"
    whole = (data / "px4-follow-walk-and-drive.tlog").read_bytes()
    log.write_bytes(whole[: len(whole) // 4])
    place = ("--out", tmp_path / "out.html") if command == "report" else ("--planner", "paper", "--quiet")
    ended = sidelong(command, log, "--truth", other, *place)
    assert ended.returncode == 2
    assert "--truth: it is of another flight: the aircraft is 94" in ended.stderr
