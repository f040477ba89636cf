"""Over real hills, what takes minutes: python -m pytest tests/terrain/bench -s."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import ClimbRates, Plan
from sidelong.mission.terrain.heights import FlightHeights, HeightRules

CLEARANCE_M = 50.0


@pytest.mark.parametrize(("range_m", "height_m"), [(300.0, 100.0), (500.0, 100.0)])
def test_four_thousand_places(ground: Ground, range_m: float, height_m: float) -> None:
    """Circles of 50 m next to a target anywhere: flown at one height over the target, and as they are planned."""
    rng = np.random.default_rng(1)
    heights = FlightHeights(ground, HeightRules(height_m, "ground", CLEARANCE_M, ClimbRates(15.0)))
    around_rad = np.linspace(0.0, 2.0 * math.pi, 400)
    low = hit = blocked = places = refused = 0
    planned_m: list[float] = []
    while places < 4000:
        east_m, north_m = rng.uniform(-14_000.0, 14_000.0, 2).tolist()
        bearing_rad = rng.uniform(0.0, 2.0 * math.pi)
        circle = Circle(
            east_m + range_m * math.sin(bearing_rad), north_m + range_m * math.cos(bearing_rad), 50.0, True
        )
        below_m = ground.heights_at_m(
            circle.east_m + 50.0 * np.sin(around_rad), circle.north_m + 50.0 * np.cos(around_rad)
        )
        target_m = ground.height_m(east_m, north_m)
        if math.isnan(target_m) or np.isnan(below_m).any():
            continue
        places += 1
        clear_m = float((target_m + height_m - below_m).min())
        low += clear_m < CLEARANCE_M
        hit += clear_m < 0.0
        craft_m = (circle.east_m, circle.north_m, target_m + height_m)
        blocked += not ground.sees(craft_m, (east_m, north_m, target_m + 1.0))
        plan = heights.levelled(Plan(circle), target_m + height_m, (east_m, north_m))
        if isinstance(plan, str):
            refused += 1
            continue
        assert plan.heights is not None
        planned_m.append(float((plan.heights.to_m - below_m).min()))
    print(
        f"\n{range_m:.0f} m / {height_m:.0f} m: one height over the target: {low / 40:.1f} % below the clearance, "
        f"{hit / 40:.1f} % hit, {blocked / 40:.1f} % blocked; planned: least {min(planned_m):.1f} m, "
        f"{np.mean(np.array(planned_m) < CLEARANCE_M) * 100:.1f} % below, {refused} refused (void next to)"
    )
    assert min(planned_m) >= CLEARANCE_M


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("filter_name", ["imm", "ekf"])
def test_the_laser_out_for_a_minute(laser_out, filter_name: str) -> None:
    flown = np.array([laser_out.flown(seed, filter_name=filter_name) for seed in range(100)])
    rmse_m, inside = flown.T
    print(
        f"\n{filter_name}: RMSE {np.median(rmse_m):.1f} m median, {np.percentile(rmse_m, 90):.1f} m at 90 %; "
        f"the 95 % ellipse holds {100 * inside.mean():.1f} %"
    )
    assert np.median(rmse_m) <= 15.0
