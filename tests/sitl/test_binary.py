"""Someone's own simulator program: its command line, its life and its end."""

import math
import stat
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sidelong.sitl.binary import BinaryError, run_of, started
from sidelong.sitl.settings import Flavour, HomePosition, Settings
from sidelong.sitl.world.airframe import WindVector

HOME = HomePosition(47.0, 8.0, 400.0)
ARDUPLANE, PX4 = Settings(Flavour.ARDUPLANE), Settings(Flavour.PX4)


def program(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_arduplane_is_met_over_tcp_with_the_payload_on_its_third_port(tmp_path):
    run = run_of(replace(ARDUPLANE, home=HOME), tmp_path / "arduplane", tmp_path, 2, 3.0)
    assert run.url == "tcpout://127.0.0.1:5780"
    assert run.payload_url == "tcpout://127.0.0.1:5782"
    assert run.command[1:9] == ["--model", "plane", "--speedup", "3", "--home", "47.0,8.0,400.0,353", "-I", "2"]


def test_px4_is_met_over_udp_and_finds_its_start_files_next_to_it(tmp_path):
    run = run_of(PX4, tmp_path / "bin" / "px4", tmp_path / "work", 1, 5.0)
    assert (run.url, run.payload_url) == ("udpin://127.0.0.1:14541", "udpout://127.0.0.1:18571")
    assert run.command[1:] == ["-i", "1", "-d", "-w", str(tmp_path / "work"), str(tmp_path / "etc")]
    assert run.environment["PX4_SIM_SPEED_FACTOR"] == "5"
    assert run.environment["PX4_PARAM_SIH_F_T_MAX"] == "6"
    assert run.environment["PX4_PARAM_SIM_BAT_DRAIN"] == "10800"


def test_px4_before_1_16_takes_parameters_and_home_from_a_file_in_its_path(tmp_path):
    scripts = tmp_path / "etc" / "init.d-posix"
    scripts.mkdir(parents=True)
    (scripts / "rcS").write_text(". px4-rc.params\n")
    run = run_of(replace(PX4, home=HOME), tmp_path / "bin" / "px4", tmp_path, 0, 1.0)
    assert run.environment["PATH"].startswith(f"{tmp_path}:")
    assert not any(name.startswith(("PX4_PARAM_", "PX4_HOME_")) for name in run.environment)
    assert (tmp_path / "px4-rc.params").read_text().splitlines()[:7] == [
        "param set SIM_BAT_DRAIN 10800",
        "param set SIM_BAT_MIN_PCT 0",
        "param set SIH_LOC_LAT0 470000000",
        "param set SIH_LOC_LON0 80000000",
        "param set SIH_LOC_H0 400.0",
        "param set PWM_MAIN_FUNC1 201",
        "param set PWM_MAIN_FUNC2 202",
    ]


def test_the_wind_is_given_as_each_program_takes_it(tmp_path):
    wind = WindVector.blowing_from(4.0, math.radians(270.0))
    arduplane = run_of(replace(ARDUPLANE, wind=wind), tmp_path / "arduplane", tmp_path, 0, 1.0)
    assert arduplane.command[-2:] == ["--defaults", str(tmp_path / "own.parm")]
    assert (tmp_path / "own.parm").read_text() == "BATT_CAPACITY 30000\nSIM_WIND_SPD 4\nSIM_WIND_DIR 270\n"
    px4 = run_of(replace(PX4, wind=wind), tmp_path / "bin" / "px4", tmp_path, 0, 1.0)
    from_m_s = [float(px4.environment[f"PX4_PARAM_SIH_WIND_{axis}"]) for axis in "NE"]
    assert from_m_s == pytest.approx([0.0, -4.0], abs=1e-9)


def test_the_battery_lasts_as_long_as_asked_for(tmp_path):
    run_of(replace(ARDUPLANE, endurance_s=1800.0), tmp_path / "arduplane", tmp_path, 0, 1.0)
    assert (tmp_path / "own.parm").read_text() == "BATT_CAPACITY 5000\n"
    px4 = run_of(replace(PX4, endurance_s=1800.0), tmp_path / "bin" / "px4", tmp_path, 0, 1.0)
    assert px4.environment["PX4_PARAM_SIM_BAT_DRAIN"] == "1800"
    assert px4.environment["PX4_PARAM_SIM_BAT_MIN_PCT"] == "0"


def test_what_cannot_be_run_is_reported(tmp_path):
    with pytest.raises(BinaryError, match="no program that can be run"), started(PX4, tmp_path / "px4", 1.0):
        pass


def test_it_ends_with_us_and_its_folder_too(tmp_path):
    announced = tmp_path / "reported"
    binary = program(tmp_path / "arduplane", f"pwd > {announced}\nsleep 60")
    with started(ARDUPLANE, binary, 1.0) as running:
        while not (announced.exists() and announced.read_text()):
            assert not running.ended
        folder = Path(announced.read_text().strip())
        assert folder.is_dir()
    assert running.ended
    assert not folder.exists()


def test_what_a_script_has_started_ends_with_it(tmp_path):
    reported = tmp_path / "reported"
    waits = f"""sh -c 'trap "" TERM; echo $$ > {reported}; sleep 60' &"""  # as ArduPlane does for its physics
    with started(ARDUPLANE, program(tmp_path / "arduplane", f"{waits}\nwait"), 1.0) as running:
        while not (reported.exists() and reported.read_text()):
            assert not running.ended
    state = Path(f"/proc/{int(reported.read_text())}/stat")
    while state.exists() and state.read_text().rpartition(")")[2].split()[0] not in "ZX":
        pass  # the test's limit of time is that of a child that lives on


def test_its_folder_stays_where_its_logs_are_wanted(tmp_path):
    binary = program(tmp_path / "arduplane", "mkdir logs; echo flown > logs/1.BIN; sleep 60")
    with started(replace(ARDUPLANE, logs=tmp_path / "kept"), binary, 1.0) as running:
        log = running.folder / "logs" / "1.BIN"
        while not (log.exists() and log.read_text()):
            assert not running.ended
    assert running.ended
    assert log.read_text() == "flown\n"
    assert log.is_relative_to(tmp_path / "kept")


def test_a_folder_for_logs_that_cannot_be_made_is_reported(tmp_path):
    binary = program(tmp_path / "arduplane", "sleep 60")
    running = started(replace(ARDUPLANE, logs=binary / "kept"), binary, 1.0)
    with pytest.raises(BinaryError, match="cannot keep its logs"), running:
        pass


def test_the_command_reports_why_a_program_has_ended(tmp_path):
    binary = program(tmp_path / "arduplane", "echo no such model; exit 3")
    done = subprocess.run(
        [sys.executable, "-m", "sidelong.sitl", "--binary", binary],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 2
    assert "sidelong launch --connect tcpout://127.0.0.1:" in done.stdout
    assert "code 3: no such model" in done.stderr
