"""What counts as a report of our autopilot to us: acknowledgements of others do not."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sidelong.app.flight.loop import VehicleReports
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.exchange.reports import CommandAcknowledged, MissionAcknowledged
from tests.messages import message

OURS, OTHER = {"target_system": 245, "target_component": 190}, {"target_system": 250, "target_component": 190}
COMMAND = {"command": 400, "result": 0}
MISSION = {"type": 0, "mission_type": 0}


@pytest.fixture
def report():
    vehicle = Vehicle(SimpleNamespace(system_id=1, own_id=(245, 190)))
    reports = VehicleReports(vehicle)
    return lambda name, component, fields: reports.report(message(name, component, **fields), 2.0, 3.0)


@pytest.mark.parametrize("component", [100, 154, 191])
def test_another_component_acknowledges_nothing_of_ours(report, component):
    assert report("COMMAND_ACK", component, COMMAND | OURS) is None
    assert report("MISSION_ACK", component, MISSION | OURS) is None


def test_what_is_acknowledged_to_another_station_is_not_ours(report):
    assert report("COMMAND_ACK", 1, COMMAND | OTHER) is None
    assert report("MISSION_ACK", 1, MISSION | OTHER) is None


def test_the_autopilot_s_own_word_to_us_counts_and_that_of_an_old_one_to_no_one(report):
    assert report("COMMAND_ACK", 1, COMMAND | OURS) == CommandAcknowledged(2.0, 3.0, 400, 0)
    assert report("COMMAND_ACK", 1, COMMAND) == CommandAcknowledged(2.0, 3.0, 400, 0)
    assert report("MISSION_ACK", 1, MISSION | OURS) == MissionAcknowledged(2.0, 3.0, 0, 0)


def test_fences_and_rally_points_are_another_list(report):
    assert report("MISSION_ACK", 1, MISSION | OURS | {"mission_type": 1}) is None
