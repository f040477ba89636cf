"""The simulation as a whole: repeatable, truthful, and able to fail on demand."""

import math
from itertools import pairwise

import pytest

from sidelong.sitl.settings import Flavour, HomePosition, TargetSettings
from sidelong.sitl.world.truth import HEADER, TruthFile


def flight(simulate, station, **changes):
    ground = station(simulate(**changes))
    rows = []
    ground.simulation.on_truth = rows.append
    ground.fly(ground.takeoff(80.0), ground.loiter(200.0, 200.0, 80.0, 80.0))
    ground.run(60.0)
    return ground, rows


@pytest.mark.parametrize("flavour", list(Flavour))
def test_the_same_seed_gives_the_same_bytes(simulate, station, flavour):
    one, _ = flight(simulate, station, flavour=flavour, seed=7)
    other, _ = flight(simulate, station, flavour=flavour, seed=7)
    assert one.frames == other.frames


def test_another_seed_gives_another_target_and_noise(simulate, station):
    _, one = flight(simulate, station, seed=1)
    _, other = flight(simulate, station, seed=2)
    assert one[-1].target_m != other[-1].target_m
    assert one[-1].aircraft_m == other[-1].aircraft_m


def test_small_steps_of_the_clock_lead_to_the_same_place(simulate, station):
    whole, fine = simulate(seed=3), simulate(seed=3)
    whole.advance(30.0)
    for i in range(1, 10_001):
        fine.advance(0.003 * i)
    assert fine.time_s == pytest.approx(whole.time_s)
    assert fine.motions[0].at(30.0) == whole.motions[0].at(30.0)


def test_truth_comes_ten_times_a_second_and_fits_the_telemetry(simulate, station):
    ground, rows = flight(simulate, station)
    times_s = [row.time_s for row in rows]
    assert [round(b - a, 6) for a, b in pairwise(times_s)] == [0.1] * (len(rows) - 1)
    truth = {round(row.time_s * 1000): row for row in rows}
    position = ground.last("GLOBAL_POSITION_INT")
    row = truth[position.time_boot_ms]
    assert (position.lat / 1e7, position.lon / 1e7) == pytest.approx(row.aircraft_deg, abs=6e-8)
    assert position.relative_alt / 1000.0 == pytest.approx(row.aircraft_m[2], abs=6e-4)
    east_m, north_m = (t - a for t, a in zip(row.target_m[:2], row.aircraft_m[:2], strict=True))
    assert row.bearing_rad == pytest.approx(math.atan2(east_m, north_m))
    assert row.slant_range_m == pytest.approx(math.hypot(east_m, north_m, row.aircraft_m[2]))


def test_the_truth_file_has_the_columns_of_the_recorded_ones(simulate, tmp_path):
    path = tmp_path / "truth.csv"
    simulation = simulate(targets=(TargetSettings(motion="still"),))
    with path.open("w") as file:
        simulation.on_truth = TruthFile(file).write
        simulation.advance(1.05)
        assert len(path.read_text().splitlines()) > 1  # flushed while it runs
        simulation.advance(3.0)
    lines = path.read_text().splitlines()
    assert lines[0] == HEADER
    assert HEADER.startswith("time_boot_s,target_east_m,target_north_m,target_lat_deg,target_lon_deg,uav_lat_deg,")
    assert lines[0].count(",") == lines[1].count(",") == 15
    assert lines[10].startswith("1.000,250.000,300.000,")
    assert all(
        line.endswith(",,") for line in lines[1:]
    )  # no ground is known: neither clearance nor sight is reported
    assert len(lines) == 31


def test_heartbeats_can_stop_while_all_else_goes_on(simulate, station):
    ground, _ = flight(simulate, station)
    ground.simulation.vehicle.silenced.add(0)
    before = len(ground.all("HEARTBEAT", 1))
    ground.run(10.0)
    assert len(ground.all("HEARTBEAT", 1)) == before
    assert ground.last("GLOBAL_POSITION_INT").time_boot_ms > (ground.simulation.time_s - 1.1) * 1000


@pytest.mark.parametrize(("flavour", "taken_over"), [(Flavour.ARDUPLANE, 5), (Flavour.PX4, 0x00030000)])
def test_the_pilot_can_take_over(simulate, station, flavour, taken_over):
    ground, _ = flight(simulate, station, flavour=flavour)
    ground.simulation.pilot_takes_over()
    ground.run(2.0)
    assert ground.mode() == taken_over
    assert not any(m.get_type() == "COMMAND_ACK" for m in ground.received[-30:])


def test_another_station_can_change_the_mode(simulate, station):
    ground, _ = flight(simulate, station)
    other = station(ground.simulation, alongside=ground, address="other", system_id=250)
    other.set_mode(12)
    ground.run(1.5)
    assert ground.mode() == 12


@pytest.mark.parametrize("flavour", list(Flavour))
def test_a_reboot_in_flight_is_silence_a_new_clock_and_the_old_mission(simulate, station, flavour):
    ground, _ = flight(simulate, station, flavour=flavour)
    ground.command_long(511, 30, 50_000.0)
    height_m = ground.simulation.vehicle.craft.height_m
    ground.simulation.reboot()
    received = len(ground.received)
    ground.run(1.9)
    assert len(ground.received) == received
    ground.run(10.0)
    assert ground.last("GLOBAL_POSITION_INT").time_boot_ms < 11_000
    assert ground.simulation.vehicle.armed
    assert ground.simulation.vehicle.craft.height_m == pytest.approx(height_m, abs=5.0)
    assert len(ground.download()) >= 2
    before = len(ground.all("ATTITUDE"))
    ground.run(4.0)
    assert len(ground.all("ATTITUDE")) - before < 70


def test_a_reboot_can_be_ordered_on_the_ground_only(simulate, station):
    ground = station(simulate(payload=None))
    ground.run(30.0)
    assert ground.command_long(246, 1) == 0
    ground.run(5.0)
    assert ground.last("SYSTEM_TIME").time_boot_ms < 5_000
    ground.run(25.0)
    ground.arm()
    assert ground.command_long(246, 1) == 4


@pytest.mark.parametrize("flavour", list(Flavour))
def test_home_can_be_anywhere(simulate, station, flavour):
    ground = station(simulate(flavour=flavour, home=HomePosition(-75.0, 179.999, 3000.0)))
    ground.fly(ground.takeoff(80.0), ground.loiter(300.0, 0.0, 80.0, 80.0))
    ground.run(60.0)
    position = ground.last("GLOBAL_POSITION_INT")
    assert abs(position.lon) <= 1_800_000_000
    assert position.alt == pytest.approx(3_080_000, abs=3000)
