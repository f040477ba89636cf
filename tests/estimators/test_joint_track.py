"""One track from the sightings of several payloads."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.joint_track import JointTrack

YAW_SIGMA, RANGE_SIGMA = math.radians(0.35), 0.8
BIAS = {"west": (math.radians(0.6), 0.5), "south": (math.radians(-0.5), -0.4), "east": (0.0, 0.0)}
MIDDLE = {"west": (-300.0, 0.0), "south": (0.0, -300.0), "east": (300.0, 0.0)}
VELOCITY = (2.0, 1.0)


def sighting(rng: np.random.Generator, name: str, time_s: float, shift_m: float = 0.0) -> Sighting:
    """What an aircraft that circles next to the target sees; shift_m: of what it sees in place of the target."""
    target = np.array(VELOCITY) * time_s
    angle = 0.19 * time_s + len(name)
    aircraft = target + MIDDLE[name] + 80.0 * np.array((math.sin(angle), math.cos(angle)))
    east, north = target + np.array((shift_m, 0.0)) - aircraft
    level, (yaw, offset) = math.hypot(east, north), BIAS[name]
    noise = rng.standard_normal(3) * (RANGE_SIGMA, YAW_SIGMA, YAW_SIGMA)
    return Sighting(
        time_s,
        math.hypot(level, 100.0) + offset + noise[0],
        math.atan2(east, north) + yaw + noise[1],
        math.atan2(100.0, level) + noise[2],
        RANGE_SIGMA,
        YAW_SIGMA,
        YAW_SIGMA,
        *aircraft.tolist(),
        100.0,
    )


def watched(
    names: tuple[str, ...], until_s: float, track: JointTrack | None = None, **shifts: tuple[float, float]
) -> tuple[JointTrack, list[float]]:
    """Fly; shifts: of a payload, (from when, by how much) it sees another thing. Return each second's error."""
    rng = np.random.default_rng(3)
    track = track or JointTrack({name: TrackerSettings(range_bias_sigma_m=0.5) for name in names})
    errors = []
    for k in range(round(until_s * 5)):
        time_s = k / 5
        for name in names:
            since_s, shift_m = shifts.get(name, (math.inf, 0.0))
            track.add(name, sighting(rng, name, time_s, shift_m if time_s >= since_s else 0.0))
        if k % 5 == 0:
            now = track.estimate(time_s)
            assert now is not None
            errors.append(math.hypot(now.east_m - VELOCITY[0] * time_s, now.north_m - VELOCITY[1] * time_s))
    return track, errors


def test_two_base_lines_report_the_errors_of_both_payloads():
    track, errors = watched(("west", "south"), 100.0)
    _, alone = watched(("west",), 100.0)
    assert np.sqrt(np.mean(np.square(errors[50:]))) < 0.5 < np.sqrt(np.mean(np.square(alone[50:])))
    for name in ("west", "south"):
        found = track.calibration(name)
        assert found.yaw_bias_rad == pytest.approx(BIAS[name][0], abs=math.radians(0.15))
        assert found.range_bias_m == pytest.approx(BIAS[name][1], abs=0.4)


def test_a_bad_payload_is_left_out_with_its_reason_and_taken_in_again():
    track, errors = watched(("west", "south", "east"), 60.0, south=(30.0, 60.0))
    assert max(errors[10:]) < 3.0
    assert track.refused.keys() == {"south"}
    assert "m from where the others do" in track.refused["south"]
    rng = np.random.default_rng(4)
    for k in range(100):
        for name in ("west", "south", "east"):
            track.add(name, sighting(rng, name, 60.0 + k / 5))
        track.estimate(60.0 + k / 5)
    assert not track.refused


@pytest.mark.parametrize(("silent_s", "used"), [(8.0, False), (20.0, True)])
def test_a_payload_that_others_contradicted_is_not_used_in_a_short_silence_of_all_others(silent_s, used):
    track, _ = watched(("west", "south", "east"), 50.0, south=(30.0, 60.0))
    rng, errors = np.random.default_rng(4), []
    for k in range(round(silent_s * 5)):
        time_s = 50.0 + k / 5
        track.add("south", sighting(rng, "south", time_s, 60.0))
        now = track.estimate(time_s)
        errors.append(math.hypot(now.east_m - VELOCITY[0] * time_s, now.north_m - VELOCITY[1] * time_s))
    assert (max(errors) > 30.0) is used
    assert ("south" in track.refused) is not used


def covers(track: JointTrack, time_s: float, shift_m: float) -> bool:
    now = track.estimate(time_s)
    error = np.array((now.east_m - shift_m, now.north_m)) - np.array(VELOCITY) * now.time_s
    return bool(error @ np.linalg.solve(now.covariance[:2, :2], error) < 5.99)


@pytest.mark.parametrize("confirmed", [False, True])
def test_of_two_that_contradict_each_other_neither_is_called_right(confirmed):
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    for name in ("west", "south"):
        track.judge(name, "", confirmed=confirmed)
    watched(("west", "south"), 45.0, track, south=(30.0, 60.0))
    for name, other in (("west", "south"), ("south", "west")):
        assert f"m from where {other} does; either may be wrong: check both payloads" in track.refused[name]
    assert not track.is_led
    assert covers(track, 45.0, 0.0)
    assert covers(track, 45.0, 60.0)


def test_a_difference_too_small_for_a_contradiction_widens_the_ellipse():
    track, _ = watched(("west", "south"), 60.0, south=(50.0, 8.0))
    assert not track.refused
    assert covers(track, 60.0, 0.0)
    assert covers(track, 60.0, 8.0)


def test_a_short_silence_of_one_of_two_that_contradict_does_not_let_the_other_one_lead():
    track, _ = watched(("west", "south"), 45.0, south=(0.0, 60.0))
    rng = np.random.default_rng(4)
    for k in range(50):
        time_s = 45.0 + k / 5
        track.add("south", sighting(rng, "south", time_s, 60.0))
        assert covers(track, time_s, 0.0)
        assert not track.is_led


def test_the_payload_that_leads_at_last_is_followed_from_where_it_is_now():
    track, _ = watched(("west", "south"), 60.0, south=(0.0, 60.0))
    track.judge("west", "", confirmed=True)
    rng = np.random.default_rng(4)
    for k in range(75):
        time_s = 60.0 + k / 5
        track.add("west", sighting(rng, "west", time_s))
        track.add("south", sighting(rng, "south", time_s, 60.0))
        track.estimate(time_s)
    assert track.is_led
    assert covers(track, 75.0, 0.0)
    assert not covers(track, 75.0, 60.0)


def test_the_payload_that_was_confirmed_in_flight_leads_one_that_was_not():
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    track.judge("south", "", confirmed=True)
    _, errors = watched(("west", "south"), 45.0, track, west=(0.0, 60.0))
    assert track.is_led
    assert re.fullmatch(
        r"it sees the target \d+ m from where south does: the other payload was confirmed in this flight",
        track.refused["west"],
    )
    assert max(errors[15:]) < 6.0


@pytest.mark.parametrize(
    ("known", "why"), [({"fault": "a fault"}, "a fault"), ({"jumped": True}, "its target's position has jumped")]
)
def test_a_payload_that_its_own_aircraft_finds_at_fault_does_not_lead(known, why):
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    track.judge("west", confirmed=True, **known)
    track.judge("south", confirmed=True)
    _, errors = watched(("west", "south"), 45.0, track, west=(30.0, 60.0))
    assert track.refused.keys() == {"west"}
    assert re.fullmatch(rf"it sees the target \d+ m from where south does: {why}", track.refused["west"])
    assert max(errors[15:]) < 3.0


def test_a_jump_of_a_payload_that_never_agreed_with_the_other_one_proves_nothing():
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    track.judge("west", jumped=True)
    watched(("west", "south"), 30.0, track, south=(0.0, 60.0))
    assert not track.is_led


def test_a_fault_of_a_payload_that_agrees_with_the_others_leaves_it_in_use():
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    track.judge("west", "a fault", jumped=True)
    watched(("west", "south"), 20.0, track)
    assert not track.refused


def test_a_payload_that_is_corrected_is_used_again_and_what_it_saw_before_is_forgotten():
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    watched(("west", "south"), 40.0, track, south=(0.0, 60.0))
    assert not track.is_led
    track.judge("south", "", confirmed=False, corrected=(0.02, 0.5))
    rng, errors = np.random.default_rng(4), []
    for k in range(200):
        time_s = 40.0 + k / 5
        for name in ("west", "south"):
            track.add(name, sighting(rng, name, time_s))
        now = track.estimate(time_s)
        errors.append(math.hypot(now.east_m - VELOCITY[0] * time_s, now.north_m - VELOCITY[1] * time_s))
    assert not track.refused
    assert track.is_led
    assert max(errors[60:]) < 2.5


def test_a_single_payload_that_is_corrected_leaves_nothing_of_what_it_saw_before():
    track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
    watched(("west",), 40.0, track, west=(0.0, 60.0))
    track.judge("west", "", confirmed=False, corrected=(0.02, 0.5))
    assert track.estimate(40.0) is None
    track.add("west", sighting(np.random.default_rng(4), "west", 40.0))
    assert covers(track, 40.0, 0.0)


def test_a_payload_that_is_wrong_from_the_start_spoils_nothing_once_two_others_agree():
    _, errors = watched(("south", "west", "east"), 40.0, south=(0.0, 60.0))
    assert max(errors[15:]) < 2.0


def test_sightings_may_come_late_and_in_any_order():
    rng = np.random.default_rng(5)
    every = [(name, sighting(rng, name, k / 5)) for k in range(200) for name in ("west", "south")]
    late = [(0.7 if name == "south" else 0.0, k, name, one) for k, (name, one) in enumerate(every)]
    late.sort(key=lambda row: (row[3].time_s + row[0], row[1]))
    found = []
    for rows in (every, [(name, one) for _, _, name, one in late]):
        track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
        accepted = [track.add(name, one).accepted for name, one in rows]
        assert np.mean(accepted) > 0.98
        found.append(track.estimate(40.0))
    assert math.hypot(found[0].east_m - found[1].east_m, found[0].north_m - found[1].north_m) < 0.15


def test_a_clock_that_is_ahead_costs_less_and_is_rejected_when_its_sigma_is_reported():
    inside, errors = {}, {}
    for announced_s in (0.0, 0.5):
        squares, found = [], []
        for seed in range(3):
            rng = np.random.default_rng(seed)
            track = JointTrack({"west": TrackerSettings(), "south": TrackerSettings()})
            for k in range(500):
                for name, ahead_s in (("west", 0.0), ("south", 0.5)):
                    one = sighting(rng, name, k / 5)
                    track.add(name, replace(one, time_s=one.time_s + ahead_s), announced_s if ahead_s else 0.0)
                now = track.estimate(k / 5)
                error = np.array((now.east_m, now.north_m)) - np.array(VELOCITY) * now.time_s
                found.append(error @ np.linalg.solve(now.covariance[:2, :2], error) < 5.99)
                squares.append(error @ error)
        inside[announced_s], errors[announced_s] = np.mean(found), np.mean(squares)
    assert inside[0.5] > 0.9 > inside[0.0]
    assert errors[0.5] < 0.8 * errors[0.0]


def test_a_target_unseen_by_all_is_lost_and_found_again():
    track, _ = watched(("west", "south"), 30.0)
    assert track.estimate(35.0).quality is TrackQuality.COASTING
    assert track.estimate(120.0).quality is TrackQuality.LOST
    track.add("south", sighting(np.random.default_rng(7), "south", 130.0))
    assert track.estimate(130.0).quality is TrackQuality.GOOD
