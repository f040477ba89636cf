"""Payload drivers: damaged bytes by the million, and flights with each payload next to the same by MAVLink."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.registry import kind_by_name
from sidelong.sitl.payload.devices import DEVICES
from tests.bench.size import size
from tests.faults.flight import FaultedFlight, Scenario
from tests.payload.damage import damaged_stream, unfounded
from tests.payload.test_flight import DeviceLoop, check_unplugged, error_m, shares

BYTES = size(1_000_000, 20_000)
SEEDS = range(1, size(7, 2, "PAYLOAD_FLIGHTS"))
DURATION_S = float(size(1200, 60, "PAYLOAD_FLIGHT_S"))


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", DEVICES)
def test_no_reading_passes_its_checksum_wrongly_in_a_million_damaged_bytes(kind):
    data = damaged_stream(kind, BYTES, seed=1)
    driver = kind_by_name(kind).make(DriverSettings())
    rng, at, measured = np.random.default_rng(2), 0, []
    while at < len(data):
        step = int(rng.integers(1, 60))
        measured += driver.receive(data[at : at + step], at * 1e-4)
        at += step
    kinds = Counter(type(one) for one in measured)
    wrong = unfounded(kind, data, measured)
    print(
        f"\n{kind}: {len(data)} bytes, {driver.damaged} frames refused, {kinds[RangeMeasured]} ranges, "
        f"{kinds[AnglesMeasured]} angles, {len(wrong)} of them of no intact frame"
    )
    assert min(kinds[RangeMeasured], kinds[AnglesMeasured]) > 0
    assert wrong == []


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", DEVICES)
def test_payload_is_unplugged_ten_times_in_flight(kind):
    check_unplugged(kind)


@pytest.mark.timeout(7200)
def test_side_and_band_of_each_payload_are_within_a_point_of_mavlink():
    flown = {}
    for kind in ("mavlink", *DEVICES):
        runs = []
        for seed in SEEDS:
            scenario = Scenario(seed=seed, flavour="px4" if seed % 2 else "arduplane", duration_s=DURATION_S)
            loop = FaultedFlight(scenario) if kind == "mavlink" else DeviceLoop(scenario, kind)
            one = loop.fly()
            runs.append((*shares(one), error_m(one)))
        flown[kind] = np.array(runs)
        gained = flown[kind] - flown["mavlink"]  # target by target
        spread = gained[:, :2].std(axis=0) / math.sqrt(len(runs))
        side, band, rms_m = flown[kind].mean(axis=0)
        print(f"\n{kind}: side {side:.1f} %, band {band:.1f} %, error {rms_m:.2f} m", end="")
        print(
            f" ({gained[:, 0].mean():+.1f} +- {spread[0]:.1f}, {gained[:, 1].mean():+.1f} +- {spread[1]:.1f})", end=""
        )
    for kind in DEVICES:
        side, band, _ = (flown[kind] - flown["mavlink"]).mean(axis=0)
        assert side >= -1.0
        assert band >= -1.0
