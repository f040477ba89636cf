"""A flight interrupted at a hundred random moments: python -m pytest tests/bench/test_interrupts.py -s

Takes about ten minutes. SIDELONG_INTERRUPTS=COUNT,SEED: another number of them, other moments.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.faults.interrupts import Interruption, left_of


@pytest.mark.timeout(2 * 3600)
def test_a_hundred_interrupts(tmp_path):
    count, seed = map(int, os.environ.get("SIDELONG_INTERRUPTS", "100,1").split(","))

    def interrupted(number: int) -> tuple[Interruption, str, list[str]]:
        interruption = Interruption.drawn(f"{seed}/{number}")
        out: Path = tmp_path / str(number)
        return interruption, *left_of(interruption, out)

    with ThreadPoolExecutor(2) as pool:
        ends = list(pool.map(interrupted, range(count)))
    announced: dict[str, int] = {}
    for interruption, sentence, wrong in ends:
        announced[sentence] = announced.get(sentence, 0) + 1
        if wrong:
            print(f"\n{interruption}: {wrong}")
    print()
    for sentence, times in sorted(announced.items(), key=lambda one: -one[1]):
        print(f"{times:4}  {sentence}")
    right = sum(not wrong for _, _, wrong in ends)
    print(f"{right} of {count} ended with the right sentence and code, and whole records")
    assert right == count
