"""Whatever is sent, the vehicle flies on: no message may stop the simulation or put the aircraft nowhere."""

import math
import random

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour

KINDS = [
    mavlink.MAVLink_command_long_message,
    mavlink.MAVLink_command_int_message,
    mavlink.MAVLink_mission_count_message,
    mavlink.MAVLink_mission_item_int_message,
    mavlink.MAVLink_mission_item_message,
    mavlink.MAVLink_mission_request_int_message,
    mavlink.MAVLink_mission_request_message,
    mavlink.MAVLink_mission_request_list_message,
    mavlink.MAVLink_mission_write_partial_list_message,
    mavlink.MAVLink_mission_clear_all_message,
    mavlink.MAVLink_mission_ack_message,
    mavlink.MAVLink_mission_set_current_message,
    mavlink.MAVLink_param_set_message,
    mavlink.MAVLink_param_request_read_message,
    mavlink.MAVLink_param_request_list_message,
    mavlink.MAVLink_set_mode_message,
    mavlink.MAVLink_request_data_stream_message,
    mavlink.MAVLink_timesync_message,
    mavlink.MAVLink_ping_message,
    mavlink.MAVLink_heartbeat_message,
    mavlink.MAVLink_distance_sensor_message,
]
COMMANDS = [16, 17, 20, 21, 22, 34, 176, 178, 192, 224, 246, 300, 400, 410, 510, 511, 512, 520]
FLOATS = [0.0, 1.0, -1.0, 2.0, 80.0, -80.0, 1e9, -1e9, math.nan, math.inf, -math.inf]
LIMITS = {"uint8_t": 8, "int8_t": 7, "uint16_t": 16, "int16_t": 15, "uint32_t": 32, "int32_t": 31, "uint64_t": 64}


def value(rng, name, kind):
    if name == "command":
        return rng.choice([*COMMANDS, rng.randrange(65536)])
    if name in ("target_system", "target_component"):
        return rng.choice([0, 1, 1, 1, 7])
    if name == "mission_type":
        return rng.choice([0, 0, 0, 1, 2, 255])
    if name in ("seq", "count", "start_index", "end_index"):
        return rng.choice([0, 1, 2, 3, 60000 if kind.startswith("u") else -1])
    if name == "frame":
        return rng.choice([0, 3, 5, 6, 2, 99])
    if name == "param_id":
        return rng.choice([b"WP_LOITER_RAD", b"NAV_LOITER_RAD", b"NONE", b"\xff\xfe"])
    if kind == "float":
        return rng.choice(FLOATS)
    if kind == "char":
        return b"x"
    bits = LIMITS.get(kind, 31)
    return rng.choice([0, 1, rng.randrange(2**bits)])


def nonsense(rng):
    kind = rng.choice(KINDS)
    fields = []
    for name, wire_type in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        count = kind.array_lengths[kind.ordered_fieldnames.index(name)]
        values = [value(rng, name, wire_type) for _ in range(count)]
        fields.append(values if count and wire_type != "char" else value(rng, name, wire_type))
    return kind(*fields)


@pytest.mark.parametrize("flavour", list(Flavour))
def test_nonsense_is_survived(simulate, station, flavour):
    rng = random.Random(5)
    ground = station(simulate(flavour=flavour))
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0))
    ground.run(60.0)
    craft = ground.simulation.vehicle.craft
    for _ in range(3000):
        ground.send(nonsense(rng))
        ground.run(0.1)
        assert math.isfinite(craft.east_m + craft.north_m + craft.height_m + craft.heading_rad + craft.roll_rad)


def test_disarming_in_flight_needs_force_and_ends_on_the_ground(simulate, station):
    ground = station(simulate(payload=None))
    ground.fly(ground.takeoff(60.0), ground.loiter(300.0, 300.0, 80.0, 60.0))
    ground.run(60.0)
    assert ground.command_long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == mavlink.MAV_RESULT_FAILED
    assert ground.command_long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == mavlink.MAV_RESULT_ACCEPTED
    ground.run(30.0)
    assert not ground.simulation.vehicle.craft.flying
    assert ground.simulation.vehicle.craft.height_m == 0.0
