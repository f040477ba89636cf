"""A thousand flights with faults, of both autopilots: python -m pytest tests/bench/test_flight_faults.py -s

Takes about a quarter of an hour on two idle cores. SIDELONG_FLIGHTS=COUNT,SEED: another number of them, other ones;
the first is of ArduPlane, the second of PX4, and so on.
"""

from __future__ import annotations

import os
import statistics

from tests.bench.size import size
from tests.faults.flight_campaign import STEP_MAX_S, campaign, table

LOST_ON_SIDE_MAX = 2.0  # points, on average
_FLIGHTS = 1000
_NAMED = {"gps jump", "payload clock"}


def test_a_thousand_flights():
    flights, first_seed = map(int, os.environ.get("SIDELONG_FLIGHTS", f"{size(_FLIGHTS, 2)},1000").split(","))
    verdicts = list(campaign(flights, first_seed, os.cpu_count() or 2))
    print()
    print(table(verdicts))
    assert not [(verdict.flavour, verdict.seed) for verdict in verdicts if verdict.broken]
    named = [verdict.lost_on_side for verdict in verdicts if verdict.names and set(verdict.names) <= _NAMED]
    if named or flights >= _FLIGHTS:  # a few flights may draw none
        print(f"{len(named)} flights with {' or '.join(sorted(_NAMED))} alone or both:", end=" ")
        print(f"{statistics.mean(named):.2f} points less on side")
        assert statistics.mean(named) <= LOST_ON_SIDE_MAX
    assert max(verdict.slowest_step_s for verdict in verdicts) <= STEP_MAX_S
