import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.mission.core.requirement import Wind
from sidelong.mission.predictive.rollout_kernel import table_value
from sidelong.mission.predictive.scene_kernel import classes_about
from sidelong.mission.predictive.value_table import (
    TableConfiguration,
    TargetHabits,
    WatchCost,
    completed,
    expected_after_turn,
)
from tests.mission.plain_rollout import RollOut, moves_from, staying_on

SMALL = TableConfiguration(10.0, 50.0, 50.0, 0.0008, 5.0, WatchCost.inside(100.0, 500.0), cells=8)
SECTOR = replace(SMALL, cost=WatchCost.inside(100.0, 500.0, math.radians(60.0)), follows_course=False)


class Motion:
    """A value table for one velocity of the target in the watch frame, m/s, interpolated between its classes."""

    def __init__(self, table, target_m_s):
        self.table = table.arrays
        self._classes, self._share, _ = map(np.array, classes_about(table.motions, *target_m_s, 0.0, 0.0))

    def value(self, *place):
        arrays, motion = self.table, (self._classes[None, None], self._share[None, None], 0, 0)
        x, y, heading = np.broadcast_arrays(*place)
        found = [
            table_value(arrays.values, arrays.cell_m, *map(float, one), *motion)
            for one in zip(x.flat, y.flat, heading.flat, strict=True)
        ]
        return found[0] if len(found) == 1 else np.reshape(found, x.shape)


def test_values_are_lowest_next_to_the_target_on_the_side(paper_table):
    motion = Motion(paper_table, (0.0, 4.0))
    alongside = float(motion.value(-250.0, 0.0, 0.0))
    assert 0.0 < alongside < float(motion.value(-120.0, 0.0, 0.0))
    assert alongside < float(motion.value(-470.0, 0.0, 0.0))
    assert float(motion.value(250.0, 0.0, 0.0)) > alongside + 15.0  # it takes about half a minute to come round
    assert float(motion.value(-50.0, 0.0, 0.0)) > 100.0


def test_a_place_ahead_is_worth_more_the_faster_the_target(paper_table):
    """A fast target runs up to the aircraft ahead and away from the one behind."""
    ahead, behind = ((-150.0, y) for y in (300.0, -300.0))
    gain = [
        float(Motion(paper_table, (0.0, speed)).value(*behind, 0.0))
        - float(Motion(paper_table, (0.0, speed)).value(*ahead, 0.0))
        for speed in (0.0, 5.0)
    ]
    assert gain[1] > gain[0] + 0.5


def test_the_table_interpolates_between_its_nodes_and_speeds(paper_table):
    motion = Motion(paper_table, (0.0, 2.5))
    node, cell_m = paper_table.values[1, 3, 10, 20], motion.table.cell_m
    half = paper_table.values.shape[-1] // 2
    x_m, y_m, heading_rad = (10 - half) * cell_m, (20 - half) * cell_m, 3 * math.pi / 12
    assert float(motion.value(x_m, y_m, heading_rad)) == pytest.approx(node, rel=1e-4)
    assert float(motion.value(x_m, y_m, heading_rad - 2.0 * math.pi)) == pytest.approx(node, rel=1e-4)
    between = Motion(paper_table, (0.0, 1.25)).value(-200.0, 30.0, 1.0)
    slow, fast = (Motion(paper_table, (0.0, speed)).value(-200.0, 30.0, 1.0) for speed in (0.0, 2.5))
    assert float(between) == pytest.approx(0.5 * (float(slow) + float(fast)), rel=1e-4)


def test_the_table_agrees_with_roll_outs_from_it(paper_table):
    """Bellman's equation, by another road: the best roll-out from a place costs what the table reports of it."""
    c = paper_table.configuration
    rng = np.random.default_rng(1)
    for speed_m_s in (0.0, 2.5, 5.0):
        motion = Motion(paper_table, (0.0, speed_m_s))
        roll_out = RollOut(paper_table, (0.0, speed_m_s), Wind(), (0.0, 0.0, 0.0), 10.0)
        off = []
        for _ in range(40):
            range_m, aside_rad, heading_rad = rng.uniform(180, 420), rng.uniform(-1.2, 1.2), rng.uniform(-3, 3)
            place = -range_m * math.cos(aside_rad), range_m * math.sin(aside_rad), heading_rad
            leaving = moves_from(1.0 / c.radius_m, c.radius_m, c.turn_radius_m, c.sharpness_per_m2)
            staying = staying_on(1.0 / c.radius_m, c.radius_m, c.sharpness_per_m2)
            # The last move, back to the circle at once, is none when flown from the circle.
            leaving_cost = c.leave_cost + roll_out.costs(leaving, *place)[:-1].min()
            best = min(leaving_cost, roll_out.costs(staying, *place).min())
            off.append(float(best) - float(motion.value(*place)))
        assert abs(np.median(off)) < 0.3
        assert np.percentile(np.abs(off), 80) < 0.5  # a few places lie where the table is steep


def test_a_stop_keeps_the_side_and_a_turn_back_swaps_the_sides():
    values = np.random.default_rng(1).random((3, 24, 17, 17)).astype(np.float32)
    stops = replace(SMALL, habits=TargetHabits(stop=1.0))
    np.testing.assert_allclose(expected_after_turn(stops, values)[1], values[0], rtol=1e-5)
    back = replace(SMALL, habits=TargetHabits(stop=0.0, min_speed=1.0, turns_deg=(180.0,), chances=(1.0,)))
    after = completed(back, values).after_turn[2]
    # Half a turn of the frame: places and headings all swap.
    np.testing.assert_allclose(after[3], values[2, 15, ::-1, ::-1], atol=3e-3)


def test_what_never_changes_is_expected_after_any_turn():
    for configuration, classes in ((SMALL, 3), (SECTOR, 17)):
        values = np.full((classes, 24, 17, 17), 7.0, np.float32)
        np.testing.assert_allclose(expected_after_turn(configuration, values), 7.0, rtol=1e-5)


def test_the_key_reports_configurations_apart():
    keys = {
        SMALL.key(),
        replace(SMALL, airspeed_m_s=11.0).key(),
        replace(SMALL, cost=WatchCost.inside(100.0, 400.0)).key(),
        replace(SMALL, habits=TargetHabits(mean_leg_s=60.0)).key(),
        replace(SMALL, cells=10).key(),
    }
    assert len(keys) == 5
    assert SMALL.key() == replace(SMALL).key()


def test_stored_values_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="values: expected"):
        completed(SMALL, np.zeros((3, 24, 5, 5), np.float32))
    with pytest.raises(ValueError, match="values: expected"):
        completed(SMALL, np.full((3, 24, 17, 17), np.nan, np.float32))


def test_a_sector_interpolates_between_directions_and_speeds():
    values = np.random.default_rng(1).random((17, 24, 17, 17)).astype(np.float32)
    table = completed(SECTOR, values)
    # Half way between north and north-east, and between half and full speed.
    motion = Motion(table, (3.75 * math.sin(math.pi / 8), 3.75 * math.cos(math.pi / 8)))
    cell_m = motion.table.cell_m
    node = 2 * cell_m, -3 * cell_m, 5 * math.pi / 12
    assert float(motion.value(*node)) == pytest.approx(values[[1, 2, 9, 10], 5, 10, 5].mean(), rel=1e-4)
    assert float(Motion(table, (0.0, 0.0)).value(*node)) == pytest.approx(values[0, 5, 10, 5], rel=1e-4)
    # Half a turn takes the class of motion to the south to that of motion to the north.
    back = replace(SECTOR, habits=TargetHabits(stop=0.0, min_speed=1.0, turns_deg=(180.0,), chances=(1.0,)))
    np.testing.assert_allclose(expected_after_turn(back, values)[9 + 4], values[9], rtol=1e-5)
