"""The library as its document shows it: its very lines are run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import sidelong
from sidelong import AircraftState, Circle, Decision, Plan, Planner, Sighting, Track, TrackerSettings, Wind

LIBRARY = Path(__file__).resolve().parents[2] / "docs" / "examples.md"


def test_what_is_public_is_there():
    assert all(getattr(sidelong, name).__name__ == name for name in sidelong.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'Unknown'"):
        _ = sidelong.Unknown


def test_the_lines_of_the_readme_run(capsys):
    world: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", LIBRARY.read_text(encoding="utf-8"), re.DOTALL):
        exec(block, world)  # that they run is what is tested
    announced, reason = capsys.readouterr().out.strip().splitlines()
    assert re.fullmatch(r"[12]\.\d m/s at 1[12]\d m north", announced)
    assert reason.startswith(("moving", "staying"))


class Circling:
    """A planner of one's own in a few lines: it moves 50 m north when the target is far."""

    def decide(self, aircraft, target, present, wind, latency_s):
        circle = present.circle
        if target.north_m < circle.north_m + 100.0:
            return Decision(aircraft.time_s, None, "near enough")
        moved = Circle(circle.east_m, circle.north_m + 50.0, circle.radius_m, circle.clockwise)
        return Decision(aircraft.time_s, Plan(moved, None, aircraft.time_s + latency_s), "following north")


def test_a_planner_of_ones_own_takes_part():
    planner: Planner = Circling()
    track = Track(TrackerSettings())
    track.add(Sighting(0.0, 300.0, 0.0, 0.0, 0.8, 0.006, 0.006, 0.0, 0.0))
    state = AircraftState(0.0, 0.0, 0.0, 0.0, 15.0, 0.02)
    decision = planner.decide(state, track.estimate(0.0), Plan(Circle(0.0, 0.0, 50.0, True)), Wind(), 0.5)
    assert decision.plan is not None
    assert decision.plan.circle.north_m == 50.0
