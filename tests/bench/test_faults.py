"""A million damaged files over every reader: python -m pytest tests/bench/test_faults.py -s

Takes about twenty minutes of each of two cores. SIDELONG_FAULTS=COUNT,SEED: another number of them, other ones.
"""

from __future__ import annotations

import os
import time

import pytest

from tests.bench.size import size
from tests.faults.campaign import CPU_MAX_S, MEMORY_MAX_BYTES, run
from tests.faults.test_readers import NAMES


@pytest.mark.timeout(4 * 3600)
def test_a_million_damaged_files():
    inputs, campaign = map(int, os.environ.get("SIDELONG_FAULTS", f"{size(1_000_000, 20)},1").split(","))
    begun_s = time.monotonic()
    announced = 0

    def announce(share: float, wrong: int) -> None:
        nonlocal announced
        if int(50 * share) > announced:
            announced = int(50 * share)
            print(f"{share * inputs:.0f} inputs, {wrong} wrong", flush=True)

    counts = run(-(-inputs // len(NAMES)), campaign, processes=os.cpu_count() or 2, progress=announce)
    print(f"\n{'reader':18}{'inputs':>9}{'wrong':>7}{'slowest, s of CPU':>19}")
    for count in counts:
        print(f"{count.reader:18}{count.inputs:9}{count.wrong:7}{count.slowest_s:19.2f}")
        for seed, wrong in count.faults:
            print(f"    {seed}: {wrong}")
    total = sum(count.inputs for count in counts)
    print(f"{total} inputs in {time.monotonic() - begun_s:.0f} s, each within {CPU_MAX_S:g} s", end=" ")
    print(f"and {MEMORY_MAX_BYTES >> 20} MiB")
    assert not [count.reader for count in counts if count.wrong]
