import pytest

from sidelong.estimators.sensing.readings import Source
from sidelong.estimators.settings import SourceChoice
from sidelong.estimators.tracking.sources import PROVEN_S, SourceSelector, range_rank, sight_rank

PAYLOAD = Source("DISTANCE_SENSOR", 154, 1, 100)
REPEATED = Source("DISTANCE_SENSOR", 1, 1, 100)
DOWNWARD = Source("DISTANCE_SENSOR", 1, 0, 25)
FORWARD = Source("DISTANCE_SENSOR", 1, 2, 0)
AUTOPILOTS_OWN = Source("RANGEFINDER", 1)
COMPANIONS = Source("RANGEFINDER", 191)


def test_the_payload_is_chosen_and_its_repetition_and_the_downward_sensor_are_not():
    ranges = SourceSelector(range_rank)
    assert not ranges.accepts(DOWNWARD, 0.0)
    assert ranges.accepts(REPEATED, 0.1)
    assert ranges.accepts(PAYLOAD, 0.2)
    assert not ranges.accepts(REPEATED, 0.3)
    assert not ranges.accepts(DOWNWARD, 0.4)
    assert ranges.chosen == PAYLOAD


def test_the_downward_sensor_is_never_chosen_even_alone():
    ranges = SourceSelector(range_rank)
    assert not any(ranges.accepts(source, time_s) for time_s in range(100) for source in (DOWNWARD, AUTOPILOTS_OWN))
    assert ranges.chosen is None


def test_the_next_best_stands_in_while_the_chosen_one_is_silent():
    ranges = SourceSelector(range_rank, silent_after_s=10.0)
    assert ranges.accepts(PAYLOAD, 0.0)
    assert not ranges.accepts(REPEATED, 9.9)
    assert ranges.accepts(REPEATED, 10.0)
    assert ranges.accepts(PAYLOAD, 10.1)
    assert not ranges.accepts(REPEATED, 10.2)


@pytest.mark.parametrize(("better", "worse"), [(PAYLOAD, FORWARD), (COMPANIONS, REPEATED), (REPEATED, FORWARD)])
def test_payload_comes_before_autopilot_and_a_gimbals_range_before_a_fixed_one(better, worse):
    for first, second in ((better, worse), (worse, better)):
        ranges = SourceSelector(range_rank)
        ranges.accepts(first, 0.0)
        ranges.accepts(second, 0.1)
        assert ranges.chosen == better


def test_a_choice_is_final():
    ranges = SourceSelector(range_rank, SourceChoice(component_id=1, orientation=25))
    assert not ranges.accepts(PAYLOAD, 0.0)
    assert ranges.accepts(DOWNWARD, 0.1)


def test_a_gimbal_comes_before_a_range_sensors_own_quaternion():
    sights = SourceSelector(sight_rank)
    gimbal = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    assert sights.accepts(PAYLOAD, 0.0)
    assert sights.accepts(gimbal, 0.1)
    assert not sights.accepts(PAYLOAD, 0.2)


def test_a_source_that_contradicted_the_track_has_to_agree_for_some_time():
    selector, first, second = SourceSelector(sight_rank), Source("A", 154), Source("A", 171)
    assert selector.accepts(first, 0.0)
    assert not selector.accepts(second, 11.0, lambda: False)
    assert not selector.accepts(second, 12.0, lambda: True)
    assert not selector.accepts(second, 13.0, lambda: False)
    assert not selector.accepts(second, 14.0, lambda: True)
    assert not selector.accepts(second, 21.0, lambda: True)
    assert selector.accepts(second, 14.0 + PROVEN_S, lambda: True)
    assert selector.refused == []
