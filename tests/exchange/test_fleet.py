"""Simulated vehicles, their cores and the coordinator on one clock that waits for no one."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.fleet.coordination import (
    FLEET_JOURNAL_TYPES,
    Coordination,
    Participant,
    VehicleClockReader,
    compare_coordination,
    coordinator_of,
)
from sidelong.app.fleet.fleet_file import FleetFile, planner_in_fleet
from sidelong.app.records.journal import Header, JournalReader, JournalWriter, encode
from sidelong.mission.core.events import End
from sidelong.mission.core.fleet import Role
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.fleet.events import PlansReported, SightingReported
from sidelong.sitl.settings import STARTS_M, Flavour, Settings, TargetSettings, in_a_row
from tests.messages import message

SYSTEM_TIME, DO_SET_ROI_LOCATION = 2, 195


class Craft:
    """One aircraft: a flight of the exchange's tests with a core that follows the coordinator."""

    def __init__(self, member, flight):
        self.name, self.config, self.flight = member.name, member.config, flight
        self.waiting: deque = deque()
        self.grounded = member.reserve  # its core does not run yet
        home = flight.autopilot.home
        self.home = Home(home.latitude_deg, home.longitude_deg, home.altitude_m)

    def make_core(self, plane):
        controller = prepared(self.config, kind=planner_in_fleet(self.config)).controller()
        return mission_controller_of(self.config, controller, self.flight.dialect, plane, self.home)


class Fleet:
    """ArduPlanes and PX4s in turn; the second may be a reserve."""

    def __init__(self, fly, tmp_path, seed=2, reserve=False, names=("north", "south"), targets=("target",)):
        aircraft = [{"name": name} for name in names]
        aircraft[1]["reserve"] = reserve
        described = {"aircraft": aircraft, "target": [{"name": name} for name in targets]}
        self.file = FleetFile.model_validate({**described, "requirement": {"target_speed_max_m_s": 3.0}})
        moving = (
            TargetSettings("straight", 2.0, start_m, name=name)
            for name, start_m in zip(targets, STARTS_M, strict=False)
        )
        first = Settings(seed=seed, targets=tuple(moving))
        seen = [targets.index(member.target) for member in self.file.members]
        settings = [
            replace(one, flavour=list(Flavour)[k % 2], endurance_s=1e4, looks_at=seen[k % len(seen)])
            for k, one in enumerate(in_a_row(first, len(names)))
        ]
        self.crafts = [
            Craft(member, fly(one.flavour, settings=one, begin=False, seed=one.seed))
            for member, one in zip(self.file.members, settings, strict=True)
        ]
        self.coordinator = coordinator_of(self.file)
        plane = self.crafts[0].flight.telemetry.plane
        self.journal_path = tmp_path / "fleet.jsonl"
        header = Header("test", self.file.model_dump(mode="json"), plane, {})
        self.journal = JournalWriter(self.journal_path, header, pytest.fail)
        self.announced: list[str] = []
        self.coordination = Coordination(
            self.coordinator, self.journal, lambda name, text: self.announced.append(f"{name} {text}"), self._launch
        )
        for craft in self.crafts:
            self._join(craft, plane)

    def _join(self, craft, plane):
        flight, name = craft.flight, craft.name
        flight.telemetry.plane = plane
        flight.to_vehicle("COMMAND_LONG", command=511, param1=SYSTEM_TIME, param2=1e6)
        core = craft.make_core(plane)
        step = core.step
        clock = VehicleClockReader(name, lambda: flight.telemetry.now_s)
        self.coordination.add(Participant(name, core.controller, craft.waiting.append, clock))
        stepped = self.coordination.stepped(name)

        def received(event):
            outputs = step(event)
            if not craft.grounded:
                stepped(event, outputs)
            return outputs

        core.step = received
        flight.core = core

        def clock_only(message):
            if message.name == "SYSTEM_TIME":
                self.coordination.message(name, message)

        flight.vehicle.listeners.append(clock_only)

    def _launch(self, name):
        craft = next(craft for craft in self.crafts if craft.name == name)
        craft.grounded = False
        craft.flight.take_over()

    def charge(self, name, percent):
        self.coordination.message(name, message("SYS_STATUS", battery_remaining=percent))

    def run(self, seconds, until=lambda: False):
        end_s = self.crafts[0].flight.simulation.time_s + seconds
        while self.crafts[0].flight.simulation.time_s < end_s:
            for craft in self.crafts:
                craft.flight.step()
                while craft.waiting:
                    craft.flight.put(craft.waiting.popleft())
                if craft.flight.core.controller.snapshot().turn_payload:
                    self._turn_payload(craft)
            self.coordination.advance(self.crafts[0].flight.simulation.time_s)
            if until():
                return True
        return False

    def _turn_payload(self, craft):
        """Point its gimbal, as a live flight does."""
        estimate = craft.flight.core.controller.estimate
        plane = self.crafts[0].flight.telemetry.plane
        x, y = (round(1e7 * degrees) for degrees in plane.latitude_longitude_deg(estimate.east_m, estimate.north_m))
        craft.flight.to_vehicle("COMMAND_INT", command=DO_SET_ROI_LOCATION, frame=0, x=x, y=y, z=0.0)

    def take_off(self, *crafts):
        for craft in crafts or reversed(self.crafts):  # the highest layer first
            craft.flight.take_over()
            assert self.run(240.0, lambda craft=craft: craft.flight.has_control), craft.flight.outputs[-3:]

    def role(self, name):
        return self.coordinator.roles[name][1]

    @property
    def targets(self):
        return {name: target for name, (target, _) in self.coordinator.roles.items()}

    def separation_m(self):
        places = [
            (autopilot.craft.east_m + 200.0 * k, autopilot.craft.north_m, autopilot.craft.height_m)
            for k, autopilot in enumerate(craft.flight.autopilot for craft in self.crafts)
        ]
        return float(np.linalg.norm(np.subtract(*places)))


@pytest.fixture(scope="module")
def flown(fly, tmp_path_factory):
    """Return a fleet after a flight in which the holder of the required side was lost."""
    fleet = Fleet(fly, tmp_path_factory.mktemp("fleet"))
    fleet.take_off()
    fleet.least_m = np.inf

    def apart():
        fleet.least_m = min(fleet.least_m, fleet.separation_m())
        return False

    fleet.run(90.0, apart)
    fleet.roles_before = {craft.name: fleet.role(craft.name) for craft in fleet.crafts}
    fleet.holder = next(craft for craft in fleet.crafts if fleet.role(craft.name) is Role.WANTED)
    fleet.other = next(craft for craft in fleet.crafts if craft is not fleet.holder)
    fleet.holder.flight.simulation.lost_s = fleet.holder.flight.simulation.time_s
    fleet.run(60.0)
    fleet.journal.close()
    return fleet


def test_one_holds_the_required_side_and_the_other_the_opposite(flown):
    assert sorted(flown.roles_before.values()) == [Role.OPPOSITE, Role.WANTED]


def test_they_stay_apart(flown):
    assert flown.least_m >= 50.0


def test_the_other_takes_over_when_the_holder_is_lost(flown):
    assert flown.role(flown.other.name) is Role.WANTED
    assert any(
        announced.startswith(f"{flown.holder.name} is out: no message received") for announced in flown.announced
    )
    controller = flown.other.flight.core.controller
    assert controller.phase == "watching"
    assert controller.snapshot().side == flown.file.requirement.side


def test_the_coordinators_journal_replays_to_the_last_bit(flown):
    records = list(JournalReader(flown.journal_path, FLEET_JOURNAL_TYPES))
    assert sum(isinstance(record, SightingReported) for record in records) > 1000
    assert any(isinstance(record, PlansReported) for record in records)
    steps = compare_coordination(coordinator_of(flown.file), records)
    assert (steps.difference, steps.rounded) == (None, 0)
    assert steps.compared > 200
    corrupted = [record for record in records if not isinstance(record, SightingReported)]
    assert compare_coordination(coordinator_of(flown.file), corrupted).difference is not None


def test_each_core_replays_on_its_own_to_the_last_bit(flown):
    plane = flown.crafts[0].flight.telemetry.plane
    for craft in flown.crafts:
        core = craft.make_core(plane)
        for event, outputs in zip(craft.flight.events, craft.flight.outputs, strict=True):
            assert [encode(output) for output in core.step(event)] == [encode(output) for output in outputs]


def test_a_reserve_takes_over_before_the_aircraft_with_a_low_battery_leaves(fly, tmp_path):
    fleet = Fleet(fly, tmp_path, reserve=True)
    north, south = fleet.crafts
    fleet.take_off(north)
    fleet.run(10.0)
    assert not south.flight.autopilot.armed
    fleet.charge("north", 25)
    assert fleet.run(200.0, lambda: south.flight.has_control), fleet.announced
    assert any(announced.startswith("south is wanted in the air: north") for announced in fleet.announced)
    assert north.flight.core.controller.phase == "watching"
    assert fleet.run(200.0, lambda: north.flight.found(End)), fleet.announced
    assert [end.action for end in north.flight.found(End)] == ["return"]
    assert fleet.role("south") is Role.WANTED
    assert south.flight.core.controller.phase == "watching"
    assert fleet.separation_m() >= 50.0
    fleet.journal.close()


@pytest.fixture(scope="module")
def divided(fly, tmp_path_factory):
    """Return a fleet of three on two targets after a flight in which the only one on the second target was lost."""
    fleet = Fleet(fly, tmp_path_factory.mktemp("divided"), names=("north", "south", "east"), targets=("boat", "bike"))
    fleet.take_off()
    fleet.run(30.0)
    fleet.targets_before = fleet.targets
    fleet.lost = next(craft for craft in fleet.crafts if fleet.targets[craft.name] == "bike")
    fleet.lost.flight.simulation.lost_s = fleet.lost.flight.simulation.time_s
    fleet.estimates = []

    def seen():
        now = fleet.crafts[0].flight
        bike_m = now.simulation.motions[1].at(now.simulation.time_s)
        found = fleet.coordinator.estimate("bike")
        fleet.estimates.append(float(np.hypot(found.east_m - bike_m[0], found.north_m - bike_m[1])))
        return False

    fleet.run(110.0, seen)
    fleet.journal.close()
    return fleet


def test_each_target_has_its_aircraft_and_a_lost_one_is_replaced(divided):
    assert sorted(divided.targets_before.values()) == ["bike", "boat", "boat"]
    next_to_bike = [craft for craft in divided.crafts if divided.targets[craft.name] == "bike"]
    (moved,) = (craft for craft in next_to_bike if craft is not divided.lost)
    assert f"{moved.name} goes to bike" in divided.announced
    assert f"{moved.name} its payload sees bike" in divided.announced
    assert moved.flight.simulation.looks_at == 1
    now = moved.flight.core.controller.snapshot()
    assert (now.phase, now.target, now.turn_payload, now.side) == ("watching", "bike", False, "left")
    assert np.hypot(now.aircraft.east_m - now.estimate.east_m, now.aircraft.north_m - now.estimate.north_m) < 500.0
    assert divided.role(moved.name) is Role.WANTED


def test_a_payload_on_its_way_to_another_target_spoils_no_track(divided):
    assert max(divided.estimates) < 30.0  # unseen for a while, it goes on by its motion
    assert np.mean(divided.estimates[-100:]) < 3.0
    boat = divided.coordinator.estimate("boat")
    now = divided.crafts[0].flight
    assert (
        np.hypot(*np.subtract((boat.east_m, boat.north_m), now.simulation.motions[0].at(now.simulation.time_s))) < 3.0
    )


def test_a_fleet_of_two_targets_replays_to_the_last_bit(divided):
    records = list(JournalReader(divided.journal_path, FLEET_JOURNAL_TYPES))
    steps = compare_coordination(coordinator_of(divided.file), records)
    assert (steps.difference, steps.rounded, steps.compared > 300) == (None, 0, True)
