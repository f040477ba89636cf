"""What stands in the way of a mission, by the autopilots' parameters and their own words."""

import math

import pytest

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.autopilots.autopilot import ParameterTable
from sidelong.app.autopilots.px4 import Px4
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import SourceRate, check_takeover, checks
from sidelong.app.link.telemetry import RECOVERY_MODES
from sidelong.app.link.vehicle import reported_pan_limits_rad
from sidelong.app.payload.session import contradiction, pan_words
from sidelong.estimators.sensing.readings import Source
from tests.messages import latest

GOOD_ARDUPLANE = {"AIRSPEED_CRUISE": 15.0}
NOTHING_READ = ParameterTable((), None, {})
GOOD_PX4 = {"FW_AIRSPD_TRIM": 15.0, "NAV_DLL_ACT": 0.0, "MIS_TKO_LAND_REQ": 2.0}


class Silent:
    """A vehicle of which nothing but its latest messages matters."""

    system_id, own_id, only_mavlink_1, is_companion = 1, (245, 190), False, False

    def __init__(self, **messages):
        self.latest = latest(**messages)


def test_good_parameters_need_nothing():
    assert ArduPlane().required_parameters(GOOD_ARDUPLANE, 15.0) == ()
    assert Px4().required_parameters(GOOD_PX4, 15.0) == ()


@pytest.mark.parametrize(
    ("autopilot", "name", "present", "wanted"),
    [
        (ArduPlane(), "AIRSPEED_CRUISE", 22.0, 15.0),
        (ArduPlane(), "ARMING_MIS_ITEMS", 9.0, 8.0),
        (Px4(), "FW_AIRSPD_TRIM", 12.0, 15.0),
        (Px4(), "NAV_DLL_ACT", 5.0, 0.0),
        (Px4(), "MIS_TKO_LAND_REQ", 4.0, 2.0),
    ],
)
def test_what_stands_in_the_way_is_named_with_its_remedy(autopilot, name, present, wanted):
    (need,) = autopilot.required_parameters(GOOD_ARDUPLANE | GOOD_PX4 | {name: present}, 15.0)
    assert (need.name, need.present, need.value) == (name, present, wanted)
    found = checks(Config(), Silent(), autopilot, NOTHING_READ, None, (), (need,))
    (check,) = (check for check in found if check.name == name)
    assert not check.ready
    assert "link.set_parameters" in str(check)


@pytest.mark.parametrize(
    ("autopilot", "values", "hidden"),
    [
        (Px4(), {"NAV_DLL_ACT": 2.0, "COM_DL_LOSS_T": 10.0}, "NAV_DLL_ACT = 2 after COM_DL_LOSS_T = 10 s"),
        (Px4(), {"NAV_DLL_ACT": 0.0, "COM_DL_LOSS_T": 10.0}, None),
        (ArduPlane(), {"FS_GCS_ENABL": 1.0, "SYSID_MYGCS": 245.0}, "FS_GCS_ENABL = 1 of ground station 245"),
        (ArduPlane(), {"FS_GCS_ENABL": 1.0, "SYSID_MYGCS": 255.0}, None),
    ],
)
def test_a_failsafe_that_a_ground_station_renews_is_reported(autopilot, values, hidden):
    table, vehicle = ParameterTable(autopilot.parameters, None, values), Silent()
    found = [
        one.found for one in checks(Config(), vehicle, autopilot, table, None, ()) if one.name == "link failsafe"
    ]
    assert [one.split(" does not begin")[0] for one in found] == ([hidden] if hidden else [])
    vehicle.is_companion = True
    assert "link failsafe" not in {one.name for one in checks(Config(), vehicle, autopilot, table, None, ())}


@pytest.mark.parametrize(
    ("status", "error", "ready"), [(0, "", True), (1, "missing operator location", False), (1, "", False)]
)
def test_a_remote_id_module_has_to_allow_arming(status, error, ready):
    silent = Silent(OPEN_DRONE_ID_ARM_STATUS={"status": status, "error": error})
    found = checks(Config(), silent, Px4(), NOTHING_READ, None, ())
    (check,) = (one for one in found if one.name == "Remote ID")
    assert (check.ready, check.before_take_off) == (ready, True)
    assert error in check.found


def test_an_unhealthy_sensor_is_named():
    used, compass = 0x2F, 0x4
    fields = {
        "onboard_control_sensors_present": used,
        "onboard_control_sensors_enabled": used,
        "onboard_control_sensors_health": used & ~compass,
    }
    (health,) = (
        c
        for c in checks(Config(), Silent(SYS_STATUS=fields), ArduPlane(), NOTHING_READ, None, ())
        if c.name == "health"
    )
    assert not health.ready
    assert "compass" in health.found


RANGE, GIMBAL = (
    SourceRate(kind, Source(message, 154), 10.0)
    for kind, message in (("range", "DISTANCE_SENSOR"), ("gimbal", "GIMBAL_DEVICE_ATTITUDE_STATUS"))
)
CAMERA = SourceRate("target", Source("CAMERA_TRACKING_GEO_STATUS", 100), 1.0)
BEACON = SourceRate("target", Source("FOLLOW_TARGET", 0), 0.2)
LISTENING = {"sharing": {"beacon": "udp://0.0.0.0:6969"}}


@pytest.mark.parametrize(
    ("configured", "rates", "missing"),
    [
        ({}, (RANGE, GIMBAL), []),
        ({}, (RANGE,), ["gimbal source"]),
        ({}, (), ["range source", "gimbal source"]),
        ({}, (GIMBAL, CAMERA), []),
        (LISTENING, (BEACON,), []),
        (LISTENING, (RANGE, GIMBAL), []),
        (LISTENING, (RANGE,), ["target source"]),
    ],
)
def test_laser_and_gimbal_are_asked_for_unless_another_station_reports_the_place(configured, rates, missing):
    found = checks(Config.model_validate(configured), Silent(), Px4(), NOTHING_READ, None, rates)
    assert [check.name for check in found if "source" in check.name and not check.ready] == missing


DOWN = SourceRate("range", Source("DISTANCE_SENSOR", 1, 0, 25), 10.0)
MUTE = SourceRate("range", Source("DISTANCE_SENSOR", 154, 1, 100), 10.0, "no echo within its 600 m")


@pytest.mark.parametrize(
    ("configured", "rates", "ready", "words"),
    [
        ({}, (DOWN, GIMBAL), False, "not used: it looks down; sensors.range_component = 1 would use it"),
        ({"sensors": {"range_component": 1}}, (DOWN, GIMBAL), True, "orientation 25 at 10.0 Hz"),
        ({"sensors": {"range_component": 1}}, (RANGE, GIMBAL), False, "it is not what sensors.range_component names"),
        ({}, (DOWN, RANGE, GIMBAL), True, "component 154"),
        (
            {},
            (MUTE, GIMBAL),
            False,
            "received: DISTANCE_SENSOR of component 154 id 1 orientation 100 at 10.0 Hz, but no",
        ),
        ({}, (GIMBAL,), False, "none received"),
    ],
)
def test_a_range_counts_only_if_the_filter_would_use_it(configured, rates, ready, words):
    found = checks(Config.model_validate(configured), Silent(), Px4(), NOTHING_READ, None, rates)
    (check,) = (check for check in found if check.name == "range source")
    assert check.ready is ready
    assert words in check.found


def test_a_link_of_mavlink_1_is_named_where_the_gimbal_is_missing():
    vehicle = Silent()
    vehicle.only_mavlink_1 = True
    found = {check.name: check for check in checks(Config(), vehicle, Px4(), NOTHING_READ, None, (RANGE,))}
    assert found["range source"].ready
    assert "MAVLink 1 only, which cannot carry GIMBAL_DEVICE_ATTITUDE_STATUS" in found["gimbal source"].found
    assert "MAV_PROTO_VER = 2" in found["gimbal source"].remedy


def test_camera_that_tracks_without_a_known_field_of_view_is_not_ready():
    tracking = {"CAMERA_TRACKING_IMAGE_STATUS": {"tracking_status": 1}}
    for messages, ready in ((tracking, [False]), (tracking | {"CAMERA_FOV_STATUS": {}}, [True]), ({}, [])):
        found = checks(Config(), Silent(**messages), Px4(), NOTHING_READ, None, ())
        assert [check.ready for check in found if check.name == "field of view"] == ready


class Flying:
    """An armed ArduPlane at 100 m, in a mode by its number."""

    def __init__(self, mode: int, state: int = 4, height_m: float = 100.0) -> None:
        heartbeat = {"autopilot": 3, "base_mode": 0x80 | 1, "custom_mode": mode, "system_status": state}
        position = {"relative_alt": round(height_m * 1e3)}
        fields = {"HEARTBEAT": heartbeat, "GLOBAL_POSITION_INT": position}
        self.latest = latest(**fields)


@pytest.mark.parametrize(
    ("vehicle", "allowed", "refused"),
    [
        (Flying(10), (), ""),  # AUTO
        (Flying(11), (), "--set 'link.take_over_from=[\"RTL\"]'"),
        (Flying(11), ("rtl",), ""),
        (Flying(11), ("LAND",), "--set 'link.take_over_from=[\"RTL\"]'"),
        (Flying(26), (), "--set 'link.take_over_from=[\"AUTOLAND\"]'"),
        (Flying(14), (), "--set 'link.take_over_from=[\"AVOID_ADSB\"]'"),
        (Flying(10, state=5), (), "--set 'link.take_over_from=[\"failsafe\"]'"),
        (Flying(11, state=6), ("RTL",), "--set 'link.take_over_from=[\"failsafe\"]'"),
        (Flying(11, state=6), ("RTL", "failsafe"), ""),
        (Flying(11, height_m=0.0), (), ""),  # on the ground
    ],
)
def test_an_aircraft_on_its_way_home_is_not_taken_over_silently(vehicle, allowed, refused):
    if not refused:
        check_takeover(vehicle, allowed)
        return
    with pytest.raises(InputError) as why:
        check_takeover(vehicle, allowed)
    assert refused in str(why.value)
    assert "change the flight mode" in str(why.value)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"cap_flags": 0, "yaw_min": -2.0944, "yaw_max": 2.0944}, "from -120 to 120 degrees off the nose"),
        ({"cap_flags": 2048, "yaw_min": -2.0944, "yaw_max": 2.0944}, None),  # infinite yaw
        ({"cap_flags": 0, "yaw_min": math.nan, "yaw_max": math.nan}, None),
        ({"cap_flags": 0, "yaw_min": -math.pi, "yaw_max": math.pi}, None),
    ],
)
def test_pan_limits_are_reported_with_the_share_of_a_lap_that_they_cost(fields, words):
    limits_rad = reported_pan_limits_rad(Silent(GIMBAL_MANAGER_INFORMATION=fields))
    assert (words is None) == (pan_words(limits_rad) == [])
    for line in pan_words(limits_rad):
        assert words in line
        assert "for 33 % of each lap; one aircraft flies figures of eight instead" in line


@pytest.mark.parametrize(("configured_deg", "is_wider"), [(None, False), (120.0, False), (170.0, True)])
def test_a_configured_pan_limit_wider_than_the_gimbal_s_is_reported(configured_deg, is_wider):
    words = contradiction(configured_deg, (math.radians(-120.0), math.radians(120.0)))
    assert ("but the gimbal pans 120 degrees only" in words) is is_wider


def test_a_precision_landing_of_px4_has_a_name():
    assert Px4().mode_name(0x80 | 1, 4 << 16 | 9 << 24) in RECOVERY_MODES


@pytest.mark.parametrize(("autopilot", "refused"), [(Px4(), ["planner.guidance"]), (ArduPlane(), [])])
def test_guidance_by_command_is_refused_where_it_could_take_back_a_pilots_mode(autopilot, refused):
    config = Config.model_validate({"planner": {"guidance": "command"}})
    found = checks(config, Silent(), autopilot, NOTHING_READ, None, ())
    assert [check.name for check in found if not check.ready and check.lasts] == refused
