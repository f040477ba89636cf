"""The exchange against each simulated autopilot, with whatever link, clock and neighbours may do in between.

Held at every step: what the aircraft flies is a line of ours, whole, that was uploaded and activated (or the first);
no item that has been passed is set current; one plan at a time; nothing is sent after a yield; no yield without a
reason, and none missed; a plan is called flown by the end, if it is flown.
"""

from __future__ import annotations

import os

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from sidelong.app.records.journal import encode
from sidelong.mission.core.events import ActivatePlan, ControlAcquired, End, PlanStatus, UploadPlan, Yield
from sidelong.mission.exchange.mission_items import Activation
from sidelong.mission.exchange.outbox import Outbox, SendMessage
from sidelong.mission.upload.items import MissionLayout
from sidelong.mission.upload.mission_item import same_item
from sidelong.sitl.settings import LinkFaults

EXAMPLES, STEPS = int(os.environ.get("EXAMPLES", "12")), int(os.environ.get("STEPS", "6"))
MISSION_MODES = {"arduplane": 10, "px4": 0x04040000}
CLEAN = LinkFaults()
LINKS = (
    CLEAN,
    LinkFaults(loss=0.05, duplicate=0.05, delay_s=0.1),
    LinkFaults(loss=0.2, delay_s=0.02),
    LinkFaults(loss=0.05, duplicate=0.2, delay_s=1.0),
    LinkFaults(loss=0.02, duplicate=0.02, delay_s=0.03, jitter_s=0.15),
)
NOTICED_S = 20.0  # of the vehicle's time, on a link that is clean again


class Rules:
    """Watches one flight; an AssertionError reports which rule it broke."""

    def __init__(self, flight, raw_items) -> None:
        self.flight, self._raw_items = flight, raw_items
        self.disturbed = False  # another station is at work
        self.yielded = self.ended = False
        self._uploaded = self._settled = 0
        self._ready: set[int] = set()
        self._activated: set[int] = set()
        self._first: list = []
        flight.output_listeners.append(self._output)
        flight.observers.append(self._flown)
        flight.arrived = self._arrived

    def _output(self, output) -> None:
        acquired = self.flight.has_control
        match output:
            case SendMessage():
                assert not self.yielded, f"sent after a yield: {output}"
            case UploadPlan():
                assert acquired
                assert self._settled == self._uploaded, "two plans under way"
                self._uploaded = output.number
            case PlanStatus(stage="ready"):
                self._ready.add(output.number)
                self._settled = output.number  # it may be dropped, and another one follow
            case ActivatePlan():
                assert output.number == self._uploaded
                assert output.number in self._ready
                self._activated.add(output.number)
                self._settled = 0
            case PlanStatus(stage="departed"):
                assert output.number in self._activated
                self._settled = self._uploaded
            case PlanStatus(stage="failed"):
                self._settled = self._uploaded
            case Yield():
                assert self.disturbed, f"a yield to ourselves: {output.reason}"
                assert not self.yielded, "a second yield"
                self.yielded = True
            case End():
                self.ended = True
            case ControlAcquired():
                self._first = self._raw_items(self.flight.flown_line())

    def _flown(self) -> None:
        if self.disturbed or not self._first:
            return
        line = self.flight.flown_line()
        assert line is not None, "the vehicle has left its mission"
        flown = self._raw_items(line)
        ours = [self._first, *(self.flight.lines[number] for number in sorted(self._activated, reverse=True))]
        whole = any(
            len(flown) <= len(one) and all(map(same_item, one[len(one) - len(flown) :], flown)) for one in ours
        )
        assert whole, f"it flies what is no line of ours: {flown}"

    def _arrived(self, name, fields) -> None:
        if name != "MISSION_SET_CURRENT" or self.disturbed or not self._first:
            return
        mission, newest = self.flight.autopilot.mission, self.flight.lines[max(self._activated)]
        line = self._raw_items(mission.items())[fields["seq"] :][: len(newest)]
        same_line = any(same_item(newest[-1], item) for item in line)
        passed = self.flight.flown_line() is not None and fields["seq"] < mission.index < fields["seq"] + len(newest)
        on_it = passed and same_item(newest[-1], self._raw_items(self.flight.flown_line())[-1])
        assert not (same_line and on_it), f"item {fields['seq']} was set current again, {mission.index} is flown"

    @property
    def undecided(self) -> bool:
        """Whether a plan is being uploaded or activated."""
        return self._settled != self._uploaded

    def reported_as_flown(self) -> bool:
        """Return whether the plan that the picture shows ends in the circle that is flown."""
        present = self.flight.core.controller.present
        flown = self.flight.flown_line()[-1]
        east_m, north_m = self.flight.telemetry.plane.east_north_m(flown.latitude_deg, flown.longitude_deg)
        return abs(present.circle.east_m - east_m) < 1.0 and abs(present.circle.north_m - north_m) < 1.0


class Exchange(RuleBasedStateMachine):
    """One flight. Set ``begin`` and ``raw_items`` before it runs."""

    begin = raw_items = None

    @initialize(flavour=st.sampled_from(sorted(MISSION_MODES)), seed=st.integers(1, 99), link=st.sampled_from(LINKS))
    def take_off(self, flavour, seed, link):
        self.flavour, self.flight = flavour, type(self).begin(flavour, seed=seed)
        self.rules = Rules(self.flight, type(self).raw_items)
        self.rules._first = type(self).raw_items(self.flight.flown_line())
        self.flight.spoil(link)

    @rule(seconds=st.sampled_from((2.0, 5.0, 9.0)))
    def fly(self, seconds):
        self.flight.run(seconds)

    @rule(link=st.sampled_from(LINKS), late_s=st.sampled_from((0.0, 1.0)))
    def change_the_link(self, link, late_s):
        self.flight.spoil(link, late_s)
        self.flight.run(3.0)

    @rule(seconds=st.sampled_from((1.0, 4.0)))
    def cut_the_link(self, seconds):
        before = self.flight.faults
        self.flight.spoil(LinkFaults(loss=1.0))
        self.flight.run(seconds)
        self.flight.spoil(before)

    @precondition(lambda self: not self.rules.disturbed)
    @rule(what=st.sampled_from(("mode", "item", "mission", "contents", "reboot")))
    def another_hand(self, what):
        flight, mission = self.flight, self.flight.autopilot.mission
        items = list(mission.items())
        self.rules.disturbed = True
        if what == "mode":
            flight.simulation.pilot_takes_over()
        elif what == "reboot":
            flight.simulation.reboot()
        elif what == "item":
            # An item of no line that is flown or under way: they lie at both ends of the list of ArduPlane.
            known = flight.core._backend
            lines = [known.layout, known._left, known._change.layout if known._change else None]
            free = [
                seq
                for seq, item in enumerate(items)
                if item.command == 17 and not any(line is not None and seq in line for line in lines)
            ]
            if not free:
                self.rules.disturbed = False
                return
            flight.autopilot.set_current_item(free[-1])
        else:
            put = [items[0], *items[2:]] if what == "mission" else items
            if what == "contents":
                put[mission.index] = put[-1] if self.flavour == "arduplane" else put[max(mission.index - 1, 0)]
                if put[mission.index] == items[mission.index]:
                    self.rules.disturbed = False
                    return
            mission.begin(len(put))
            for seq, item in enumerate(put):
                mission.put(seq, item, current=seq == 1)
            mission.finish()
        flight.spoil(CLEAN)
        noticed = flight.run(NOTICED_S, lambda: self.rules.yielded)
        assert noticed, f"a missed yield: {what}"

    def teardown(self):
        flight = getattr(self, "flight", None)
        if flight is None:
            return
        flight.spoil(CLEAN)
        flight.run(12.0)
        if not self.rules.disturbed:
            as_flown = self.rules.undecided or self.rules.reported_as_flown()
            assert as_flown, "the picture shows a plan that is not flown"
        again = flight.make_core(type(flight.planner)(flight.seed))
        for event, outputs in zip(flight.events, flight.outputs, strict=True):
            assert [encode(one) for one in again.step(event)] == [encode(one) for one in outputs], event


def test_the_rules_hold_whatever_happens(in_the_air, raw_items):
    Exchange.begin, Exchange.raw_items = staticmethod(in_the_air), staticmethod(raw_items)
    bounds = settings(
        max_examples=EXAMPLES, stateful_step_count=STEPS, deadline=None, derandomize=True, database=None
    )
    run_state_machine_as_test(Exchange, settings=bounds)


def test_a_switch_that_is_asked_for_again_leads_back_to_nothing_that_was_passed(in_the_air, raw_items):
    flight = in_the_air("arduplane", faults=LinkFaults(delay_s=0.5))
    Rules(flight, raw_items)._first = raw_items(flight.flown_line())
    flight.lost = {"MISSION_CURRENT"}
    flight.run(90.0)
    asked = [one for one in flight.found(SendMessage) if one.name == "MISSION_SET_CURRENT"]
    assert len(asked) > len(flight.found(ActivatePlan)) >= 3


def test_a_switch_is_never_asked_for_at_an_earlier_item_than_before():
    outbox, layout = Outbox(), MissionLayout((), 1, 7, 12)
    activation = Activation(outbox, None, layout, layout, 0.1, None, read_in_order=False)
    for link_s, first_ahead in ((0.0, 9), (10.0, 8), (20.0, 10)):
        outbox.begin(link_s, link_s)
        activation.expire(first_ahead)
    assert [one.fields["seq"] for one in outbox.sent] == [9, 9, 10]
