"""ADS-B and AIS contacts of the vehicle's link as beacons."""

import pytest

from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.sharing.beacon import ContactBeacon
from sidelong.estimators.frames import LocalPlane

PLANE = LocalPlane(47.4, 8.5)
AIRCRAFT = {"ICAO_address": 0x4B1234, "lat": 474_000_000, "lon": 85_000_000, "tslc": 0, "flags": 1}
VESSEL = {"MMSI": 211234560, "lat": 474_000_000, "lon": 85_000_000, "tslc": 0, "flags": 1}


def received(name, messages):
    """Return the readings of (time, message, fields) and what was reported."""
    readings, texts, now_s = [], [], [0.0]
    beacon = ContactBeacon(name, PLANE, lambda: now_s[0], readings.append, texts.append)
    for now_s[0], message, fields in messages:
        beacon.on_message(message, fields)
    return readings, texts


def test_positions_of_the_named_aircraft_are_forwarded_with_their_age():
    other = AIRCRAFT | {"ICAO_address": 1}
    readings, texts = received(
        "adsb:4B1234", [(10.0, "ADSB_VEHICLE", AIRCRAFT), (11.0, "ADSB_VEHICLE", other), (12.0, "AIS_VESSEL", VESSEL)]
    )
    assert [(one.time_s, one.source.message) for one in readings] == [(10.0, "ADSB_VEHICLE")]
    assert len(texts) == 1


def test_a_position_that_is_repeated_with_a_growing_age_counts_once():
    announced = [(10.0 + k, "AIS_VESSEL", VESSEL | {"tslc": k}) for k in range(6)]
    announced += [(16.0, "AIS_VESSEL", VESSEL | {"flags": 0, "lat": 474_000_100})]
    readings, _ = received("ais:211234560", announced)
    assert [one.time_s for one in readings] == [10.0, 16.0]
    assert readings[0].sigma_m < readings[1].sigma_m


def test_positions_that_are_old_or_flagged_invalid_are_left_aside():
    announced = [(10.0, "ADSB_VEHICLE", AIRCRAFT | {"tslc": 9}), (11.0, "ADSB_VEHICLE", AIRCRAFT | {"flags": 2})]
    assert received("adsb:4b1234", announced)[0] == []


@pytest.mark.parametrize("text", ["adsb:xyz", "ais:12", "adsb:4B12345"])
def test_a_contact_that_is_none_is_refused_with_an_example(text):
    with pytest.raises(InputError, match="adsb:4B1234"):
        load_config(None, {"sharing": {"beacon": text}})
    assert load_config(None, {"sharing": {"beacon": "ais:211234560"}}).sharing.beacon == "ais:211234560"
