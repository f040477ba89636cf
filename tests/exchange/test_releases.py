"""Whole flights of older releases: MISSION_CURRENT without total and id, no CURRENT_MODE."""

from dataclasses import replace

import pytest

from sidelong.mission.core.events import PlanStatus, Yield
from sidelong.sitl.settings import Flavour, LinkFaults, Settings, TargetSettings

BAD = LinkFaults(loss=0.05, duplicate=0.05, delay_s=0.1)
RELEASES = [
    *((Flavour.ARDUPLANE, release) for release in ((4, 4), (4, 5), (4, 6))),
    *((Flavour.PX4, release) for release in ((1, 14), (1, 15), (1, 17))),
]


FLOWN = [(*one, "mission") for one in RELEASES] + [(*one, "command") for one in RELEASES if one[0] == "arduplane"]


def of_release(flavour, release):
    return Settings(flavour, release=release, seed=1, targets=(TargetSettings(speed_max_m_s=0.5),))


@pytest.mark.parametrize(("flavour", "release", "guidance"), FLOWN)
def test_plans_are_flown_and_nothing_is_yielded(in_the_air, flavour, release, guidance):
    flight = in_the_air(flavour, settings=of_release(flavour, release), faults=BAD, guidance=guidance)

    def departures():
        return [one for one in flight.found(PlanStatus) if one.stage == "departed"]

    assert flight.run(90.0, lambda: len(departures()) >= 2)
    flight.run(10.0)
    assert not flight.found(Yield)


@pytest.mark.parametrize(("flavour", "release", "guidance"), [*FLOWN[: len(RELEASES)], (*RELEASES[2], "command")])
def test_a_circle_that_is_flown_is_taken_over_again(in_the_air, flavour, release, guidance):
    flight = in_the_air(flavour, settings=of_release(flavour, release), guidance=guidance)
    flight.run(5.0)
    flight.core = flight.make_core(flight.planner)
    flight.forget_outputs()
    flight.take_over(flight.dialect.mission_mode)
    assert flight.run(10.0, lambda: flight.has_control)
    flight.run(40.0)
    assert not flight.found(Yield)


@pytest.mark.parametrize(("flavour", "release"), RELEASES)
def test_another_stations_mission_is_yielded_to(in_the_air, flavour, release):
    flight = in_the_air(flavour, settings=of_release(flavour, release), faults=BAD)
    flight.run(20.0)
    mission = flight.autopilot.mission
    items = [replace(item, latitude_e7=item.latitude_e7 + 20_000) for item in mission.items()]
    mission.begin(len(items))
    for index, item in enumerate(items):
        mission.put(index, item, current=index == 0)
    mission.finish()
    assert flight.run(15.0, lambda: bool(flight.found(Yield)))
