"""A ground station that speaks to a simulation without sockets and without a clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour, Settings
from sidelong.sitl.simulation import Simulation

RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


class Ground:
    """One station. Everything it receives is kept in ``received``, in order."""

    def __init__(
        self, simulation: Simulation, address: object = "ground", system_id: int = 255, component_id: int = 190
    ) -> None:
        self.simulation = simulation
        self.address = address
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._parser = mavlink.MAVLink(None)
        self.received: list[Any] = []
        self.frames: list[bytes] = []
        self.peers: list[Ground] = [self]  # all stations of this simulation; they share the list
        simulation.connect(address)

    # Talking.

    def send(self, message: Any) -> None:
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self.simulation.receive(self.address, data)
        self.collect()

    def collect(self) -> None:
        grounds = {ground.address: ground for ground in self.peers}
        for address, data in self.simulation.take():
            ground = grounds.get(address)
            if ground is None:
                continue
            ground.frames.append(data)
            ground.received.extend(ground._parser.parse_buffer(data) or ())

    def run(self, seconds: float) -> None:
        self.simulation.advance(self.simulation.time_s + seconds)
        self.collect()

    def run_until(self, condition: Callable[[], bool], limit_s: float = 300.0, step_s: float = 0.1) -> None:
        end_s = self.simulation.time_s + limit_s
        while not condition():
            assert self.simulation.time_s < end_s, f"not within {limit_s} s"
            self.run(step_s)

    def all(self, kind: str, component: int | None = None) -> list[Any]:
        return [
            m
            for m in self.received
            if m.get_type() == kind and (component is None or m.get_srcComponent() == component)
        ]

    def last(self, kind: str, component: int | None = None) -> Any:
        messages = self.all(kind, component)
        assert messages, f"no {kind} was received"
        return messages[-1]

    def texts(self) -> list[str]:
        return [m.text for m in self.all("STATUSTEXT")]

    # Commands.

    def heartbeat(self) -> None:
        self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
            )
        )

    def command_long(self, command: int, *params: float) -> int | None:
        padded = (*params, *(0.0,) * 7)[:7]
        return self._result_of(mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded), command)

    def command_int(
        self, command: int, *params: float, frame: int, x: int = 0, y: int = 0, z: float = 0.0
    ) -> int | None:
        padded = (*params, *(0.0,) * 4)[:4]
        message = mavlink.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *padded, x, y, z)
        return self._result_of(message, command)

    def _result_of(self, message: Any, command: int) -> int | None:
        before = len(self.received)
        self.send(message)
        self.run(0.1)
        results = [m.result for m in self.received[before:] if m.get_type() == "COMMAND_ACK" and m.command == command]
        return results[-1] if results else None

    def set_mode(self, mode: int) -> int | None:
        px4 = self.simulation.settings.flavour == Flavour.PX4
        params = (mode >> 16 & 0xFF, mode >> 24) if px4 else (mode, 0)
        return self.command_long(mavlink.MAV_CMD_DO_SET_MODE, 1, *params)

    def arm(self) -> int | None:
        return self.command_long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def mode(self) -> int:
        return self.last("HEARTBEAT", 1).custom_mode

    # Missions.

    def item(
        self,
        sequence: int,
        command: int,
        east_m: float = 0.0,
        north_m: float = 0.0,
        height_m: float = 100.0,
        params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
        current: bool = False,
        mission_type: int = 0,
    ) -> Any:
        x, y = self.e7(east_m, north_m)
        return mavlink.MAVLink_mission_item_int_message(
            1, 1, sequence, RELATIVE, command, int(current), 1, *params, x, y, height_m, mission_type
        )

    def e7(self, east_m: float, north_m: float) -> tuple[int, int]:
        latitude_deg, longitude_deg = self.simulation.vehicle.plane.latitude_longitude_deg(east_m, north_m)
        return round(latitude_deg * 1e7), round(longitude_deg * 1e7)

    def upload(self, items: list[Any], limit_s: float = 20.0) -> int:
        """Answer every request as MAVSDK does, and return the result of the MISSION_ACK."""
        mission_type = items[0].mission_type if items else 0
        seen = len(self.received)
        self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), mission_type))
        end_s = self.simulation.time_s + limit_s
        while self.simulation.time_s < end_s:
            fresh, seen = self.received[seen:], len(self.received)
            for message in fresh:
                if message.get_type() == "MISSION_ACK":
                    return int(message.type)
                if message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    self.send(items[message.seq])
            self.run(0.02)
        raise AssertionError("no MISSION_ACK")

    def download(self, mission_type: int = 0) -> list[Any]:
        before = len(self.received)
        self.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type))
        self.run(0.04)
        counts = [m.count for m in self.received[before:] if m.get_type() == "MISSION_COUNT"]
        assert counts, "no MISSION_COUNT"
        for sequence in range(counts[-1]):
            self.send(mavlink.MAVLink_mission_request_int_message(1, 1, sequence, mission_type))
            self.run(0.04)
        self.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_ACCEPTED, mission_type))
        self.run(0.04)
        items = [m for m in self.received[before:] if m.get_type() == "MISSION_ITEM_INT"]
        return sorted({m.seq: m for m in items}.values(), key=lambda m: m.seq)

    def mission(self, *flown: Any) -> list[Any]:
        """Number the items, after the home item that ArduPlane wants."""
        items = list(flown)
        if self.simulation.settings.flavour == Flavour.ARDUPLANE:
            items.insert(0, self.item(0, mavlink.MAV_CMD_NAV_WAYPOINT))
        for sequence, item in enumerate(items):
            item.seq, item.current = sequence, int(sequence == 0)
        return items

    def fly(self, *flown: Any) -> None:
        """Upload, arm, start; PX4 is ordered to do without a landing."""
        vehicle = self.simulation.vehicle
        self.run(max(0.0, vehicle.ready_s + 1.0 - vehicle.now_s))
        if self.simulation.settings.flavour == Flavour.PX4:
            vehicle.parameters.set("MIS_TKO_LAND_REQ", 0)
        assert self.upload(self.mission(*flown)) == mavlink.MAV_MISSION_ACCEPTED
        assert self.arm() == mavlink.MAV_RESULT_ACCEPTED
        mode = 10 if self.simulation.settings.flavour == Flavour.ARDUPLANE else 4 << 16 | 4 << 24
        assert self.set_mode(mode) == mavlink.MAV_RESULT_ACCEPTED

    def takeoff(self, height_m: float = 100.0) -> Any:
        return self.item(0, mavlink.MAV_CMD_NAV_TAKEOFF, height_m=height_m, params=(15.0, 0.0, 0.0, 0.0))

    def loiter(self, east_m: float, north_m: float, radius_m: float, height_m: float = 100.0) -> Any:
        return self.item(0, mavlink.MAV_CMD_NAV_LOITER_UNLIM, east_m, north_m, height_m, (0.0, 0.0, radius_m, 0.0))

    def waypoint(self, east_m: float, north_m: float, height_m: float = 100.0) -> Any:
        return self.item(0, mavlink.MAV_CMD_NAV_WAYPOINT, east_m, north_m, height_m)

    # What is flown.

    def radii_m(self, centre_m: tuple[float, float], seconds: float) -> tuple[float, float, float]:
        """Return mean, least and greatest distance from a point over some seconds, and whether turning right."""
        craft = self.simulation.vehicle.craft
        distances_m = []
        for _ in range(round(seconds / 0.1)):
            self.run(0.1)
            distances_m.append(math.hypot(craft.east_m - centre_m[0], craft.north_m - centre_m[1]))
        return sum(distances_m) / len(distances_m), min(distances_m), max(distances_m)


@pytest.fixture
def simulate() -> Callable[..., Simulation]:
    return lambda **changes: Simulation(Settings(**changes))


@pytest.fixture
def station() -> Callable[..., Ground]:
    """Return what makes a ground station of a simulation, further ones of the same simulation included."""

    def make(simulation: Simulation, *, alongside: Ground | None = None, **changes: Any) -> Ground:
        ground = Ground(simulation, **changes)
        if alongside is not None:
            alongside.peers.append(ground)
            ground.peers = alongside.peers
        return ground

    return make
