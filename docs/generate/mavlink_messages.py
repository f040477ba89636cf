"""The page of MAVLink messages: which the code names, in which direction, how often, and for what.

Names and directions are read from the source, rates from ``sidelong.app.flight.streams``. The purpose of each is
written here; a message without one has the first sentence of its definition.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.flight import streams

_DEFINED = {message.msgname: message for message in dialect.mavlink_map.values()}
_NAMES = _DEFINED.keys()
_NAME_OF = {number: message.msgname for number, message in dialect.mavlink_map.items()}
_SENDERS = {"send", "send_mission", "transmit", "_commanded"}
_FOLDERS = (
    "app/link",
    "app/flight",
    "app/autopilots",
    "app/fleet",
    "app/sharing",
    "app/commands",
    "app/payload",
    "mission/exchange",
)
_RECEIVED = {
    "ADSB_VEHICLE": "other aircraft, by ADS-B or FLARM",
    "AIS_VESSEL": "a vessel that reports itself",
    "ATTITUDE": "attitude of the aircraft at the moment of each sighting",
    "AUTOPILOT_VERSION": "release of the autopilot, and what it supports",
    "BATTERY_STATUS": "charge and consumption, for the endurance",
    "CAMERA_INFORMATION": "model of a Gremsy payload",
    "CAMERA_TRACKING_GEO_STATUS": "position of the target by the camera, used while there is no laser",
    "COMMAND_ACK": "answer to a command",
    "CURRENT_MODE": "flight mode, more quickly than by the heartbeat",
    "DEBUG": "laser of a Gremsy payload",
    "DISTANCE_SENSOR": "slant range, up to 655 m",
    "EKF_STATUS_REPORT": "faults of the position estimate (ArduPilot)",
    "ESTIMATOR_STATUS": "faults of the position estimate (PX4)",
    "FOLLOW_TARGET": "a beacon that the target carries",
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "line of sight",
    "GLOBAL_POSITION_INT": "position and velocity of the aircraft; drives the control step",
    "GPS_RAW_INT": "type of the GPS fix",
    "HEARTBEAT": "mode, armed state, presence",
    "HOME_POSITION": "home, for heights and the flight home",
    "MISSION_ACK": "result of an upload",
    "MISSION_COUNT": "number of items on board",
    "MISSION_CURRENT": "current item: which plan is flown",
    "MISSION_ITEM_INT": "an item on board, read back",
    "MISSION_REQUEST": "the autopilot asks for an item (ArduPilot)",
    "MISSION_REQUEST_INT": "the autopilot asks for an item",
    "OPEN_DRONE_ID_ARM_STATUS": "whether a Remote ID module allows arming",
    "OPEN_DRONE_ID_LOCATION": "other aircraft, by Remote ID",
    "ORBIT_EXECUTION_STATUS": "circle that PX4 flies by command",
    "PARAM_VALUE": "value of a parameter",
    "POSITION_TARGET_GLOBAL_INT": "circle that ArduPlane flies by command",
    "RADIO_STATUS": "signal strength of a radio; only reported",
    "RANGEFINDER": "slant range (ArduPilot), also beyond 655 m",
    "STATUSTEXT": "reasons of refusals, for the operator",
    "SYSTEM_TIME": "UTC, to compare the clocks of a fleet",
    "SYS_STATUS": "battery and sensor health",
    "TERRAIN_REPORT": "the autopilot's own height of the ground, compared with the elevation data",
    "TERRAIN_REQUEST": "elevation data for the autopilot",
    "TIMESYNC": "round trip and clock of the link",
    "WIND": "wind (ArduPilot)",
    "WIND_COV": "wind (PX4)",
}
_SENT = {
    "CAMERA_TRACKING_GEO_STATUS": "position of the estimate, to point the gimbal (`payload.point_gimbal`)",
    "COMMAND_ACK": "answer to a command of the autopilot that is not supported",
    "COMMAND_INT": "commands with a position",
    "COMMAND_LONG": "commands",
    "DISTANCE_SENSOR": "slant range of a payload with a driver (`sidelong payload --to`)",
    "FOLLOW_TARGET": "position of the target for another vehicle (`sharing.follow_target`)",
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "line of sight of a payload with a driver (`sidelong payload --to`)",
    "GIMBAL_DEVICE_SET_ATTITUDE": "points a Gremsy payload",
    "HEARTBEAT": "presence of sidelong, once a second",
    "MISSION_ACK": "end of a read, or cancelled upload",
    "MISSION_COUNT": "begins an upload of all items",
    "MISSION_ITEM_INT": "an item",
    "MISSION_REQUEST_INT": "reads an item",
    "MISSION_REQUEST_LIST": "reads the mission",
    "MISSION_SET_CURRENT": "makes the new plan current at the planned moment",
    "MISSION_WRITE_PARTIAL_LIST": "begins an upload of changed items (ArduPilot)",
    "PARAM_EXT_SET": "sets the rate of a Gremsy laser",
    "PARAM_REQUEST_READ": "reads a parameter",
    "PARAM_SET": "sets a parameter (`link.set_parameters` only)",
    "SETUP_SIGNING": "key for a disarmed vehicle (`sidelong sign`)",
    "STATUSTEXT": "alarms for the ground station, one in 5 s at most",
    "TERRAIN_DATA": "elevation data that the autopilot has requested",
    "TIMESYNC": "measures the round trip",
}
_COMMANDS = {
    "COMPONENT_ARM_DISARM": "arms before take-off; disarms if the take-off failed",
    "DO_LAND_START": "item after the last circle (PX4): where a landing would begin",
    "DO_ORBIT": "flies a circle by command (PX4, in replays of earlier versions)",
    "DO_REPOSITION": "flies a circle by command (ArduPlane, `planner.guidance`)",
    "DO_SET_MODE": "starts the mission; flies home at the end",
    "DO_SET_ROI_LOCATION": "points the gimbal (`payload.point_gimbal`, several targets)",
    "NAV_LAND": "item of PX4's landing",
    "NAV_LOITER_TO_ALT": "item of PX4's landing",
    "NAV_LOITER_UNLIM": "item: a circle",
    "NAV_TAKEOFF": "item: take-off",
    "NAV_WAYPOINT": "item: a waypoint of a transition; home of ArduPlane",
    "REQUEST_MESSAGE": "requests a message once",
    "SET_MESSAGE_INTERVAL": "requests a message at a rate",
}


def page() -> str:
    """Return the page in Markdown."""
    return "\n".join(_lines(Path(__file__).resolve().parents[2])) + "\n"


def _lines(root: Path) -> Iterator[str]:
    received, sent, orders = _named(root)
    yield "# MAVLink messages\n"
    yield "This page is generated: names and directions from the source, rates from the stream requests.\n"
    yield "## Received\n"
    yield "`few_messages` is the rate on a slow radio. A message without a rate comes on request or unasked.\n"
    yield "| message | for what | rate, Hz | with `few_messages`, Hz |\n| --- | --- | --- | --- |"
    rates = {_NAME_OF[number]: rate for number, rate in (streams.RATES_HZ | streams.TERRAIN_HZ).items()}
    few = {_NAME_OF[number]: rate for number, rate in (streams.FEW_HZ | streams.TERRAIN_HZ).items()}
    for name in sorted(received | rates.keys()):
        yield f"| `{name}` | {_purpose(name, _RECEIVED)} | {_rate(rates.get(name))} | {_rate(few.get(name))} |"
    yield "\nLaser, gimbal and camera send at their own rates; sidelong needs each at 1 Hz or more.\n"
    yield "## Sent\n"
    yield "| message | for what |\n| --- | --- |"
    yield from (f"| `{name}` | {_purpose(name, _SENT)} |" for name in sorted(sent))
    yield "\n## Commands and mission items\n"
    yield "| `MAV_CMD_` | for what |\n| --- | --- |"
    yield from (f"| `{name}` | {_COMMANDS.get(name, '')} |" for name in sorted(orders))
    yield "\n## Switched off on a slow radio\n"
    unused = sorted(_NAME_OF.get(number, str(number)) for number in streams.UNUSED_HZ)
    yield ", ".join(f"`{name}`" for name in unused) + "."


def _purpose(name: str, written: dict[str, str]) -> str:
    """Return what a message is for; the first sentence of its definition where nothing is written above."""
    return written.get(name) or (_DEFINED[name].__doc__ or "").strip().split(". ")[0].replace("\n", " ")


def _rate(rate_hz: float | None) -> str:
    return "" if rate_hz is None else f"{rate_hz:g}"


def _named(root: Path) -> tuple[set[str], set[str], set[str]]:
    """Return the messages that are received, those that are sent, and the commands, by name."""
    received, sent = {"FOLLOW_TARGET"}, {"PARAM_SET"}  # read as a class of pymavlink; sent by MAVSDK
    orders = {"NAV_TAKEOFF", "SET_MESSAGE_INTERVAL"}  # given by number
    for path in (path for folder in _FOLDERS for path in sorted((root / folder).rglob("*.py"))):
        text = path.read_text(encoding="utf-8")
        orders |= set(re.findall(r"\.MAV_CMD_([A-Z_]+)", text))
        sent |= {name.upper() for name in re.findall(r"\.MAVLink_(\w+)_message\(", text)} & _NAMES
        tree = ast.parse(text)
        calls = [node.args[0] for node in ast.walk(tree) if _is_sent(node)]
        sent |= {name.value for name in calls}
        own = set(map(id, calls))
        received |= {
            node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and node.value in _NAMES and id(node) not in own
        }
    return received - {"COMMAND_INT", "COMMAND_LONG"}, sent, orders


def _is_sent(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in _SENDERS
        and bool(node.args)
        and isinstance(node.args[0], ast.Constant)
        and node.args[0].value in _NAMES
    )
