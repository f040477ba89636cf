"""Two bad links to one vehicle, cut in turn: no yield, and every switch is reported as it is flown."""

from __future__ import annotations

import pytest

from sidelong.mission.core.events import ActivatePlan, PlanStatus, Yield
from sidelong.sitl.settings import LinkFaults

BAD = LinkFaults(loss=0.1, delay_s=0.3)
CUT_S, BETWEEN_S = 2.0, 2.0


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_both_are_bad_and_cut_again_and_again(fly_on_two_links, flavour):
    flight = fly_on_two_links(flavour, faults=BAD)
    assert flight.run(300.0, lambda: flight.has_control)
    for number in range(12):
        flight.cut = number % 2
        flight.run(CUT_S)
        flight.cut = None
        flight.run(BETWEEN_S)
    flight.spoil(LinkFaults())
    flight.run(15.0)
    assert flight.changes >= 6
    assert not flight.found(Yield)
    activated = {one.number for one in flight.found(ActivatePlan)}
    assert activated <= {one.number for one in flight.found(PlanStatus) if one.stage == "departed"}
    assert activated
