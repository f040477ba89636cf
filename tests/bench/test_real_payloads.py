"""Your own SITL programs with each payload's own protocol, each flight next to the same one by MAVLink messages.

    export SIDELONG_PROGRAMS=FOLDER SIDELONG_TARGETS=FOLDER
    RATE=1 AT_ONCE=5 python -m pytest tests/bench/test_real_payloads.py -s

The first of the targets is flown, or TARGET=NAME. AT_ONCE flights are flown at the same time; DURATION, RATE and
GUIDANCE are those of test_real_flights.py. The payloads run by the machine's clock: at RATE=4 their readings are a
quarter as many, and four times as late.
"""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from sidelong.sitl.payload.devices import DEVICES
from tests.autopilot.real_vehicle import FLAVOURS
from tests.bench.test_real_flights import TARGETS, fly

pytestmark = pytest.mark.timeout(14400)

AT_ONCE, GUIDANCE = int(os.environ.get("AT_ONCE", "1")), os.environ.get("GUIDANCE", "mission")
TARGET = [one for one in TARGETS if one.stem == os.environ.get("TARGET", one.stem)][:1]
_APART_S = 15.0  # a program takes its ports some time after it was started
_POINT = 0.01
_starting = threading.Lock()


@pytest.mark.parametrize("target", TARGET, ids=lambda path: path.stem)
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_side_and_band_of_each_payload_are_within_a_point_of_mavlink(flavour, target, tmp_path):
    def flown(kind):
        with _starting:
            time.sleep(_APART_S)
        folder = tmp_path / kind
        folder.mkdir()
        return fly(flavour, GUIDANCE, target, folder, "" if kind == "mavlink" else kind).watched

    kinds = ("mavlink", *DEVICES)
    with ThreadPoolExecutor(AT_ONCE) as flights:
        by_kind = dict(zip(kinds, flights.map(flown, kinds), strict=True))
    print()
    for kind, watched in by_kind.items():
        print(f"{flavour} {target.stem} {kind:9} {watched}")
    mavlink = by_kind.pop("mavlink")
    for kind, watched in by_kind.items():
        assert watched.side >= mavlink.side - _POINT, kind
        assert watched.band >= mavlink.band - _POINT, kind
