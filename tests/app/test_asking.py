"""Parameters and message rates asked for all at once, over a link that loses: on the simulated vehicles."""

from __future__ import annotations

import asyncio
import json
import math
import random
from collections import Counter
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import load_config
from sidelong.app.flight.streams import ask_for_streams, is_slow, wants_few
from sidelong.app.link.message import Message
from sidelong.app.link.stored import VehicleFences, fences_of, mission_of, read_fences, read_mission, read_parameters
from sidelong.app.link.vehicle import LinkError, Vehicle
from sidelong.estimators.frames import LocalPlane
from sidelong.sitl.protocol.transfer import Item
from sidelong.sitl.settings import Flavour, Settings
from sidelong.sitl.simulation import Simulation

OURS = (245, 190)
NAMES = {
    Flavour(one.key): [parameter.name for parameter in one.parameters if parameter.is_in(one.releases.newest)]
    for one in AUTOPILOTS
}


class LossyLink:
    """A ``Link`` into a simulation, as far as asking needs it: messages and their losses, without sockets."""

    system_id, own_id = 1, OURS

    def __init__(self, simulation: Simulation, loss: float) -> None:
        self._simulation, self._loss = simulation, loss
        self._rng = random.Random(4)
        self._mav, self._parser = mavlink.MAVLink(None, *OURS), mavlink.MAVLink(None)
        self.sent: Counter[str] = Counter()
        self.slow_reads = 0
        self.pause = range(0)  # numbers of messages of one name that are lost
        simulation.connect("ground")
        self.queue: asyncio.Queue = asyncio.Queue()

    async def messages(self):
        while True:
            yield await self.queue.get()

    async def send(self, name, fields):
        self.sent[name] += 1
        definition = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        text = {key: value.encode() if isinstance(value, str) else value for key, value in fields.items()}
        frame = definition(**text).pack(self._mav)
        if self._rng.random() >= self._loss and self.sent[name] not in self.pause:
            self._simulation.receive("ground", frame)
        self.run(0.02)

    def run(self, seconds):
        self._simulation.advance(self._simulation.time_s + seconds)
        for _, data in self._simulation.take():
            for message in self._parser.parse_buffer(data) or ():
                if self._rng.random() >= self._loss:
                    fields = json.loads(json.dumps(message.to_dict()).replace("NaN", "null"))  # as MAVSDK has it
                    fields.pop("mavpackettype")
                    self.queue.put_nowait(
                        Message(message.get_type(), message.get_srcSystem(), message.get_srcComponent(), fields, 0.0)
                    )

    def recent(self):
        return ()

    async def parameter(self, name):
        self.slow_reads += 1
        return self._simulation.vehicle.parameters[name]


def asked(flavour, loss, ask):
    """Return what ``ask`` returns for a vehicle of the flavour, the simulation and the link."""

    async def main():
        simulation = Simulation(Settings(flavour=flavour))
        link = LossyLink(simulation, loss)
        vehicle = Vehicle(link)
        pump = asyncio.create_task(vehicle.run())
        link.run(3.0)
        while "HEARTBEAT" not in vehicle.latest:
            await asyncio.sleep(0)
        try:
            return await ask(vehicle), simulation, link
        finally:
            pump.cancel()

    return asyncio.run(main())


@pytest.mark.parametrize("flavour", list(Flavour))
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_all_parameters_are_read_at_once_and_those_that_are_lost_again(flavour, loss, monkeypatch):
    monkeypatch.setattr("sidelong.app.link.stored._VALUE_S", 0.01)
    monkeypatch.setattr("sidelong.app.link.stored._IDLE_S", 0.2)
    names = NAMES[flavour]
    values, simulation, link = asked(flavour, loss, lambda vehicle: read_parameters(vehicle, [*names, "NO_SUCH"]))
    assert values == {name: simulation.vehicle.parameters[name] for name in names}
    if not loss:
        assert link.sent["PARAM_REQUEST_READ"] <= len(names) + 41


def test_parameters_of_a_vehicle_that_pauses_are_not_reported_as_absent(monkeypatch):
    monkeypatch.setattr("sidelong.app.link.stored._VALUE_S", 0.01)
    monkeypatch.setattr("sidelong.app.link.stored._IDLE_S", 0.05)
    names = NAMES[Flavour.ARDUPLANE]

    async def ask(vehicle):
        link = vehicle.link
        link.pause = range(10, 10 + 20 * len(names))  # requests: about 20 rounds of them
        return await read_parameters(vehicle, names)

    values, *_ = asked(Flavour.ARDUPLANE, 0.0, ask)
    assert set(values) == set(names)


def test_a_whole_number_that_looks_like_no_number_is_read_another_way(monkeypatch):
    monkeypatch.setattr("sidelong.app.link.stored._VALUE_S", 0.01)

    async def ask(vehicle):
        vehicle.link._simulation.vehicle.parameters.set("NAV_DLL_ACT", -1)
        return await read_parameters(vehicle, ["NAV_DLL_ACT", "FW_R_LIM"])

    values, _, link = asked(Flavour.PX4, 0.0, ask)
    assert values == {"NAV_DLL_ACT": -1.0, "FW_R_LIM": 50.0}
    assert link.slow_reads == 1


@pytest.mark.parametrize("loss", [0.0, 0.2])
@pytest.mark.parametrize("flavour", list(Flavour))
def test_mission_of_another_vehicle_is_read(flavour, loss):
    corners = [(-353632620, 1491652370), (-353632620, 1491672370), (-353612620, 1491672370)]
    flown = [Item(mavlink.MAV_CMD_NAV_WAYPOINT, 6, (0.0,) * 4, *corner, 0.0) for corner in corners]
    home = [Item(mavlink.MAV_CMD_NAV_WAYPOINT, 0, (0.0,) * 4, -353600000, 1491600000, 500.0)]
    home = home if flavour is Flavour.ARDUPLANE else []

    async def main():
        simulation = Simulation(Settings(flavour=flavour, system_id=7, payload=None))
        simulation.advance(25.0)
        store = simulation.vehicle.transfers[mavlink.MAV_MISSION_TYPE_MISSION].store
        items = [*home, *flown]
        store.begin(len(items))
        for index, item in enumerate(items):
            store.put(index, item, index == 0)
        store.finish()
        link = LossyLink(simulation, loss)
        vehicle = Vehicle(link)
        pump = asyncio.create_task(vehicle.run())
        link.run(3.0)
        try:
            return await read_mission(vehicle, 7, answer_s=0.01)
        finally:
            pump.cancel()

    found = asyncio.run(main())
    assert found.points_deg == [pytest.approx((lat * 1e-7, lon * 1e-7)) for lat, lon in corners]
    assert not found.lap


def random_fences(rng):
    """Return fence items of some polygons and circles, with the outlines and circles that they mean."""
    items, outlines, circles = [], {True: [], False: []}, []
    for _ in range(rng.randint(1, 4)):
        inside, east, north = rng.random() < 0.5, rng.randint(-50_000, 50_000), rng.randint(-50_000, 50_000)
        if rng.random() < 0.5:
            kind = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION + (not inside)
            circles.append((inside, (473_000_000 + north, 85_000_000 + east), radius_m := rng.uniform(20.0, 900.0)))
            items.append((kind, radius_m, circles[-1][1]))
            continue
        angles = sorted(rng.uniform(0.0, 2.0 * math.pi) for _ in range(rng.randint(3, 9)))
        corners = [
            (473_000_000 + north + round(3e4 * math.cos(angle)), 85_000_000 + east + round(4e4 * math.sin(angle)))
            for angle in angles
        ]
        kind = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION + (not inside)
        items += [(kind, float(len(corners)), corner) for corner in corners]
        outlines[inside].append(corners)
    return [Item(kind, 0, (first, 0.0, 0.0, 0.0), *corner, 0.0) for kind, first, corner in items], outlines, circles


@pytest.mark.parametrize("flavour", list(Flavour))
def test_fences_and_rally_points_of_a_vehicle_are_read_in_100_of_100(flavour):
    rng = random.Random(66)

    async def ask(vehicle):
        transfers = vehicle.link._simulation.vehicle.transfers
        for _ in range(50):
            items, outlines, circles = random_fences(rng)
            rally = [Item(mavlink.MAV_CMD_NAV_RALLY_POINT, 3, (0.0,) * 4, 473_000_000, 85_000_000, 90.0)]
            for kind, stored in ((mavlink.MAV_MISSION_TYPE_FENCE, items), (mavlink.MAV_MISSION_TYPE_RALLY, rally)):
                transfers[kind].store.begin(len(stored))
                for index, item in enumerate(stored):
                    transfers[kind].store.put(index, item, False)
                transfers[kind].store.finish()
            found = await read_fences(vehicle, answer_s=0.01)
            assert found.rally == ((pytest.approx(47.3), pytest.approx(8.5)),)
            for inside, read in ((True, found.inclusion), (False, found.exclusion)):
                polygons = [[(lat * 1e-7, lon * 1e-7) for lat, lon in one] for one in outlines[inside]]
                assert [list(map(pytest.approx, one)) for one in polygons] == [
                    list(one) for one in read if len(one) < 64
                ]
                wanted = [(centre, radius_m) for kept, centre, radius_m in circles if kept == inside]
                for (centre, radius_m), outline in zip(wanted, [one for one in read if len(one) == 64], strict=True):
                    plane = LocalPlane(*(value * 1e-7 for value in centre))
                    corners_m = [math.hypot(*plane.east_north_m(*corner)) for corner in outline]
                    assert radius_m * (0.999 if inside else 1.0) <= min(corners_m)
                    assert max(corners_m) <= radius_m * (1.0 if inside else 1.002) + 0.01

    asked(flavour, 0.0, ask)


def test_a_fence_that_is_cut_short_is_refused():
    vertex = {"command": mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, "param1": 4.0, "x": 1, "y": 2}
    with pytest.raises(LookupError, match="fewer than its 4 corners"):
        fences_of([vertex] * 3)


@pytest.mark.parametrize("size", [None, math.nan, math.inf, -1.0])
def test_a_fence_without_a_size_is_refused(size):
    item = {"command": mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, "param1": size, "x": 1, "y": 2}
    for command in (item["command"], mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION):
        with pytest.raises(LookupError, match="without a size"):
            fences_of([item | {"command": command}])
    assert fences_of([item | {"command": mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT}]) == VehicleFences()


def test_mission_that_jumps_back_indefinitely_is_a_lap():
    way = {"command": mavlink.MAV_CMD_NAV_WAYPOINT, "x": 1, "y": 2, "param1": 0.0, "param2": 0.0}
    ways = [{**way, "seq": seq} for seq in (1, 2, 3)]
    jump = {**way, "command": mavlink.MAV_CMD_DO_JUMP, "x": 0, "y": 0, "seq": 4, "param1": 1.0, "param2": -1.0}
    assert mission_of([*ways, jump]).lap
    assert not mission_of([*ways, {**jump, "param2": 3.0}]).lap
    assert not mission_of([*ways, {**jump, "param1": 2.0}]).lap


def test_another_vehicle_that_is_not_received_has_no_mission(monkeypatch):
    monkeypatch.setattr("sidelong.app.link.stored._HEARTBEAT_S", 0.05)
    with pytest.raises(LookupError, match="system 9 is not received"):
        asked(Flavour.PX4, 0.0, lambda vehicle: read_mission(vehicle, 9, answer_s=0.01))


@pytest.mark.parametrize("flavour", list(Flavour))
def test_few_messages_are_some_two_kilobytes_a_second(flavour, monkeypatch):
    monkeypatch.setattr("sidelong.app.link.vehicle._RATE_ANSWER_S", 0.01)

    def bytes_s(few):
        _, simulation, link = asked(flavour, 0.0, lambda vehicle: ask_for_streams(vehicle, few))
        simulation.take()
        simulation.advance(simulation.time_s + 20.0)
        assert link.sent["COMMAND_LONG"] < 90
        return sum(len(data) for _, data in simulation.take()) / 20.0

    assert bytes_s(few=True) < 2600.0
    assert bytes_s(few=True) < 0.8 * bytes_s(few=False)


def test_rates_are_asked_for_again_where_answers_are_lost(monkeypatch):
    monkeypatch.setattr("sidelong.app.link.vehicle._RATE_ANSWER_S", 0.01)
    _, simulation, _ = asked(Flavour.ARDUPLANE, 0.2, ask_for_streams)
    (station,) = simulation.vehicle.radio.stations.values()
    assert station.interval_s[mavlink.MAVLINK_MSG_ID_ATTITUDE] == pytest.approx(0.05)
    assert station.interval_s[mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT] == pytest.approx(0.1)


@pytest.mark.parametrize("few", [False, True])
def test_over_elevation_data_it_asks_for_what_is_wanted_and_known_of_the_ground(few):
    _, simulation, _ = asked(Flavour.ARDUPLANE, 0.0, lambda vehicle: ask_for_streams(vehicle, few, terrain=True))
    (station,) = simulation.vehicle.radio.stations.values()
    assert station.interval_s[mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("urls", "slow"),
    [
        (["serial:///dev/ttyUSB0:57600"], True),
        (["serial_flowcontrol:///dev/ttyUSB0:38400"], True),
        (["serial:///dev/ttyACM0:115200"], False),
        (["udpin://0.0.0.0:14540"], False),
        (["udpin://0.0.0.0:14540", "serial:///dev/ttyUSB0:57600"], True),
    ],
)
def test_a_slow_serial_line_is_known_by_its_url(urls, slow):
    assert is_slow(urls) is slow


def test_a_text_for_ground_stations_is_cut_and_a_lost_link_stops_nothing():
    sent = []

    async def send(name, fields):
        sent.append((name, fields["text"], fields["severity"]))
        raise LinkError("the link is closed")

    vehicle = Vehicle(SimpleNamespace(system_id=1, own_id=OURS, send=send))
    asyncio.run(vehicle.send_text("0123456789" * 6, mavlink.MAV_SEVERITY_NOTICE))
    assert sent == [("STATUSTEXT", "0123456789" * 5, mavlink.MAV_SEVERITY_NOTICE)]


@pytest.mark.parametrize("few", [True, False])
def test_the_configured_choice_of_few_messages_counts_on_any_line(few):
    for url in ("serial:///dev/ttyUSB0:57600", "udpin://0.0.0.0:14540"):
        assert wants_few(load_config(None, {"link": {"url": url, "few_messages": few}}).link) is few
