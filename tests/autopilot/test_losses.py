"""What fails and comes back: the aircraft goes on circling in the meantime, and the mission goes on afterwards."""

import math

import pytest

pytestmark = pytest.mark.udp

WATCHED = "watched from now on"
ON_THE_WAY_S = 5.0  # of the vehicle's time: a quarter of a second at twenty times the clock, on a busy machine


def assert_circles(vehicle, seconds):
    """The aircraft stays within a lap's size of where it is."""
    craft = vehicle.autopilot.craft
    here_m = (craft.east_m, craft.north_m)
    vehicle.wait(seconds)
    assert math.hypot(craft.east_m - here_m[0], craft.north_m - here_m[1]) < 500.0
    assert craft.height_m > 80.0


def test_the_position_and_then_the_link_fail_and_come_back(vehicle_of, launch):
    vehicle = vehicle_of("arduplane")
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    silenced = vehicle.autopilot.silenced
    position = 33
    vehicle.do(lambda: silenced.add(position))
    application.wait_for("no position from the autopilot")
    blind_s = vehicle.simulation.time_s
    assert_circles(vehicle, 30.0)
    commanded = {kind for time_s, kind in vehicle.commanded if time_s > blind_s + ON_THE_WAY_S}
    assert commanded <= {"COMMAND_LONG"}  # requests for the stream that is silent
    vehicle.do(lambda: silenced.discard(position))
    vehicle.wait(20.0)
    vehicle.deaf = True
    application.wait_for("link lost")
    assert_circles(vehicle, 30.0)
    vehicle.deaf = False
    application.wait_for("the link is back")
    vehicle.wait(20.0)
    assert application.end()["outcome"] == "interrupted"


def test_laser_and_then_gimbal_fail_and_come_back(vehicle_of, launch):
    vehicle = vehicle_of("px4")
    application = launch(vehicle.url)
    application.wait_for(WATCHED)
    application.wait_for("the target is in sight")
    for number, kind in enumerate(("DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS"), 1):
        vehicle.do(lambda kind=kind: vehicle.simulation.mute_payload(kind))
        application.wait_for("the target has not been seen for", times=number)
        application.wait_for("the target is lost", times=number)
        lost_s = vehicle.simulation.time_s
        assert_circles(vehicle, 30.0)
        commanded = [kind for time_s, kind in vehicle.commanded if time_s > lost_s + ON_THE_WAY_S]
        assert not commanded or "searching: circling where the target can be" in application.announced
        vehicle.do(vehicle.simulation.muted.clear)
        application.wait_for("the target is in sight again", times=number)
    assert application.end()["outcome"] == "interrupted"
