"""Items written to a simulated ArduPlane over a link that loses packets, on a clock that waits for nobody."""

import asyncio
import random
import selectors
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as mavlink

from app.autopilots.arduplane_transfer import read_mission, write_items
from app.autopilots.autopilot import same_item
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.vehicle import Vehicle
from sitl.settings import Flavour, Settings
from sitl.simulation import Simulation

ACCEPTED, DENIED, TIMEOUT = UploadResult.ACCEPTED, UploadResult.DENIED, UploadResult.TIMEOUT
DELAY_S, STEP_S = 0.025, 0.01
COUNT = 24


def run(work):
    """Run a coroutine on a loop whose clock jumps to whatever comes next."""
    now_s = [0.0]

    class Idle(selectors.SelectSelector):
        def select(self, timeout=None):
            now_s[0] += timeout or 0.0
            return super().select(0)

    loop = asyncio.SelectorEventLoop(Idle())
    loop.time = lambda: now_s[0]
    try:
        return loop.run_until_complete(work)
    finally:
        loop.close()


class LossyLink:
    """A link to a simulation, ``DELAY_S`` away; each packet is lost with a probability, one in ten overtaken."""

    system_id = 1

    def __init__(self, simulation, loss, seed):
        self.simulation, self.loss, self.rng = simulation, loss, random.Random(seed)
        self.mav = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        self.parser = mavlink.MAVLink(None)
        self.queue = asyncio.Queue()
        self.carried = 0
        simulation.connect(self.mav.srcSystem)

    async def send(self, name, fields):
        message = getattr(mavlink, f"MAVLink_{name.lower()}_message")(**fields)
        frame = message.pack(self.mav)
        if self.rng.random() >= self.loss:
            self.carry(self.simulation.receive, self.mav.srcSystem, frame)

    def carry(self, deliver, *what):
        self.carried += 1
        late_s = DELAY_S if self.loss and self.rng.random() < 0.1 else 0.0
        asyncio.get_running_loop().call_later(DELAY_S + late_s + 1e-6 * self.carried, deliver, *what)

    async def run(self):
        loop = asyncio.get_running_loop()
        ahead_s = self.simulation.time_s - loop.time()
        while True:
            self.simulation.advance(ahead_s + loop.time())
            for address, frame in self.simulation.take():
                if address == self.mav.srcSystem and self.rng.random() >= self.loss:
                    for message in self.parser.parse_buffer(frame) or ():
                        self.carry(self.queue.put_nowait, message)
            await asyncio.sleep(STEP_S)

    async def messages(self):
        while True:
            got = await self.queue.get()
            fields = {name: getattr(got, name) for name in got.get_fieldnames()}
            yield Message(got.get_type(), got.get_srcSystem(), got.get_srcComponent(), fields, 0.0)


def circle(tag):
    return RawItem(17, 6, 0.0, 0.0, 60.0 + tag % 20, 0.0, 470_000_000 + tag, 80_000_000 - tag, 100.0)


OLD = tuple(circle(seq) for seq in range(COUNT))
NEW = tuple(circle(1000 + seq) if 5 <= seq < 12 else OLD[seq] for seq in range(COUNT))
CHANGED = range(5, 12)


def fly(loss, seed, *works):
    """Let one work after the other at a vehicle; return results, the items held, how long the last one took."""

    async def go():
        simulation = Simulation(replace(Settings(), flavour=Flavour.ARDUPLANE, payload=None))
        results = []
        for number, work in enumerate(works):
            link = LossyLink(simulation, loss if number else 0.0, seed)
            vehicle = Vehicle(link)
            tasks = [asyncio.create_task(vehicle.run()), asyncio.create_task(link.run())]
            begin_s = asyncio.get_running_loop().time()
            results.append(await work(vehicle))
            took_s = asyncio.get_running_loop().time() - begin_s
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        items = [
            RawItem(i.command, 6, *i.params, i.latitude_e7, i.longitude_e7, i.altitude_m)
            for i in simulation.vehicle.mission.items()
        ]
        return results, items, took_s

    return run(go())


def whole(vehicle):
    return write_items(vehicle, OLD, range(COUNT), 8.0)


@pytest.mark.parametrize("loss", [0.0, 0.05, 0.2, 0.5])
def test_a_part_is_written_and_the_rest_is_left_alone(loss):
    took_s = []
    for seed in range(12):
        results, items, seconds = fly(loss, seed, whole, lambda v: write_items(v, NEW, CHANGED, 20.0))
        assert results == [ACCEPTED, ACCEPTED]
        assert all(map(same_item, items[1:], NEW[1:]))
        took_s.append(seconds)
    assert sorted(took_s)[6] < {0.0: 0.2, 0.05: 0.8, 0.2: 2.0, 0.5: 20.0}[loss]  # of the link's clock


def test_cut_at_any_moment_each_item_is_the_old_or_the_new_one_and_a_second_try_ends_it():
    for hundredths in range(2, 40, 2):
        first = lambda v, s=hundredths / 100.0: write_items(v, NEW, CHANGED, s)  # noqa: E731 - a table of attempts
        results, items, _ = fly(0.2, hundredths, whole, first)
        assert results[1] in (ACCEPTED, TIMEOUT)
        assert len(items) == COUNT
        for seq in range(1, COUNT):
            assert same_item(items[seq], OLD[seq]) or same_item(items[seq], NEW[seq])
        results, items, _ = fly(0.2, hundredths, whole, first, lambda v: write_items(v, NEW, CHANGED, 20.0))
        assert results[2] is ACCEPTED
        assert all(map(same_item, items[1:], NEW[1:]))


def test_an_item_that_the_vehicle_refuses_is_a_refusal():
    bad = (*NEW[:6], replace(NEW[6], command=31_000), *NEW[7:])
    results, items, _ = fly(0.0, 1, whole, lambda v: write_items(v, bad, CHANGED, 8.0))
    assert results[1] is DENIED
    assert all(map(same_item, items[7:], OLD[7:]))


def test_places_that_the_vehicle_does_not_have_are_a_refusal():
    longer = (*OLD, *(circle(500 + seq) for seq in range(6)))
    results, items, _ = fly(0.0, 1, whole, lambda v: write_items(v, longer, range(COUNT, COUNT + 6), 8.0))
    assert results[1] in (DENIED, TIMEOUT)
    assert len(items) <= COUNT + 1


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_the_mission_is_read_as_it_is_held(loss):
    results, _, took_s = fly(loss, 5, whole, lambda v: read_mission(v, 20.0))
    assert all(map(same_item, results[1][1:], OLD[1:]))
    assert took_s < (0.3 if loss == 0.0 else 3.0)  # of the link's clock
