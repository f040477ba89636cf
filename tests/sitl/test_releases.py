"""What a simulated vehicle of an older release does differently, as read in the sources of each."""

import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.payload import SimulatedPayload, TargetGeometry
from sidelong.sitl.settings import NEWEST, Flavour, GimbalFrame, PayloadSettings

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
RELATIVE_INT = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


def at(simulate, station, flavour, release, **settings):
    ground = station(simulate(flavour=flavour, release=release, payload=None, **settings))
    ground.run(30.0)
    return ground


@pytest.mark.parametrize("flavour", list(Flavour))
def test_the_newest_release_is_the_default(simulate, station, flavour):
    ground = at(simulate, station, flavour, None)
    ground.command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    version = ground.last("AUTOPILOT_VERSION").flight_sw_version
    assert (version >> 24, version >> 16 & 0xFF) == NEWEST[flavour]


@pytest.mark.parametrize(
    ("flavour", "release", "has", "lacks"),
    [
        (Flavour.ARDUPLANE, (4, 4), "TRIM_ARSPD_CM ARSPD_FBW_MIN LIM_ROLL_CD SYSID_MYGCS", "AIRSPEED_CRUISE"),
        (Flavour.ARDUPLANE, (4, 5), "AIRSPEED_CRUISE AIRSPEED_MIN ROLL_LIMIT_DEG SYSID_MYGCS", "LIM_ROLL_CD"),
        (Flavour.ARDUPLANE, (4, 6), "AIRSPEED_CRUISE SYSID_MYGCS", "MAV_GCS_SYSID"),
        (Flavour.ARDUPLANE, (4, 7), "AIRSPEED_CRUISE MAV_GCS_SYSID", "SYSID_MYGCS"),
        (Flavour.PX4, (1, 13), "FW_R_LIM", "MIS_TKO_LAND_REQ"),
        (Flavour.PX4, (1, 14), "FW_R_LIM MIS_TKO_LAND_REQ", "SYSID_MYGCS"),
    ],
)
def test_parameters_have_the_names_of_the_release(simulate, station, flavour, release, has, lacks):
    ground = at(simulate, station, flavour, release)
    for name in (*has.split(), lacks):
        ground.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    ground.run(0.2)
    assert [message.param_id for message in ground.all("PARAM_VALUE")] == has.split()


def test_arduplane_4_4_counts_speed_in_cm_and_bank_in_hundredths_of_a_degree(simulate, station):
    ground = at(simulate, station, Flavour.ARDUPLANE, (4, 4))
    parameters = ground.simulation.vehicle.parameters
    assert (parameters["TRIM_ARSPD_CM"], parameters["LIM_ROLL_CD"]) == (1500.0, 6500.0)
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"TRIM_ARSPD_CM", 1800.0, mavlink.MAV_PARAM_TYPE_INT32))
    ground.run(0.2)
    assert ground.simulation.vehicle.airspeed_goal_m_s == pytest.approx(18.0)


@pytest.mark.parametrize(("release", "reports"), [((1, 17), False), ((1, 18), True)])
def test_px4_answers_a_wrong_name_with_an_error_from_1_18(simulate, station, release, reports):
    ground = at(simulate, station, Flavour.PX4, release)
    ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    ground.run(0.2)
    assert bool(ground.all("PARAM_ERROR")) is reports


@pytest.mark.parametrize(
    ("release", "radius_m", "clockwise"),
    [((4, 3), 80.0, False), ((4, 4), 120.0, False), ((4, 5), 120.0, True)],
)
def test_reposition_without_a_direction_and_with_a_radius(simulate, station, release, radius_m, clockwise):
    ground = at(simulate, station, Flavour.ARDUPLANE, release)
    vehicle = ground.simulation.vehicle
    home = vehicle.home
    place = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
    ground.arm()
    assert (
        ground.command_int(
            *(mavlink.MAV_CMD_DO_REPOSITION, -1, 1, 120.0, math.nan),
            frame=RELATIVE_INT,
            x=place[0],
            y=place[1],
            z=100.0,
        )
        == ACCEPTED
    )
    assert (vehicle._guided_radius_m or vehicle.parameters["WP_LOITER_RAD"]) == radius_m
    assert vehicle.navigator.loiter.clockwise is clockwise


@pytest.mark.parametrize(
    ("flavour", "release", "total"),
    [
        (Flavour.ARDUPLANE, (4, 4), 0),
        (Flavour.ARDUPLANE, (4, 5), 2),
        (Flavour.PX4, (1, 14), 0),
        (Flavour.PX4, (1, 15), 2),
    ],
)
def test_mission_current_counts_the_items_of_newer_releases_only(simulate, station, flavour, release, total):
    ground = at(simulate, station, flavour, release)
    items = [
        ground.item(number, mavlink.MAV_CMD_NAV_LOITER_UNLIM, 100.0 * number)
        for number in range(2 + (flavour is Flavour.ARDUPLANE))
    ]
    assert ground.upload(items) == mavlink.MAV_MISSION_ACCEPTED
    ground.run(3.0)
    assert getattr(ground.last("MISSION_CURRENT"), "total", 0) == total


@pytest.mark.parametrize(("release", "named"), [((1, 14), False), ((1, 15), True)])
def test_px4_names_its_mission_by_a_checksum_from_1_15(simulate, station, release, named):
    ground = at(simulate, station, Flavour.PX4, release)
    ground.upload([ground.item(0, mavlink.MAV_CMD_NAV_LOITER_UNLIM)])
    frame = next(data for data in reversed(ground.frames) if data[7:10] == b"\x2f\x00\x00")  # MISSION_ACK
    payload = frame[10:-2].ljust(8, b"\0")
    assert bool(struct.unpack_from("<I", payload, 4)[0]) is named


@pytest.mark.parametrize(("release", "offered"), [((1, 14), False), ((1, 15), True)])
def test_px4_offers_its_current_mode_from_1_15(simulate, station, release, offered):
    ground = at(simulate, station, Flavour.PX4, release)
    number = mavlink.MAVLINK_MSG_ID_CURRENT_MODE
    result = ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 100_000)
    assert (result == ACCEPTED) is offered


@pytest.mark.parametrize(("release", "offered"), [((4, 5), False), ((4, 6), True)])
def test_arduplane_offers_terrain_reports_on_their_own_from_4_6(simulate, station, release, offered):
    ground = at(simulate, station, Flavour.ARDUPLANE, release)
    number = mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT
    result = ground.command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1_000_000)
    assert (result == ACCEPTED) is offered


def test_a_mount_of_4_4_names_no_frame_of_its_yaw():
    sight = TargetGeometry(200.0, 1.0, -0.4)
    flags = {}
    for frame in GimbalFrame:
        payload = SimulatedPayload(PayloadSettings(gimbal_frame=frame), np.random.SeedSequence(1))
        (message,) = (
            one for one in payload.measure(10.0, 10_000, sight, 0.7).messages if one.get_type().startswith("GIMBAL")
        )
        flags[frame] = message.flags, message.q
    named, unnamed = flags[GimbalFrame.VEHICLE], flags[GimbalFrame.UNNAMED]
    assert unnamed[0] & 0b1111_0000 == 0
    assert named[0] & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
    assert unnamed[1] == named[1]
