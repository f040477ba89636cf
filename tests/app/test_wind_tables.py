"""Value tables for the wind that blows: made next to the loop, taken up in a step, replayed."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from sidelong.app.analysis.replay import JournalReplay
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.changes import WindTables
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import RunFolder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Phase
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    ControlAcquired,
    DecisionRecord,
    MissionChange,
    WindPrepared,
    WindReported,
)
from sidelong.mission.core.requirement import Wind
from tests.app.conftest import recorded
from tests.turns import loop_turn

PLANE, HOME_DEG = LocalPlane(47.4, 8.5), (47.4, 8.5)


pytestmark = pytest.mark.usefixtures("small_tables")


class Windy:
    """A flight at 15 m/s that is shown winds; what it passes on is in ``put``."""

    def __init__(self, ready_m_s=()):
        self.controller = prepared(Config()).controller()
        self.controller.step(ControlAcquired(1.0, Circle(0.0, 0.0, 50.0, True), "AUTO"))
        self.put: list[WindPrepared] = []
        self.noted: list[str] = []
        kind = planner_by_name("predictive")
        self.tables = WindTables(kind, self.controller, list(ready_m_s), self.put.append, self.noted.append)

    def shown(self, wind_m_s, seconds, phase=Phase.WATCHING):
        async def flown():
            snapshot = replace(self.controller.snapshot(), phase=phase)
            for second in range(seconds):
                wind = Wind(wind_m_s, 0.0)
                self.tables.show(replace(snapshot, time_s=float(second), wind=wind))
            while self.tables._making.is_running:
                await loop_turn()

        asyncio.run(flown())
        return [prepared.speed_m_s for prepared in self.put]


@pytest.mark.parametrize(
    ("wind_m_s", "seconds", "ready_m_s", "prepared_m_s"),
    [
        (0.4, 100, (), []),  # the table for still air serves
        (4.1, 25, (), []),  # not for long enough
        (4.1, 100, (), [3.75]),
        (4.1, 100, (4.0,), []),
    ],
)
def test_a_wind_that_lasts_and_that_no_table_is_near_to_is_prepared_for(wind_m_s, seconds, ready_m_s, prepared_m_s):
    windy = Windy(ready_m_s)
    assert windy.shown(wind_m_s, seconds) == prepared_m_s
    assert windy.noted == []
    assert windy.shown(wind_m_s, seconds) == prepared_m_s  # once


def test_nothing_is_prepared_before_the_target_is_watched():
    assert Windy().shown(4.0, 100, Phase.WAITING) == []


def test_no_more_winds_are_prepared_for_than_in_a_flight():
    controller, prepared = Windy().controller, []
    controller.planning.planner.prepare = prepared.append
    winds_m_s = [0.5 + 0.75 * k for k in range(8)]
    for wind_m_s in (1e9, math.nan, -3.0, *winds_m_s):
        controller.step(WindPrepared(2.0, wind_m_s))
    assert prepared == winds_m_s[:5]


def test_the_planner_goes_on_with_what_it_remembers():
    controller = Windy().controller
    before = controller.planning.planner
    (announcement,) = controller.step(WindPrepared(2.0, 3.75))
    assert announcement == Announce(2.0, "decision", "ready for a wind of 3.75 m/s")
    assert controller.planning.planner is before
    calm, windy = before.questions
    assert windy.context.motions.wind_speed_m_s == 3.75
    assert windy.context.watcher.memory is calm.context.watcher.memory
    assert controller.step(WindPrepared(3.0, 3.75)) == ()
    controller.step(MissionChange(4.0, radius_m=70.0))
    assert controller.planning.planner is not before
    assert [one.context.motions.wind_speed_m_s for one in controller.planning.planner.questions] == [0.0, 3.75]


def test_a_flight_that_became_windy_is_replayed_to_the_last_bit(tmp_path):
    config = Config()
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 22, tzinfo=UTC))
    extra = {100.0: WindReported(100.0, 3.0, 2.0), 150.0: WindPrepared(150.0, 3.75)}
    announced = recorded(folder, config, 200.0, extra)

    replay = JournalReplay(prepared(config).controller())
    for _ in replay.run(JournalReader(folder.journal, JOURNAL_TYPES)):
        pass
    assert replay.difference is None
    assert replay.compared > 10

    # Without the event, what it decides afterwards is otherwise: the table is in use.
    deaf = JournalReplay(prepared(config).controller())
    records = [one for one in JournalReader(folder.journal, JOURNAL_TYPES) if not isinstance(one, WindPrepared)]
    for _ in deaf.run(records):
        pass
    assert deaf.difference is not None
    assert max(command.time_s for command in announced if isinstance(command, DecisionRecord)) > 150.0
