"""What ``connect`` reports of each laser and gimbal is what the tracker then does."""

from __future__ import annotations

import itertools

import pytest

from sidelong.app.assembly import tracker_of
from sidelong.app.config import Config
from sidelong.app.flight.preflight import describe_use
from sidelong.estimators.sensing.readings import GimbalReading, RangeReading, Source

PAYLOAD = Source("DISTANCE_SENSOR", 154, 1, 100)
REPEATED = Source("DISTANCE_SENSOR", 1, 1, 100)
DOWNWARD = Source("DISTANCE_SENSOR", 1, 0, 25)
FIXED = Source("DISTANCE_SENSOR", 155, 2, 0)
OWN = Source("RANGEFINDER", 1)
GIMBAL, GIMBAL_REPEATED = (Source("GIMBAL_DEVICE_ATTITUDE_STATUS", component) for component in (154, 1))
DEFAULT, NAMED = Config(), Config.model_validate({"sensors": {"range_component": 155}})


def used(config: Config, sources: tuple[Source, ...]) -> Source | None:
    """Return the laser that a tracker uses of those that all speak for five seconds."""
    tracker = tracker_of(config)
    for tick, source in itertools.product(range(50), sources):
        tracker.add(RangeReading(10.0 + tick / 10.0, 300.0, source))
    return tracker.ranges.chosen


@pytest.mark.parametrize("config", [DEFAULT, NAMED], ids=["on its own", "named"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_the_laser_that_is_reported_to_be_used_is_the_one_the_tracker_uses(config, count):
    for sources in itertools.combinations((OWN, DOWNWARD, REPEATED, FIXED, PAYLOAD), count):
        announced = describe_use(config, "range", sources)
        assert [source for source, words in announced.items() if words.startswith("used")] == (
            [] if (taken := used(config, sources)) is None else [taken]
        )


def test_reasons_are_reported():
    announced = describe_use(DEFAULT, "range", (PAYLOAD, REPEATED, DOWNWARD, FIXED, OWN))
    assert announced[PAYLOAD] == "used: the payload's own, before what repeats it"
    assert announced[REPEATED].endswith("the autopilot only repeats it")
    assert announced[DOWNWARD] == "not used: it looks down; sensors.range_component = 1 would use it"
    assert announced[OWN].startswith("not used: it is a sensor of the autopilot")
    assert (
        describe_use(NAMED, "range", (PAYLOAD,))[PAYLOAD] == "not used: it is not what sensors.range_component names"
    )


def test_gimbals_are_reported_likewise():
    announced = describe_use(DEFAULT, "gimbal", (GIMBAL_REPEATED, GIMBAL))
    assert announced[GIMBAL].startswith("used")
    assert announced[GIMBAL_REPEATED].startswith("stands by")
    tracker = tracker_of(DEFAULT)
    for source in (GIMBAL_REPEATED, GIMBAL):
        tracker.add(GimbalReading(10.0, (1.0, 0.0, 0.0, 0.0), "earth", source))
    assert tracker.gimbals.chosen == GIMBAL
