"""A replay reports another decision from another last digit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sidelong.app.analysis.replay import JournalReplay, last_digits
from sidelong.app.records.journal import encode
from sidelong.mission.control.present import Phase
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, DecisionRecord, OperatorRequest, UploadPlan, Yield
from sidelong.mission.exchange.reports import ShutdownRequested
from sidelong.sitl.arduplane import ArduPlaneMode

_DECIDED = DecisionRecord, UploadPlan, ActivatePlan, Yield


def verified(flight, change):
    """Replay a flight's records with each output changed."""
    core = flight.make_core(type(flight.planner)(flight.seed))
    replay = JournalReplay(core.controller, core)
    records = []
    for event, outputs in zip(flight.events, flight.outputs, strict=True):
        records += [event, *map(change, outputs)]
    for _ in replay.run(records):
        pass
    return replay


def otherwise(share):
    def change(output):
        if not isinstance(output, UploadPlan):
            return output
        circle = output.commanded
        return replace(output, commanded=replace(circle, radius_m=circle.radius_m * (1.0 + share)))

    return change


def test_a_last_digit_is_no_other_decision(in_the_air):
    flight = in_the_air("arduplane")
    flight.run(40.0)
    exact, rounded, other = (verified(flight, otherwise(share)) for share in (0.0, 1e-8, 1e-4))
    assert (exact.difference, exact.rounded) == (None, 0)
    assert (rounded.difference, rounded.rounded) == (None, len(flight.found(UploadPlan)))
    assert 0 < rounded.greatest_rounding < 1.1e-8
    assert other.difference is not None
    moved = verified(
        flight, lambda one: replace(one, moves=not one.moves) if isinstance(one, DecisionRecord) else one
    )
    assert moved.difference is not None


def test_the_recorded_results_of_the_exchange_lead_to_the_same_decisions(in_the_air):
    flight = in_the_air("arduplane")
    flight.run(40.0)
    flight.autopilot.set_mode(ArduPlaneMode.FBWA)
    assert flight.run(3.0, lambda: flight.core.controller.phase is Phase.YIELDED)
    flight.put(OperatorRequest(flight.telemetry.now_s, "resume"))
    flight.take_over(flight.core.controller.snapshot().mode)
    resumed_s = flight.telemetry.now_s
    assert flight.run(60.0, lambda: flight.found(DecisionRecord)[-1].time_s > resumed_s)
    flight.put(ShutdownRequested(flight.telemetry.now_s, flight.link_s))
    flight.run(5.0)
    records = []
    for event, outputs in zip(flight.events, flight.outputs, strict=True):
        records += [event, *outputs]
    again = flight.make_core(type(flight.planner)(flight.seed)).controller
    steps = JournalReplay(again, compares=False).run(records)
    decided = [one for step in steps for one in step.commands if isinstance(one, _DECIDED)]
    assert list(map(encode, decided)) == list(map(encode, flight.found(_DECIDED)))
    flown, replayed = flight.core.controller.snapshot(), again.snapshot()
    assert (replayed.time_s, replayed.phase, replayed.moves) == (flown.time_s, Phase.WATCHING, flown.moves)
    assert encode(replayed.estimate) == encode(flown.estimate)
    assert encode(replayed.plan) == encode(flown.plan)


@pytest.mark.parametrize(
    ("changed", "difference"),
    [
        ({"values": {"cost": 4.0 + 4e-8, "side": 0.0}}, pytest.approx(1e-8)),
        ({"values": {"cost": float("nan"), "side": 0.0}}, float("inf")),
        ({"values": {"cost": 4.0, "side": 1e-12}}, pytest.approx(1e-9)),
        ({"reason": "another"}, float("inf")),
        ({"moves": False}, float("inf")),
    ],
)
def test_only_numbers_may_differ(changed, difference):
    decided = DecisionRecord(1.0, True, "farther", {"cost": 4.0, "side": 0.0})
    assert last_digits(decided, replace(decided, **changed)) == difference
    assert last_digits(decided, decided) == 0.0
    assert last_digits(decided, Circle(0.0, 0.0, 1.0, True)) == float("inf")
