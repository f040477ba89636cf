"""The payload's clock against the vehicle's, where streams are slow."""

import pytest

from sidelong.estimators.sensing.clock import SourceClock, VehicleClock


@pytest.mark.parametrize(("rate_hz", "within_s"), [(10.0, 3.0), (2.0, 3.0), (0.6, 8.5)])
def test_a_payload_that_restarts_is_corrected_soon_at_any_rate(rate_hz, within_s):
    vehicle, payload = VehicleClock(), SourceClock()
    for tick in range(round(60.0 * rate_hz)):
        now_s = 1000.0 + tick / rate_hz
        vehicle.take(now_s)
        assert payload.corrected_s(now_s, vehicle) == now_s
    corrected_s = None
    for tick in range(round(20.0 * rate_hz)):
        since_s = (tick + 1) / rate_hz
        vehicle.take(1060.0 + since_s)
        time_s = payload.corrected_s(since_s, vehicle)
        if corrected_s is None and time_s is not None:
            corrected_s = since_s
        assert time_s is None or time_s == pytest.approx(1060.0 + since_s, abs=0.01)
    assert corrected_s is not None
    assert corrected_s <= within_s


def test_stamps_at_random_change_no_clock():
    vehicle, payload = VehicleClock(), SourceClock()
    for tick in range(200):
        now_s = 1000.0 + tick * 1.7
        vehicle.take(now_s)
        wrong = tick % 3 == 0
        payload.corrected_s(now_s + (37.0 * (tick % 11) + 100.0 if wrong else 0.0), vehicle)
        assert payload.ahead_s == 0.0
