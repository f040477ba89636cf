"""Changes by an operator in flight: checked like a configuration, prepared in parallel, journalled, replayed."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from sidelong.app.analysis.replay import JournalReplay
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.changes import MissionChanges
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.planners import value_cache
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import RunFolder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired, MissionChange, UploadPlan
from tests.app.conftest import recorded
from tests.turns import loop_turn

PLANE, HOME_DEG = LocalPlane(47.4, 8.5), (47.4, 8.5)


def changes_of(config):
    """Return the changes of a flight that has begun, what they pass on, and what they say."""
    controller = prepared(config).controller(PLANE, HOME_DEG)
    controller.step(ControlAcquired(1.0, Circle(0.0, 0.0, 50.0, True), "AUTO"))
    put: list[MissionChange] = []
    announced: list[str] = []
    return (
        MissionChanges(
            config, controller, lambda: 7.0, put.append, lambda announcement: announced.append(announcement.text)
        ),
        put,
        announced,
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (MissionChange(0.0, radius_m=12.0), "radius 12 m refused: infeasible: the circle is tighter than"),
        (MissionChange(0.0, range_min_m=600.0), "range_min_m = 600 is not below range_max_m = 500; change one"),
        (MissionChange(0.0, radius_m=5.0), "change: aircraft.radius_m = 5.0: input should be greater"),
        (MissionChange(0.0, side="up"), "'up' is none of left, right, either, or a sector in degrees"),
        (MissionChange(0.0, height_m=150.0), "aircraft.height_m = 150 is above fences.ceiling_m = 120; change one"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_sentence(change, sentence):
    changes, put, announced = changes_of(
        Config.model_validate({"planner": {"name": "paper"}, "fences": {"ceiling_m": 120.0}})
    )
    changes.take(change)
    (text,) = announced
    assert sentence in text
    assert "\n" not in text
    assert put == []


@pytest.mark.usefixtures("small_tables")
def test_the_table_of_another_radius_is_made_by_another_process(monkeypatch):
    changes, put, announced = changes_of(Config())
    turns = 0

    async def changed():
        nonlocal turns
        changes.take(MissionChange(0.0, radius_m=80.0, who="operator"))
        changes.take(MissionChange(0.0, radius_m=90.0))
        changes.take(MissionChange(0.0, height_m=150.0))
        while len(put) < 2:
            turns += 1
            await loop_turn()

    asyncio.run(changed())
    assert announced == ["radius 90 m refused: the change before is still being made ready; ask again"]
    height, change = put  # a height waits for no table
    assert height.height_m == 150.0
    assert (change.radius_m, change.time_s, change.who) == (80.0, 7.0, "operator")
    assert (changes._config.aircraft.radius_m, changes._config.aircraft.height_m) == (80.0, 150.0)
    assert turns > 20  # the loop went on turning in the meantime
    monkeypatch.setattr(value_cache, "compute", lambda *_: pytest.fail("a table was computed within a step"))
    monkeypatch.setattr(value_cache, "stored_table", lambda *_: pytest.fail("a file was read within a step"))
    aircraft = replace(Config().aircraft.aircraft(), radius_m=80.0)
    changes._controller.planning.make_planner(aircraft, Config().requirement.requirement())


def test_a_changed_flight_is_replayed_to_the_last_bit_and_judged_by_what_was_asked_when(tmp_path, config):
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 22, tzinfo=UTC))
    first = MissionChange(150.0, radius_m=70.0, range_min_m=150.0)
    wishes = {150.0: first, 200.0: MissionChange(200.0, height_m=120.0)}
    announced = recorded(folder, config, 200.0, wishes)
    uploads = [command.plan for command in announced if isinstance(command, UploadPlan)]
    assert {plan.circle.radius_m for plan in uploads} == {70.0}
    assert uploads[-1].heights.to_m == 120.0

    journal = JournalReader(folder.journal, JOURNAL_TYPES)
    replay = JournalReplay(prepared(config).controller())
    snapshots = [step.snapshot() for step in replay.run(journal)]
    assert replay.difference is None
    assert replay.compared > 10
    assert snapshots[-1].requirement.range_min_m == 150.0
    lines = [json.loads(line) for line in folder.journal.read_text().splitlines()]
    assert sum(line["event"] == "MissionChange" for line in lines) == 2
