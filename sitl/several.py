"""Several vehicles with common targets: their home positions, and separate sensor noise for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sidelong.sitl.settings import Flavour, Home, Release, Settings
from sidelong.sitl.world.geodesy import HomePlane

MAX_VEHICLES = 8
_APART_M = 200.0  # more than the circles that are flown at home are wide


def in_turn(
    first: Settings,
    flavours: Sequence[Flavour],
    airspeeds_m_s: Sequence[float],
    endurances_s: Sequence[float],
    count: int,
    looks_at: Sequence[int] = (0,),
    releases: Sequence[Release | None] = (None,),
) -> list[Settings]:
    """Return the settings of ``count`` vehicles: the first at its home, the others in a row east of it.

    Flavours, releases, airspeeds, endurances and what they look at are repeated in turn. System ids follow one
    another; the targets are the same for all.
    """
    home = first.home_or_default
    plane = HomePlane(home.latitude_deg, home.longitude_deg)
    return [
        replace(
            first,
            flavour=flavours[number % len(flavours)],
            release=releases[number % len(releases)],
            system_id=first.system_id + number,
            seed=first.seed + number,
            target_seed=first.seed,
            airspeed_m_s=airspeeds_m_s[number % len(airspeeds_m_s)],
            endurance_s=endurances_s[number % len(endurances_s)],
            home=Home(*plane.latitude_longitude_deg(number * _APART_M, 0.0), home.altitude_m) if number else home,
            home_east_m=number * _APART_M,
            looks_at=looks_at[number % len(looks_at)],
        )
        for number in range(count)
    ]
