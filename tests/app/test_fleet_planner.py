"""Single flights use the planner of one aircraft, fleets its cooperative form, and journals replay with the same."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from sidelong.app.cli import load_command
from sidelong.app.config import Config
from sidelong.app.fleet.fleet_file import TeamPredictive, planner_in_fleet
from sidelong.app.planners.planner_kind import Paper, Predictive
from sidelong.app.records.run_folder import RunFolder
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Side
from tests.app.conftest import recorded, target_at

TOGETHER = Config.model_validate({"requirement": {"fleet_size": 2}})


def advice(until_s: float) -> dict[float, FleetAdvice | NeighbourPlanned]:
    """Another aircraft circles on the opposite side of the target, and follows it."""
    events: dict[float, FleetAdvice | NeighbourPlanned] = {}
    for second in range(101, int(until_s)):
        target = target_at(second)
        circle = Circle(target[0], target[1] - 250.0, 50.0, False)
        state = AircraftState(second, *circle.position_at_course(0.3), 0.3, 15.0, circle.curvature_per_m)
        other = Neighbour("south", state, 160.0, ours=True, target="target", role=Role.OPPOSITE)
        estimate = TargetEstimate(second, *target, 3.0, 0.0, 0.04 * np.eye(4), TrackQuality.GOOD, second)
        events[second + 0.3] = NeighbourPlanned(second + 0.3, "south", Plan(circle), None)
        events[second + 0.5] = FleetAdvice(
            second + 0.5, "target", Role.WANTED, Side.LEFT, estimate, 100.0, (other,), course_rad=np.pi / 2
        )
    return events


def test_journals_of_the_cooperative_planner_replay(tmp_path, capsys):
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 22, tzinfo=UTC))
    recorded(folder, TOGETHER, 100.0, advice(180.0), TeamPredictive())
    assert "better alongside south" in folder.journal.read_text()
    load_command("replay").main([str(folder.path), "--verify"], standalone_mode=False)
    assert "all the same to the last bit" in capsys.readouterr().out


def test_other_planners_fly_in_a_fleet_unchanged():
    assert isinstance(planner_in_fleet(Config.model_validate({"planner": {"name": "paper"}})), Paper)
    assert type(planner_in_fleet(Config())) is Predictive
