"""A payload that follows another object is found out; tests/bench/test_another_object.py flies more scenes."""

from __future__ import annotations

import pytest

from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.estimators.filters.biases import Calibration
from sidelong.estimators.sensing.sighting import Fix, SightingOutcome
from sidelong.mission.control.target_news import AnotherObject
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, OperatorRequest
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Requirement, Side
from tests.faults.another_object import flown

NONE = Calibration(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0)


@pytest.mark.parametrize(("kind", "seed"), [("crossing", 1), ("swap", 0), ("shadow", 0)])
def test_another_object_counts_as_unknown_and_both_are_kept_clear(kind, seed):
    seen = flown(seed, kind)
    assert seen.known_s <= 15.0
    assert seen.least_m >= 80.0
    assert any("may follow another object" in text for text in seen.announced)


def noted(places_m, every_s=0.5, objected=True):
    """Return what was noticed of sightings at these positions, with that of the last one."""
    another = AnotherObject()
    for number, (east_m, north_m) in enumerate(places_m):
        fix = Fix(every_s * number, east_m, north_m, 1.0)
        outcome = SightingOutcome(fix, not objected, 20.0 if objected else 1.0, "")
        state = AircraftState(every_s * number, 0.0, 300.0, 0.0, 15.0, 0.0)
        another.note([outcome], state, lambda: NONE, REQUIREMENT)
    return another


def test_a_step_of_thirteen_metres_is_one_and_a_walk_or_outliers_are_none():
    there = [(0.0, 0.0)] * 9
    assert "jumped by 13 m" in noted([*there, *((13.0, 0.0),) * 12], 0.2).reason
    assert noted([*there, *((13.0, 0.0),) * 12], 0.2, objected=False).reason == ""
    assert noted([*there, *((40.0, 0.0),) * 7, *there], 0.2).reason == ""  # a hedge for a second
    assert noted([(1.5 * k, 0.0) for k in range(40)]).reason == ""  # as fast as it may be


def test_agreement_of_a_minute_and_a_jump_back():
    back = noted([*((0.0, 0.0),) * 20, *((60.0, 0.0),) * 40, *((0.0, 0.0),) * 40])
    assert "jumped back by 60 m" in back.reason
    left = back.left(50.0)
    assert (left.east_m, left.north_m) == (60.0, 0.0)
    texts = [one.text for one in back.announce(50.0)]
    assert len(texts) == 1
    agreed = noted([*((0.0, 0.0),) * 20, *((60.0, 0.0),) * 130])
    assert agreed.reason == ""
    assert agreed.left(75.0) is None
    assert agreed.announce(75.0)[-1].text.endswith("60 s without a contradiction")


def test_an_operator_confirms_the_object():
    controller = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()
    controller.step(ControlAcquired(100.0, Circle(0.0, 0.0, 60.0, True), "AUTO"))
    controller._object.suspect(101.0, "the payload may follow another object")
    assert controller.snapshot().unknown == "the payload may follow another object"
    controller.step(OperatorRequest(102.0, "confirm", who="operator"))
    assert controller.snapshot().unknown == ""
