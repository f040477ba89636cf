"""A traffic contact as the beacon: ADS-B or AIS positions that the vehicle's own receiver passes on by MAVLink."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import Source, TargetFixReading

_FORM = re.compile(r"(?:adsb:[0-9a-f]{6}|ais:[0-9]{9})", re.IGNORECASE)
_ADSB, _AIS = "ADSB_VEHICLE", "AIS_VESSEL"
_ADSB_COORDINATES_VALID, _AIS_ACCURATE = 1, 1
_ADSB_SIGMA_M, _AIS_SIGMA_M, _AIS_ACCURATE_SIGMA_M = 15.0, 15.0, 5.0
_AGE_MAX_S = 2.0
_REPEATED_S = 0.9  # a report that is no newer than this repeats the last one: ages are whole seconds


def is_contact(text: str) -> bool:
    """Return whether this names a contact, such as adsb:4B1234 or ais:211234560."""
    return _FORM.fullmatch(text) is not None


class ContactBeacon:
    """Forwards the positions of one contact. Each position counts once, however often it is repeated.

    Args:
        name: ``adsb:ICAO`` (six hexadecimal digits) or ``ais:MMSI`` (nine digits).
        announce: called once, when the contact is received first.
    """

    def __init__(
        self,
        name: str,
        plane: LocalPlane,
        now_s: Callable[[], float],
        put: Callable[[TargetFixReading], object],
        announce: Callable[[str], object],
    ) -> None:
        kind, _, number = name.lower().partition(":")
        self._name, self._message = name, _ADSB if kind == "adsb" else _AIS
        self._id = int(number, 16) if kind == "adsb" else int(number)
        self._plane, self._now_s, self._put, self._announce = plane, now_s, put, announce
        self._measured_s = -math.inf

    def on_message(self, name: str, fields: Mapping[str, Any]) -> None:
        if name != self._message or self._now_s() == -math.inf:
            return
        if int(fields["ICAO_address" if self._message == _ADSB else "MMSI"]) != self._id:
            return
        if abs(fields["lat"]) > 900_000_000 or abs(fields["lon"]) > 1_800_000_000:
            return
        if self._message == _ADSB and not int(fields["flags"]) & _ADSB_COORDINATES_VALID:
            return
        age_s = float(fields["tslc"])
        measured_s = self._now_s() - age_s
        if measured_s - self._measured_s <= _REPEATED_S or age_s > _AGE_MAX_S:
            return
        if self._measured_s == -math.inf:
            self._announce(f"the contact {self._name} is received: it is used as the beacon")
        self._measured_s = measured_s
        east_m, north_m = self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        sigma_m = _ADSB_SIGMA_M
        if self._message == _AIS:
            sigma_m = _AIS_ACCURATE_SIGMA_M if int(fields["flags"]) & _AIS_ACCURATE else _AIS_SIGMA_M
        self._put(TargetFixReading(measured_s, east_m, north_m, sigma_m, Source(self._message, 0)))
