"""Scenes in which the payload follows another object: when it is known, and how near the aircraft comes to either.

    python -m pytest tests/bench/test_another_object.py -s

SCENES is how many are flown, of each kind as many.
"""

from __future__ import annotations

import os

from tests.faults.another_object import KINDS, flown

SCENES = int(os.environ.get("SCENES", "60"))
KNOWN_WITHIN_S, KNOWN_SHARE, LEAST_M = 15.0, 0.9, 80.0


def test_another_object_is_found_out_and_kept_clear():
    seen = [flown(n // len(KINDS), KINDS[n % len(KINDS)], ("arduplane", "px4")[n % 2]) for n in range(SCENES)]
    for kind in KINDS:
        of_kind = [one for one in seen if one.kind == kind]
        known = sum(one.known_s <= KNOWN_WITHIN_S for one in of_kind)
        nearest_m, wrongly_s = min(one.least_m for one in of_kind), sum(one.wrongly_s for one in of_kind)
        in_time = f"{known} of {len(of_kind)} known in time"
        print(f"\n{kind}: {in_time}, {nearest_m:.0f} m at the nearest, wrong {wrongly_s:.0f} s")
    assert sum(one.known_s <= KNOWN_WITHIN_S for one in seen) >= KNOWN_SHARE * len(seen)
    assert min(one.least_m for one in seen if one.known_s <= KNOWN_WITHIN_S) >= LEAST_M
