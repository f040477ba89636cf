"""Somebody else takes the vehicle: not one command after its next heartbeat, and none ever again."""

import os

import pytest

pytestmark = pytest.mark.udp

TIMES = int(os.environ.get("TIMES", "1"))  # more of the same, with other seeds
WATCHED = "watched from now on"
A_HEARTBEAT_S = 1.0
ON_THE_WAY_S = 2.5  # of the vehicle's time: a quarter of a second at ten times the clock, on a busy machine


def commands_after(vehicle, happened_s):
    return [kind for time_s, kind in vehicle.commanded if time_s > happened_s + A_HEARTBEAT_S + ON_THE_WAY_S]


def assert_yielded(vehicle, application, act, words, seed=1):
    application.wait_for(WATCHED)
    vehicle.wait(5.0 + 3.0 * seed)
    happened_s = vehicle.do(lambda: (act(), vehicle.simulation.time_s)[1])
    application.wait_for("commanding nothing more")
    vehicle.wait(30.0)
    assert commands_after(vehicle, happened_s) == []
    summary = application.end()
    assert summary["outcome"].startswith("yielded")
    assert words in summary["outcome"]
    return happened_s


@pytest.mark.parametrize("seed", range(1, TIMES + 1))
@pytest.mark.parametrize(
    ("flavour", "guidance", "mode", "name"),
    [
        ("arduplane", "mission", 12, "LOITER"),
        ("px4", "command", 0x05040000, "RTL"),
    ],
)
def test_another_station_changes_the_mode(vehicle_of, launch, flavour, guidance, mode, name, seed):
    vehicle = vehicle_of(flavour, seed)
    application = launch(vehicle.url, "--guidance", guidance)
    assert_yielded(vehicle, application, lambda: vehicle.autopilot.set_mode(mode), f"changed to {name}", seed)


def test_the_pilot_takes_over_and_gives_back_and_is_left_alone(vehicle_of, launch):
    vehicle = vehicle_of("arduplane")
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    vehicle.do(vehicle.simulation.pilot_takes_over)
    application.wait_for("commanding nothing more")
    vehicle.wait(5.0)
    given_back_s = vehicle.do(lambda: (vehicle.autopilot.set_mode(10), vehicle.simulation.time_s)[1])
    vehicle.wait(30.0)
    assert commands_after(vehicle, given_back_s) == []


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_another_station_uploads_a_mission(vehicle_of, launch, flavour):
    vehicle = vehicle_of(flavour)
    foreign = vehicle.circle_mission(120.0, 400.0, -300.0)
    foreign.append(foreign[-1])
    application = launch(vehicle.url)
    assert_yielded(vehicle, application, lambda: vehicle.put_mission(foreign), "another station")


def test_another_station_moves_the_circle(vehicle_of, launch):
    vehicle = vehicle_of("arduplane")
    application = launch(vehicle.url, "--guidance", "command")

    def move():
        craft = vehicle.autopilot.craft
        vehicle.autopilot._circle_at(type(vehicle.autopilot.here)(craft.east_m - 500.0, craft.north_m, 100.0), True)

    assert_yielded(vehicle, application, move, "another station has moved the circle")


def test_the_autopilot_starts_anew(vehicle_of, launch):
    vehicle = vehicle_of("px4")
    application = launch(vehicle.url)
    assert_yielded(vehicle, application, vehicle.simulation.reboot, "")


def test_an_upload_under_way_stops_with_the_mode_change(vehicle_of, launch):
    vehicle = vehicle_of("arduplane")
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    changed_s = []

    def change():
        vehicle.autopilot.set_mode(12)
        changed_s.append(vehicle.simulation.time_s)

    vehicle.at_item(1, change)
    application.wait_for("commanding nothing more")
    vehicle.wait(30.0)
    assert commands_after(vehicle, changed_s[0]) == []
    assert application.end()["outcome"].startswith("yielded")
