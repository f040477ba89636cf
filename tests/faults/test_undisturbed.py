"""Nothing is reported of inputs in flights without faults; tests/bench/test_undisturbed.py flies 200 of them."""

from __future__ import annotations

import pytest

from tests.faults.undisturbed import KINDS, fly
from tests.terrain.conftest import HOME_DEG, write_hills


@pytest.mark.parametrize("number", [KINDS.index("flat"), KINDS.index("hills"), KINDS.index("fleet")])
def test_flight_without_faults_reports_no_fault(number, tmp_path):
    write_hills(tmp_path)
    flown = fly(number, 90.0, tmp_path, HOME_DEG)
    assert flown.false == []
    assert flown.watched_s >= 89.0
