from __future__ import annotations

import math

import pytest

from sidelong.app.payload.driver import AircraftPose, DriverSettings
from sidelong.sitl.settings import Quirks
from tests.payload.wiring import Wired, looking

_SLANT_M, _HEIGHT_M = 300.0, 100.0
_DOWN_DEG = math.degrees(math.asin(_HEIGHT_M / _SLANT_M))


def flown(quirks: Quirks, height_m: float = _HEIGHT_M, **settings) -> Wired:
    """Return a connection over which some seconds of flight were measured."""
    wired = Wired("siyi", quirks, DriverSettings(**settings))
    wired.session.aircraft(AircraftPose(0.4, 0.0, 1.0, 47.4, 8.5, 500.0, height_m, 15.0, 0.0, 0.0), 0.0)
    wired.run(6.0, looking(_SLANT_M, bearing_deg=-80.0, elevation_deg=-_DOWN_DEG))
    return wired


def test_right_settings_agree_with_the_height():
    wired = flown(Quirks())
    status = wired.session.status(wired.now_s)
    assert status.height_ratio == pytest.approx(1.0, abs=0.01)
    assert status.missing == ()


@pytest.mark.parametrize(
    ("quirks", "settings", "advice"),
    [
        (Quirks(range_unit_m=1.0), {}, "payload.range_unit_m to 10 times"),
        (Quirks(), {"range_unit_m": 1.0}, "payload.range_unit_m to 0.1 times"),
        (Quirks(), {"flip_pitch": True}, "payload.flip_pitch"),
    ],
)
def test_wrong_unit_or_sign_is_reported_with_the_setting_to_change(quirks, settings, advice):
    wired = flown(quirks, **settings)
    assert sum(advice in text for _, text in wired.reports) == 1
    assert any(advice in what for what in wired.session.status(wired.now_s).missing)


def test_nothing_is_compared_on_the_ground():
    wired = flown(Quirks(range_unit_m=1.0), height_m=2.0)
    assert wired.session.status(wired.now_s).height_ratio is None
    assert not [text for _, text in wired.reports if "range_unit_m" in text]
