"""Alarms: raised and cleared in time, never by a moment's doubt, and each with what to do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.alarms import ALARM_KEYS, Alarms
from sidelong.mission.control.present import Phase, Present, VehicleStatus
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.plan import AircraftState

STATUS = VehicleStatus(80, 12.0, "3D, 12 satellites", True, endurance_s=3000.0, home_s=60.0)
EMPTY = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller().snapshot()
OK = tuple(InputReport(one, InputState.OK, 0.0, 10.0, "") for one in Input)


def present(time_s: float, angle_rad=0.0, range_m=300.0, unseen_s=0.1, vehicle=None, **change) -> Present:
    """Return a watch of a target that drives north, from its left. vehicle: what differs of its status."""
    at_m = range_m * math.sin(angle_rad - math.pi / 2), range_m * math.cos(angle_rad - math.pi / 2)
    seen_s = time_s - unseen_s
    now = replace(
        EMPTY,
        time_s=time_s,
        phase=Phase.WATCHING,
        aircraft=AircraftState(time_s, *at_m, 0.0, 15.0, 0.0),
        estimate=TargetEstimate(time_s, 0.0, 0.0, 0.0, 0.0, np.eye(4), TrackQuality.GOOD, seen_s),
        course_rad=0.0,
        health=OK,
        vehicle=replace(STATUS, **(vehicle or {})),
    )
    return replace(now, **change)


def faulty(one, state=InputState.STALE):
    return (InputReport(one, state, 100.0, 0.0, f"no data from the {one}"),)


CAUSES = {
    "yield": {"over": "the flight mode was changed to LOITER", "phase": Phase.YIELDED},
    "separation": {"separation": "only 42 m from south; 50 m are required"},
    "link": {"connected": False, "vehicle": {"silent_s": 3.0}},
    "battery": {"vehicle": {"battery_percent": 30, "endurance_s": 70.0}},
    "object": {"other_object": "the payload may follow another object"},
    "charge": {"vehicle": {"battery_doubt": "the reported charge fell from 80 to 3 % within 1 s"}},
    "target": {"unseen_s": 12.0},
    **{one.value: {"health": faulty(one)} for one in Input if one is not Input.LINK},
    "gps": {"vehicle": {"gps": "2D", "gps_good": False}},
    "band": {"range_m": 80.0},
    "side": {"angle_rad": 3.0},
}


def flown(alarms, until_s, since_s=0.0, **change):
    """Show a situation every half second; return (time, key, raised) of each change."""
    changes = []
    for tick in range(int(2 * since_s), int(2 * until_s)):
        raised, cleared = alarms.update(present(tick / 2, **change))
        changes += [(tick / 2, one.key, True) for one in raised] + [(tick / 2, one.key, False) for one in cleared]
    return changes


def test_a_good_watch_raises_nothing():
    assert flown(Alarms(), 600.0) == []


@pytest.mark.parametrize("key", [*CAUSES])
def test_each_alarm_is_raised_and_cleared_within_five_seconds(key):
    alarms = Alarms()
    flown(alarms, 100.0)
    ((raised_s, raised_key, raised),) = flown(alarms, 140.0, 100.0, **CAUSES[key])
    assert (raised_key, raised) == (key, True)
    after_s = 20.0 if key == "side" else 0.0  # it is an alarm only after that time
    assert raised_s - 100.0 - after_s <= 5.0
    (alarm,) = alarms.active
    assert alarm.advice
    assert alarm.text
    ((cleared_s, cleared_key, raised),) = flown(alarms, 160.0, 140.0)
    assert (cleared_key, raised) == (key, False)
    assert cleared_s - 140.0 <= 5.0
    assert alarms.active == ()


def test_every_alarm_is_tried_here():
    assert {*CAUSES} == set(ALARM_KEYS)


@pytest.mark.parametrize(("key", "moment_s"), [("band", 1.0), ("side", 19.0), ("gps", 1.0), ("battery", 1.0)])
def test_a_moment_is_no_alarm(key, moment_s):
    alarms = Alarms()
    flown(alarms, 100.0)
    assert flown(alarms, 100.0 + moment_s, 100.0, **CAUSES[key]) == []
    assert flown(alarms, 130.0, 100.0 + moment_s) == []


def test_at_the_border_of_the_side_the_alarm_waits_until_the_estimate_is_sure():
    alarms = Alarms()
    flown(alarms, 100.0)
    assert flown(alarms, 130.0, 100.0, angle_rad=math.pi / 2 + 0.02) == []
    assert flown(alarms, 151.0, 130.0, angle_rad=math.pi / 2 + 0.1) == [(150.0, "side", True)]


def test_an_alarm_does_not_flicker():
    alarms = Alarms()
    flown(alarms, 100.0)
    changes = []
    for tick in range(200, 300):  # in and out of the band every half second
        raised, cleared = alarms.update(present(tick / 2, range_m=99.0 if tick % 5 else 101.0))
        changes += [*raised, *cleared]
    assert len(changes) <= 1


def test_on_the_way_to_the_first_circle_band_and_side_are_no_alarm():
    alarms = Alarms()
    assert flown(alarms, 119.0, range_m=80.0, angle_rad=3.0) == []
    late = flown(alarms, 150.0, 119.0, range_m=80.0, angle_rad=3.0)
    assert {key for _, key, raised in late if raised} == {"band", "side"}


@pytest.mark.parametrize(("state", "raised"), [(InputState.INCONSISTENT, True), (InputState.SWITCHED, False)])
def test_an_input_is_an_alarm_when_it_cannot_be_used(state, raised):
    alarms = Alarms()
    flown(alarms, 100.0)
    changes = flown(alarms, 101.0, 100.0, health=faulty(Input.LASER, state))
    assert [key for _, key, _ in changes] == (["laser"] if raised else [])


def test_a_silent_link_freezes_the_other_alarms():
    alarms = Alarms()
    flown(alarms, 100.0)
    flown(alarms, 110.0, 100.0, range_m=90.0)
    changes = flown(alarms, 120.0, 110.0, connected=False, vehicle={"silent_s": 4.0})
    assert [key for _, key, _ in changes] == ["link"]
    assert [alarm.key for alarm in alarms.active] == ["link", "band"]


def test_a_lost_target_counts_down_to_the_flight_home_and_holding_stops_it():
    alarms = Alarms()
    flown(alarms, 100.0)
    flown(alarms, 101.0, 100.0, unseen_s=30.0, give_up_after_s=72.0)
    (alarm,) = alarms.active
    assert "flies home in 42 s" in alarm.text
    assert "press Hold" in alarm.advice
    assert alarm.countdown_s == 42.0
    flown(alarms, 102.0, 101.0, unseen_s=31.0, phase=Phase.HOLDING)
    assert alarms.active[0].countdown_s is None
    flown(alarms, 103.0, 102.0, unseen_s=31.0, give_up_after_s=71.0, give_up_action="hold")
    assert "stays on its circle" in alarms.active[0].text


def test_acknowledging_keeps_the_alarm_until_its_cause_is_gone():
    alarms = Alarms()
    flown(alarms, 100.0)
    flown(alarms, 101.0, 100.0, health=faulty(Input.LASER))
    assert alarms.acknowledge("laser")
    assert not alarms.acknowledge("laser")
    assert not alarms.acknowledge("gimbal")
    flown(alarms, 105.0, 101.0, health=faulty(Input.LASER))
    assert alarms.active[0].acknowledged
    flown(alarms, 110.0, 105.0)
    flown(alarms, 111.0, 110.0, health=faulty(Input.LASER))
    assert not alarms.active[0].acknowledged  # it is another one


@pytest.mark.parametrize(
    ("percent", "endurance_s", "home_s", "raised"),
    [
        (40.0, 300.0, 200.0, False),
        (40.0, 239.0, 200.0, True),
        (90.0, 100.0, math.inf, True),  # the wind does not let it home
        (30.0, None, None, False),
        (24.0, None, None, True),
        (None, None, None, False),
    ],
)
def test_the_battery_is_low_at_120_percent_of_the_flight_home(percent, endurance_s, home_s, raised):
    alarms = Alarms()
    flown(alarms, 20.0, vehicle={"battery_percent": percent, "endurance_s": endurance_s, "home_s": home_s})
    assert ([alarm.key for alarm in alarms.active] == ["battery"]) is raised


def test_before_the_takeover_nothing_is_judged():
    wrong = {"range_m": 80.0, "angle_rad": 3.0, "unseen_s": 60.0, "health": faulty(Input.LASER)}
    assert flown(Alarms(), 300.0, phase=Phase.WAITING, **wrong, vehicle={"battery_percent": 5}) == []
