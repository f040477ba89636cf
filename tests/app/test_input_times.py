"""The time in which inputs failed is in summary and displays, and counts as unknown."""

from __future__ import annotations

import math

import pytest

from sidelong.app.analysis.summary import InputTimes, SummaryCollector, summarise
from sidelong.app.config import Config
from sidelong.mission.core.inputs import Input, InputReport, InputState
from tests.faults.flight import FaultedFlight, Scenario
from tests.faults.flight_faults import Fault, silent

BEGIN_S, DURATION_S = 40.0, 80.0


class Summarised(FaultedFlight):
    """A flight that is summarised as a live one is."""

    def __init__(self, faults=()) -> None:
        self.collector = SummaryCollector(Config().requirement.requirement())
        super().__init__(Scenario(1, "px4", DURATION_S), faults)

    def put(self, event):
        outputs = super().put(event)
        self.collector.observe(self.controller.snapshot())
        return outputs

    def summary(self):
        self.fly()
        end = self.controller.snapshot()
        start_s = end.time_s + end.position_age_s - DURATION_S
        tracker = self.controller.tracker
        return summarise(
            self.collector, end, truth=None, plane=None, start_s=start_s, tracker=tracker, outcome="completed"
        )


def test_position_that_is_silent_until_the_end_is_unknown_time():
    flight = Summarised([Fault("silent", BEGIN_S, math.inf, silent(("GLOBAL_POSITION_INT",)))])
    summary = flight.summary()
    assert summary.time_unknown > 0.3
    names, texts = (list(column.cells) for column in summary.table().columns)
    assert names[0] == "attention"
    assert texts[0].endswith("of the time is unknown: inputs were missing or contradictory")
    (position,) = [one for one in summary.inputs if one.input is Input.POSITION]
    assert position.state is InputState.STALE
    assert position.seconds == pytest.approx(DURATION_S - BEGIN_S - 3.0, abs=2.0)
    assert texts[names.index("input position")] == f"stale for {position.seconds:.0f} s"
    (shown,) = [one for one in flight.controller.snapshot().impaired_inputs if one.startswith("position")]
    assert shown == f"position stale for {position.seconds:.0f} s"


def test_summary_of_a_sound_flight_begins_with_its_outcome():
    summary = Summarised().summary()
    assert summary.inputs == ()
    assert summary.time_unknown < 0.05
    assert next(iter(summary.table().columns[0].cells)) == "outcome"


def test_times_in_a_state_are_summed_from_the_start_on():
    times = InputTimes()
    for since_s, state in ((0.0, "ok"), (10.0, "stale"), (30.0, "ok"), (50.0, "stale"), (55.0, "inconsistent")):
        times.note((InputReport(Input.LASER, InputState(state), since_s, 10.0, ""),))
    found = {one.state: (one.seconds, one.times) for one in times.between(20.0, 100.0)}
    assert found == {InputState.STALE: (15.0, 2), InputState.INCONSISTENT: (45.0, 1)}
