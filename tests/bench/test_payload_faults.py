"""Each fault of the payload by itself, begun in flight: python -m pytest tests/bench/test_payload_faults.py -s

Reports how soon the fault is reported, the least true range, and the time that was claimed wrongly. About 5 s of CPU
a flight. SIDELONG_PAYLOAD_FAULTS=COUNT,FIRST: flights per fault, and the first target.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
from concurrent.futures import ProcessPoolExecutor

from tests.bench.size import size
from tests.faults.flight import FLAVOURS, FaultedFlight, Scenario
from tests.faults.flight_campaign import (
    MISLED_RANGE_MIN_M,
    REPORTED_WITHIN_S,
    WRONG_SHARE_MAX,
    Misled,
    clean,
    misled_by,
)
from tests.faults.flight_faults import GIMBAL, LASER, Change, Fault, flagged, other_device, repeated, scaled

DURATION_S = 240.0
_NORTH, _WEST = [1.0, 0.0, 0.0, 0.0], [math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)]
FAULTS = {  # made again for each flight: some remember what they repeat
    "stuck laser": lambda: repeated(LASER, "current_distance"),
    "stuck laser, 1 cm of noise": lambda: repeated(LASER, "current_distance", 1),
    "flags: vehicle frame": lambda: flagged(44),
    "flags: body frame": lambda: flagged(32),
    "range in a tenth": lambda: scaled(0.1),
    "range in feet": lambda: scaled(0.3048),
    "frozen gimbal": lambda: repeated(GIMBAL, "q"),
    "second gimbal, to the north": lambda: other_device(GIMBAL, q=_NORTH),
    "second gimbal, to the west": lambda: other_device(GIMBAL, q=_WEST),
}


def _flight(order: tuple[str, int]) -> tuple[str, int, Misled, float]:
    name, seed = order
    scenario = Scenario(seed, list(FLAVOURS)[seed % 2], DURATION_S)
    change: Change = FAULTS[name]()
    fault = Fault(name, 60.0 + 7.0 * (seed % 5), math.inf, change)
    flown = FaultedFlight(scenario, [fault]).fly()
    misled = misled_by(flown, clean(scenario), fault, alone=True)
    return name, seed, misled, min(clean(scenario).range_m)


def test_each_fault_of_the_payload_is_reported_and_not_followed():
    count, first = map(int, os.environ.get("SIDELONG_PAYLOAD_FAULTS", f"{size(30, 1)},0").split(","))
    orders = [(name, seed) for seed in range(first, first + count) for name in FAULTS]
    with ProcessPoolExecutor(os.cpu_count() or 2, mp_context=multiprocessing.get_context("spawn")) as pool:
        flown = list(pool.map(_flight, orders, chunksize=len(FAULTS)))
    print(f"\n{'fault':28}{'flights':>8}{'reported, s: median':>21}{'worst':>7}{'least range, m':>16}", end="")
    print(f"{'wrongly in band, %':>20}{'on side':>9}")
    for name in FAULTS:
        misled = [one for other, _, one, _ in flown if other == name]
        reported_s = [one.reported_s for one in misled]
        print(
            f"{name:28}{len(misled):8}{statistics.median(reported_s):21.1f}{max(reported_s):7.1f}"
            f"{min(one.nearest_m for one in misled):16.0f}{100.0 * max(one.in_band_share for one in misled):20.1f}"
            f"{100.0 * max(one.on_side_share for one in misled):9.1f}"
        )
    missed = [
        f"{name}, target {seed}: {one} (without the fault {clean_m:.0f} m)"
        for name, seed, one, clean_m in flown
        if one.reported_s > REPORTED_WITHIN_S
        or one.nearest_m < MISLED_RANGE_MIN_M
        or max(one.in_band_share, one.on_side_share) > WRONG_SHARE_MAX
    ]
    print("\n".join(missed))
    assert not missed
