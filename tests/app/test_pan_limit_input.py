"""The pan limits that a gimbal reports: adopted by the plan once, prepared in parallel, journalled, replayed."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from sidelong.app.analysis.replay import JournalReplay
from sidelong.app.analysis.summary import SummaryCollector
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.changes import PanLimitInput
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.payload.session import usable_pan_limit_deg
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import RunFolder
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import Announce, MissionChange, RouteGiven
from tests.app.conftest import recorded

CONTRADICTED = "aircraft.pan_limit_deg = 180, but the gimbal pans 120 degrees only; remove it to plan for that"
PREPARING = "the gimbal pans 120 degrees to each side: a plan for that is being prepared"


pytestmark = pytest.mark.usefixtures("small_tables")


@pytest.mark.parametrize(
    ("limits_deg", "usable_deg"),
    [
        (None, None),
        ((-120.0, 120.0), 120.0),
        ((-135.0, 200.0), 135.0),
        ((-180.0, 180.0), None),
        ((-320.0, 320.0), None),
        ((-60.0, 60.0), None),
    ],
)
def test_the_nearer_limit_is_planned_for_where_figures_of_eight_can_keep_it(limits_deg, usable_deg):
    limits_rad = None if limits_deg is None else tuple(map(math.radians, limits_deg))
    assert usable_pan_limit_deg(limits_rad) == usable_deg


class Changes:
    """What prepares changes, without preparing them."""

    is_busy = False

    def __init__(self):
        self.taken = []

    def take(self, change):
        self.taken.append(change)


@pytest.mark.parametrize(
    ("configured_deg", "taken", "noted"),
    [
        (None, [MissionChange(5.0, who="gimbal", pan_limit_deg=120.0)], [PREPARING]),
        (120.0, [], []),
        (180.0, [], [CONTRADICTED]),
    ],
)
def test_limits_are_adopted_once_the_target_is_watched(snapshot, configured_deg, taken, noted):
    changes, notes, limits = Changes(), [], [None]
    adopting = PanLimitInput(configured_deg, lambda: limits[0], changes, notes.append)
    watching = replace(snapshot, time_s=5.0, phase=Phase.WATCHING)
    adopting.show(watching)  # nothing is reported yet
    limits[0] = (-2.0944, 2.0944)
    adopting.show(replace(watching, phase=Phase.WAITING))
    changes.is_busy = True
    adopting.show(watching)
    assert (changes.taken, notes) == ([], [])
    changes.is_busy = False
    for _ in range(2):
        adopting.show(watching)
    assert (changes.taken, notes) == (taken, noted)
    # A pilot took over before the change was ready: it was refused. After it is adopted, nothing is repeated.
    adopting.show(replace(watching, phase=Phase.YIELDED))
    for _ in range(2):
        adopting.show(watching)
    assert (changes.taken, notes) == (2 * taken, 2 * noted)
    limited = replace(watching, airframe=replace(watching.airframe, pan_limit_rad=2.0944))
    for phase in (Phase.YIELDED, Phase.WATCHING):
        adopting.show(replace(limited, phase=phase))
    assert (changes.taken, notes) == (2 * taken, 2 * noted)


def test_a_flight_that_has_adopted_them_is_replayed_to_the_last_bit(tmp_path):
    config = Config()
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 22, tzinfo=UTC))
    change = MissionChange(150.0, who="gimbal", pan_limit_deg=120.0)
    route = RouteGiven(140.0, (0.0, 0.0), (0.0, 1000.0), False, 10.0, None, "either")
    announced = recorded(folder, config, 200.0, {140.0: route, 150.0: change})
    texts = [one.text for one in announced if isinstance(one, Announce)]
    assert "gimbal: pan limits of +-120 degrees, from the next plan on" in texts

    replay = JournalReplay(prepared(config).controller())
    collector = SummaryCollector(config.requirement.requirement())
    for step in replay.run(JournalReader(folder.journal, JOURNAL_TYPES)):
        collector.observe(step.snapshot())
    assert replay.difference is None
    assert replay.compared > 10
    assert collector.time_within_pan_limits(0.0) == collector.time_within_pan_limits(150.0) < 1.0
    # The event is what turned the plan to figures of eight.
    deaf = JournalReplay(prepared(config).controller())
    records = [one for one in JournalReader(folder.journal, JOURNAL_TYPES) if not isinstance(one, MissionChange)]
    for _ in deaf.run(records):
        pass
    assert deaf.difference is not None
