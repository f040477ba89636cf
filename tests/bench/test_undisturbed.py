"""False reports in 200 flights without faults: python -m pytest tests/bench/test_undisturbed.py -s

Over flat ground, over hills and in fleets, by both simulated autopilots; a quarter of an hour on an idle core.
SIDELONG_UNDISTURBED=COUNT,FIRST: another number of flights, other ones.
"""

from __future__ import annotations

import os
from collections import Counter

from tests.bench.size import size
from tests.faults.undisturbed import fly
from tests.terrain.conftest import HOME_DEG, write_hills

WATCHED_S = float(size(240, 60))


def test_no_input_is_reported_in_undisturbed_flights(tmp_path):
    count, first = map(int, os.environ.get("SIDELONG_UNDISTURBED", f"{size(200, 1)},0").split(","))
    write_hills(tmp_path)
    flights, watched_s, supported, false = Counter(), Counter(), Counter(), Counter()
    for number in range(first, first + count):
        flown = fly(number, WATCHED_S, tmp_path, HOME_DEG)
        flights[flown.kind] += 1
        watched_s[flown.kind] += flown.watched_s
        supported[flown.kind] += len(flown.supported)
        false[flown.kind] += len(flown.false)
        for text in flown.false:
            print(f"flight {number} ({flown.kind}): {text}", flush=True)
    print(f"\n{'kind':8}{'flights':>9}{'hours':>8}{'true reports':>14}{'false reports':>15}")
    for kind, flown in sorted(flights.items()):
        print(f"{kind:8}{flown:9}{watched_s[kind] / 3600.0:8.2f}{supported[kind]:14}{false[kind]:15}")
    assert not false.total()
