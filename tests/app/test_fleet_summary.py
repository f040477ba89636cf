"""What several aircraft kept together, and how far apart they stayed."""

from __future__ import annotations

import math

import pytest

from sidelong.app.analysis.score import Moment
from sidelong.app.analysis.summary import FlownAircraft, MissionTrack, Summary, min_separation_m, summarise_fleet
from sidelong.mission.core.requirement import Requirement, Side

REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 5.0)
ASKED = {"target": [(-math.inf, REQUIREMENT)]}
SUMMARY = Summary(100.0, 1.0, 0.5, 150.0, 400.0, "truth", 1, 1, 0, 10, 0, 1.0, "completed")


def moments(places, begin_s=0.0, step_s=0.5):
    """Return moments next to a target that goes north at 2 m/s: places are metres east of it."""
    return [
        Moment(begin_s + k * step_s, east_m, k * step_s * 2.0, 0.0, k * step_s * 2.0, 0.0, 2.0)
        for k, east_m in enumerate(places)
    ]


def flown(name, places, offset_s=0.0, track=None):
    return FlownAircraft(name, SUMMARY, moments(places, -offset_s), offset_s, track or MissionTrack())


def test_a_side_counts_while_any_aircraft_has_it():
    one = flown("a", [-200.0] * 100 + [200.0] * 100)
    other = flown("b", [200.0] * 120 + [-200.0] * 80, offset_s=1000.0)
    found = summarise_fleet([one, other], ASKED, "completed", "truth")
    assert found.duration_s == pytest.approx(100.0, abs=1.0)
    assert found.time_on_side_any == pytest.approx(0.9, abs=0.01)
    assert [each.time_on_wanted_side for each in found.aircraft] == pytest.approx([0.5, 0.45], abs=0.01)
    assert found.longest_off_side_any_s == pytest.approx(10.0, abs=1.0)
    assert found.time_in_band_any == 1.0


def test_it_counts_from_when_all_have_come_into_the_band():
    one = flown("a", [200.0] * 100 + [-200.0] * 100)
    late = flown("b", [900.0] * 100 + [300.0] * 100)
    found = summarise_fleet([one, late], ASKED, "completed", "truth")
    assert found.duration_s == pytest.approx(50.0, abs=1.0)
    assert found.time_on_side_any == 1.0


def test_an_aircraft_that_is_lost_watches_no_more():
    one, lost = flown("a", [200.0] * 200), flown("b", [-200.0] * 100)
    found = summarise_fleet([one, lost], ASKED, "completed", "truth")
    assert found.time_on_side_any == pytest.approx(0.5, abs=0.03)


def test_an_aircraft_that_never_watched_does_not_hide_the_others():
    found = summarise_fleet([flown("a", [-200.0] * 100), flown("b", [])], ASKED, "completed", "truth")
    assert found.time_on_side_any == 1.0
    assert summarise_fleet([flown("b", [])], ASKED, "failed", "estimate").time_on_side_any is None


def track(*rows):
    made = MissionTrack()
    for row in rows:
        made.add(*row)
    return made


def test_the_separation_is_in_three_dimensions_and_in_the_air():
    straight = track(*((k, 10.0 * k, 0.0, 100.0) for k in range(100)))
    crossing = track(*((k + 0.4, 500.0, 10.0 * k - 500.0, 160.0) for k in range(100)))
    assert min_separation_m([straight, crossing]) == pytest.approx(60.0, abs=1.0)
    parked = track(*((k, 10.0 * k, 1.0, 2.0) for k in range(100)))
    assert min_separation_m([straight, parked]) is None
    assert min_separation_m([straight]) is None


def test_a_gap_of_a_track_is_no_place():
    straight = track(*((k, 10.0 * k, 0.0, 100.0) for k in range(100)))
    silent = track((10.0, 100.0, 500.0, 100.0), (11.0, 100.0, 500.0, 100.0), (90.0, 900.0, 1.0, 100.0))
    assert min_separation_m([straight, silent]) > 400.0


def test_the_json_holds_each_aircraft_by_name():
    found = summarise_fleet([flown("a", [-200.0] * 10)], ASKED, "completed", "truth").as_json()
    assert found["aircraft"][0]["name"] == "a"
    assert (found["aircraft"][0]["time_on_side"], found["aircraft"][0]["time_on_wanted_side"]) == (0.5, 1.0)
    assert {"time_on_side_any", "time_in_band_any", "min_separation_m"} <= set(found)
