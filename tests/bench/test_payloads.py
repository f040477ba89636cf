"""Payload drivers: damaged bytes by the million, and flights with each payload next to the same by MAVLink."""

from __future__ import annotations

import numpy as np
import pytest

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.registry import kind_by_name
from sidelong.sitl.payload.devices import DEVICES
from tests.bench.size import size
from tests.faults.flight import FaultedFlight, Scenario
from tests.payload.damage import damaged_stream, intact_frames
from tests.payload.test_flight import DeviceLoop, error_m, shares

BYTES = size(1_000_000, 20_000)
SEEDS = range(1, size(7, 2))
DURATION_S = float(size(1200, 60))


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
    allowed = intact_frames(kind, data)
    ranges = sum(isinstance(one, RangeMeasured) for one in measured)
    angles = sum(isinstance(one, AnglesMeasured) for one in measured)
    print(
        f"\n{kind}: {len(data)} bytes, {allowed} intact frames, {driver.damaged} refused, "
        f"{ranges} ranges, {angles} angles"
    )
    assert 0 < ranges <= allowed
    assert 0 < angles <= allowed


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
        flown[kind] = np.mean(runs, axis=0)
        print("\n{}: side {:.1f} %, band {:.1f} %, error {:.2f} m".format(kind, *flown[kind]), end="")
    for kind in DEVICES:
        assert flown[kind][0] >= flown["mavlink"][0] - 1.0
        assert flown[kind][1] >= flown["mavlink"][1] - 1.0
