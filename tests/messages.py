"""Builders of MAVLink messages: decoded, as a link passes them on, and as the frames of one sender."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.frames import Frame
from sidelong.app.link.message import Message


def message(name: str, component: int = 1, system: int = 1, received_s: float = 0.0, **fields) -> Message:
    """Return a decoded message."""
    return Message(name, system, component, fields, received_s)


def latest(**fields) -> dict[str, Message]:
    """Return the last message of each name, from its fields."""
    return {name: message(name, **values) for name, values in fields.items()}


def heartbeat(autopilot: int = 3, custom_mode: int = 0, base_mode: int = 129, **other) -> Message:
    """Return an armed fixed wing's heartbeat."""
    return message(
        "HEARTBEAT", **{"type": 1} | other, autopilot=autopilot, base_mode=base_mode, custom_mode=custom_mode
    )


def position(time_ms: int = 10_000, lat: int = 474_000_000, lon: int = 85_000_000, **other) -> Message:
    """Return a position 120 m above home."""
    fields = {"alt": 520_000, "relative_alt": 120_000, "vx": 300, "vy": -400, "vz": 50, "hdg": 9_000} | other
    return message("GLOBAL_POSITION_INT", time_boot_ms=time_ms, lat=lat, lon=lon, **fields)


def attitude(**other) -> Message:
    """Return a level attitude towards north."""
    angles = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0)
    return message("ATTITUDE", **{"time_boot_ms": 10_000} | angles | other)


def laser(**other) -> Message:
    """Return a range of 234.62 m of a good echo."""
    fields = {
        "time_boot_ms": 10_000,
        "min_distance": 100,
        "max_distance": 65_500,
        "current_distance": 23_462,
        "type": 0,
        "id": 1,
        "orientation": 100,
        "covariance": 255,
        "signal_quality": 90,
        "quaternion": [0.0, 0.0, 0.0, 0.0],
    } | other
    return message("DISTANCE_SENSOR", **{"component": 154} | fields)


def gimbal(flags: int, **other) -> Message:
    """Return the attitude of a gimbal that looks forward."""
    fields = {"time_boot_ms": 10_000, "q": [1.0, 0.0, 0.0, 0.0], "flags": flags, "gimbal_device_id": 0} | other
    return message("GIMBAL_DEVICE_ATTITUDE_STATUS", 154, **fields)


def acknowledgement(command: int = 400, result: int = 0, component: int = 1, **other) -> Message:
    """Return an acknowledgement of a command of ours."""
    fields = {"target_system": 245, "target_component": 190} | other
    return message("COMMAND_ACK", component, command=command, result=result, **fields)


class Sender:
    """One sender's end of a link, with sequence numbers of its own."""

    def __init__(self, component: int = 1, system: int = 1, first: int = 0) -> None:
        self._mav = mavlink.MAVLink(None, system, component)
        self._mav.seq = first % 256

    def __call__(self, packed: mavlink.MAVLink_message, **options) -> Frame:
        frame = Frame(bytes(packed.pack(self._mav, **options)))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
