from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from sidelong.app.payload.driver import AnglesMeasured, DriverSettings, RangeMeasured
from sidelong.app.payload.registry import kind_by_name
from sidelong.sitl.payload.devices import DEVICES
from tests.payload.damage import damaged_stream, unfounded


@pytest.mark.parametrize("kind", DEVICES)
def test_each_reading_is_that_of_an_intact_frame(kind):
    data = damaged_stream(kind, 20_000, seed=3)
    driver = kind_by_name(kind).make(DriverSettings())
    measured = [one for at in range(0, len(data), 7) for one in driver.receive(data[at : at + 7], at * 1e-4)]
    assert {type(one) for one in measured} == {RangeMeasured, AnglesMeasured}
    assert unfounded(kind, data, measured) == []


@pytest.mark.parametrize("kind", DEVICES)
@settings(deadline=None)  # a busy machine is slow
@given(data=some.binary(max_size=300))
def test_no_bytes_raise_and_the_driver_reads_on(kind, data):
    driver = kind_by_name(kind).make(DriverSettings())
    driver.receive(data, 0.0)
    intact = damaged_stream(kind, 3000, seed=5)
    assert driver.receive(intact, 1.0)


@pytest.mark.parametrize("kind", DEVICES)
def test_bytes_give_the_same_readings_however_they_are_cut(kind):
    data = damaged_stream(kind, 5_000, seed=4)
    whole = kind_by_name(kind).make(DriverSettings()).receive(data, 1.0)
    driver = kind_by_name(kind).make(DriverSettings())
    assert [one for at in range(len(data)) for one in driver.receive(data[at : at + 1], 1.0)] == whole
