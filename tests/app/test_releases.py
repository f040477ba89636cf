"""Firmware releases: parameters under the names of each, their limits, and releases that are refused."""

from __future__ import annotations

import asyncio

import pytest

from sidelong.app.autopilots.autopilot import Limits, ParameterTable, Purpose, Release, RequiredParameter, release_in
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_name
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.flight.preflight import check_release, checks
from sidelong.app.link.stored import read_table, temporary_parameters
from sidelong.app.link.vehicle import Vehicle, release_of
from sidelong.sitl.settings import Flavour, Settings
from sidelong.sitl.simulation import Simulation
from tests.app.test_asking import LossyLink

ARDUPLANE, PX4 = AUTOPILOTS
FLOWN = [
    *((Flavour.ARDUPLANE, release) for release in ((4, 4), (4, 5), (4, 6), (4, 7))),
    *((Flavour.PX4, release) for release in ((1, 14), (1, 15), (1, 16), (1, 17), (1, 18))),
]
SILENT = type("Silent", (), {"latest": {}, "only_mavlink_1": False, "is_companion": True})()
OF = {Flavour(one.key): one for one in AUTOPILOTS}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr("sidelong.app.link.stored._VALUE_S", 0.01)
    monkeypatch.setattr("sidelong.app.link.stored._IDLE_S", 0.05)


def asked(flavour, release, ask, change=lambda _parameters: None):
    """Return what ``ask`` returns for a simulated vehicle of that release."""

    async def main():
        simulation = Simulation(Settings(flavour=flavour, release=release))
        change(simulation.vehicle.parameters)
        link = LossyLink(simulation, 0.0)
        vehicle = Vehicle(link)
        pump = asyncio.create_task(vehicle.run())
        link.run(3.0)
        while "HEARTBEAT" not in vehicle.latest:
            await asyncio.sleep(0)
        try:
            return await ask(vehicle)
        finally:
            pump.cancel()

    return asyncio.run(main())


def table_of(flavour, release, change=lambda _parameters: None):
    async def ask(vehicle):
        return await read_table(vehicle, OF[flavour], await release_of(vehicle))

    return asked(flavour, release, ask, change)


@pytest.mark.parametrize(("flavour", "release"), FLOWN)
def test_the_release_on_board_is_read_and_accepted(flavour, release):
    found = asked(flavour, release, release_of)
    assert (found.major, found.minor) == release
    assert check_release(OF[flavour], found) is None


@pytest.mark.parametrize(("flavour", "release"), FLOWN)
def test_every_parameter_is_found_under_the_names_of_the_release(flavour, release):
    table = table_of(flavour, release)
    assert table.missing == ()
    limits = OF[flavour].limits(table.values)
    expected = Limits(65.0, 10.0, 30.0, 15.0) if flavour is Flavour.ARDUPLANE else Limits(50.0, 10.0, 20.25, 15.0)
    assert limits == expected
    assert OF[flavour].required_parameters(table.values, 15.0) == ()
    assert all(note.value is not None for note in table.notes())


@pytest.mark.parametrize(("flavour", "release"), FLOWN)
def test_airspeed_bank_ground_station_and_mission_items_are_checked_on_every_release(flavour, release):
    table = table_of(flavour, release)

    found = {one.name: one for one in checks(Config(), SILENT, OF[flavour], table, None, ())}
    assert found["airspeed"].found == "15 m/s wanted, 10 to " + ("30" if flavour == "arduplane" else "20.25") + (
        " m/s allowed"
    )
    assert found["bank limit"].found.endswith(" degrees")
    for purpose in (Purpose.GROUND_STATION, Purpose.MISSION_ITEMS):
        assert " = " in found[purpose].found
        assert "not reported" not in found[purpose].found
    own_name = "SYSID_MYGCS = 255" if release < (4, 7) else "MAV_GCS_SYSID = 255"
    assert flavour is Flavour.PX4 or own_name in found["ground station"].found


@pytest.mark.parametrize(("flavour", "release"), FLOWN)
def test_a_bank_limit_below_the_configured_one_is_refused_on_every_release(flavour, release):
    name = "ROLL_LIMIT_DEG" if flavour is Flavour.ARDUPLANE else "FW_R_LIM"
    table = table_of(flavour, release, lambda parameters: parameters.set(name, 20.0))
    config = Config.model_validate({"aircraft": {"bank_max_deg": 35.0}})

    (bank,) = (one for one in checks(config, SILENT, OF[flavour], table, None, ()) if one.name == "bank limit")
    assert (bank.ready, bank.found) == (False, "20 degrees")


def test_a_cruise_speed_in_cm_per_second_is_set_and_restored_in_cm_per_second():
    announced, values = [], []

    async def ask(vehicle):
        autopilot, simulation = ARDUPLANE, vehicle.link._simulation
        table = await read_table(vehicle, autopilot, await release_of(vehicle))
        required = table.as_on_board(autopilot.required_parameters(table.values, 15.0))

        async def set_parameter(name, value):
            simulation.vehicle.parameters.set(name, value)
            return True

        vehicle.link.set_parameter = set_parameter
        async with temporary_parameters(vehicle, required, announced.append, lambda: True):
            values.append(simulation.vehicle.parameters["TRIM_ARSPD_CM"])
        values.append(simulation.vehicle.parameters["TRIM_ARSPD_CM"])
        return required

    (need,) = asked(Flavour.ARDUPLANE, (4, 4), ask, lambda parameters: parameters.set("TRIM_ARSPD_CM", 2200))
    assert need == RequiredParameter("TRIM_ARSPD_CM", 2200.0, 1500.0, need.why)
    assert "it would fly 22 m/s" in need.why
    assert values == [1500.0, 2200.0]
    assert "TRIM_ARSPD_CM = 1500 for this flight (was 2200)" in announced[0]


@pytest.mark.parametrize(
    ("flavour", "release", "lacks"),
    [(Flavour.ARDUPLANE, (4, 3), "DO_REPOSITION"), (Flavour.PX4, (1, 13), "MIS_TKO_LAND_REQ")],
)
def test_an_older_release_is_refused_with_what_it_lacks(flavour, release, lacks):
    found = asked(flavour, release, release_of)
    with pytest.raises(InputError, match=lacks) as refusal:
        check_release(OF[flavour], found)
    assert f"{found} is not supported" in str(refusal.value)
    assert "update it to" in str(refusal.value)


@pytest.mark.parametrize("autopilot", AUTOPILOTS, ids=lambda one: one.key)
def test_a_newer_release_and_an_unknown_one_are_accepted_with_a_remark(autopilot):
    newest = autopilot.releases.newest
    assert "newer than" in check_release(autopilot, Release(newest.major, newest.minor + 1))
    assert check_release(autopilot, Release(newest.major, newest.minor, 9)) is None
    assert "did not report its release" in check_release(autopilot, None)


def test_a_parameter_that_a_newer_release_has_renamed_is_named_as_not_checked():
    names = {one.name: 1.0 for one in ARDUPLANE.parameters if one.is_in(Release(4, 7))}
    del names["ROLL_LIMIT_DEG"]
    table = ParameterTable(ARDUPLANE.parameters, Release(4, 9), names)
    assert table.missing == ("the autopilot has no parameter ROLL_LIMIT_DEG: its bank limit is not checked",)
    assert table.found_for(Purpose.BANK_LIMIT) == "ROLL_LIMIT_DEG is not reported"


def test_a_parameter_is_found_under_the_name_of_another_release_where_the_version_misleads():
    """A development build counts as the release to come while it still has the old name."""

    async def ask(vehicle):
        return await read_table(vehicle, ARDUPLANE, Release(4, 7, 0, "dev"))

    table = asked(Flavour.ARDUPLANE, (4, 6), ask)
    assert table.missing == ()
    assert table.values["MAV_GCS_SYSID"] == 255.0
    assert "SYSID_MYGCS = 255" in table.found_for(Purpose.GROUND_STATION)


@pytest.mark.parametrize(
    ("version", "text"),
    [
        (4 << 24 | 6 << 16 | 3 << 8 | 255, "4.6.3"),
        (4 << 24 | 7 << 16 | 64, "4.7.0-alpha"),
        (1 << 24 | 18 << 16, "1.18.0-dev"),
    ],
)
def test_a_version_number_is_read_as_release_and_stage(version, text):
    assert str(release_in({"flight_sw_version": version})) == text


@pytest.mark.parametrize(
    ("data", "commit"),
    [
        (list(b"3fc7011a"), "3fc7011a"),
        ([0x12, 0xFC, 0xFF, 0x5D, 0xFC, 0x55, 0xF0, 0x54], "54f055fc"),
        ([0] * 8, ""),
    ],
)
def test_the_commit_is_read_as_each_autopilot_sends_it(data, commit):
    assert release_in({"flight_sw_version": 1 << 24, "flight_custom_version": data}).commit == commit


def test_a_version_of_zero_names_no_release():
    assert release_in({"flight_sw_version": 0}) is None


def test_no_two_entries_of_a_parameter_hold_in_the_same_release():
    for autopilot in AUTOPILOTS:
        oldest, newest = autopilot.releases.oldest, autopilot.releases.newest
        for minor in range(oldest.minor, newest.minor + 1):
            keys = [one.known_as for one in autopilot.parameters if one.is_in(Release(oldest.major, minor))]
            assert len(keys) == len(set(keys)), (autopilot.name, minor)


def test_the_registry_names_each_autopilot():
    assert [autopilot_by_name(one.name) for one in AUTOPILOTS] == list(AUTOPILOTS)
