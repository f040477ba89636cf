"""What once misled flights, done to real autopilots, where their SITL programs are given.

SIDELONG_ARDUPLANE=/path/to/arduplane SIDELONG_PX4=/path/to/px4 python -m pytest tests/autopilot/test_real_faults.py

Each autopilot is started once, and flown by one launch after the other: all but the first take it over in the air.
REAL_SPEED: how many times the clock.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import re
import signal
import sys
import time
from contextlib import ExitStack

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.mission.core.events import ActivatePlan, HealthChanged, PlanStatus
from sidelong.mission.core.inputs import Input
from sidelong.sitl.settings import LinkFaults
from tests.autopilot.changing_relay import PAYLOAD, VEHICLE, ChangingRelay, packed, unchanged
from tests.autopilot.conftest import COMMANDING, PATIENCE_S, Application
from tests.autopilot.real_vehicle import FLAVOURS, RealVehicle, configured
from tests.autopilot.relay import GOOD

pytestmark = [pytest.mark.autopilot, pytest.mark.timeout(900)]

WANDERING = (sys.executable, "-m", "tests.bench.wandering")
SPEED = float(os.environ.get("REAL_SPEED", "3"))
WATCHED = "watched from now on"
FAULT_S, REPORTED_WITHIN_S, NEAREST_M = 40.0, 16.0, 80.0  # on the vehicle's clock
GOES_ON = "the aircraft goes on circling where it is."
NO_MORE = "commanding nothing more"
MISSION_MODE = {"arduplane": 10, "px4": 0x04040000}
RECEIVER = {  # the parameter that switches the simulated one, its type, and its values off and on
    "arduplane": (
        ("SIM_GPS1_ENABLE", mavlink.MAV_PARAM_TYPE_INT8, 0.0, 1.0),
        ("SIM_GPS_DISABLE", mavlink.MAV_PARAM_TYPE_INT8, 1.0, 0.0),  # before 4.7
    ),
    "px4": (("SIM_GPS_USED", mavlink.MAV_PARAM_TYPE_INT32, 0.0, 1.4e-44),),
}
CONFIG = '[requirement]\ntarget_speed_max_m_s = 4\n[link]\ntake_over_from = ["RTL", "failsafe"]\n'
PILOTS_MODE = {"arduplane": (12, "LOITER"), "px4": (0x03040000, "LOITER")}


class Flown:
    """A real autopilot with payload and target, a relay before it, and launches through that."""

    def __init__(self, flavour, relay, folder, truth):
        self.flavour, self.relay, self._folder, self._truth = flavour, relay, folder, truth
        self._config = configured(folder / "mission.toml", flavour, CONFIG)
        self._launches = 0

    def launch(self, *options, **more):
        self._launches += 1
        self.relay.change = unchanged
        self.relay.spoil(GOOD)
        return Application(self.relay.url, self._folder / str(self._launches), str(self._config), *options, **more)

    def wait(self, seconds):
        """Let this much of the vehicle's time go by."""
        time.sleep(seconds / SPEED)

    @property
    def now_s(self):
        """Time on the vehicle's clock."""
        return self.relay.time_boot_ms / 1000.0

    def nearest_m(self, since_s):
        """Return the least true distance to the target since then."""
        with self._truth.open() as file:
            rows = [row for row in csv.DictReader(file) if row["slant_range_m"] and row["bearing_deg"]]
        return min(float(row["slant_range_m"]) for row in rows if float(row["time_boot_s"]) >= since_s)

    @property
    def commanded(self):
        return sum(self.relay.commanded[kind] for kind in COMMANDING)


@pytest.fixture(params=FLAVOURS, scope="module")
def flown(request, tmp_path_factory):
    flavour, folder = request.param, tmp_path_factory.mktemp(request.param)
    truth = folder / "truth.csv"
    with (
        RealVehicle(flavour, "--speed", SPEED, "--target", "circle", "--truth", truth) as vehicle,
        ChangingRelay(vehicle.urls[0]) as relay,
    ):
        yield Flown(flavour, relay, folder, truth)


@pytest.fixture
def launch(flown):
    with ExitStack() as begun:
        yield lambda *options, **more: begun.enter_context(flown.launch(*options, **more))


@pytest.fixture
def watching(launch):
    one = launch()
    one.wait_for(WATCHED)
    return one


# -- whoever is there, before anything is armed ------------------------------------------------------------------


def refused(flown, launch, change, *words):
    one = launch()
    flown.relay.change = change
    armed, uploads = flown.relay.armed, flown.relay.commanded["MISSION_COUNT"]
    assert one.process.wait(PATIENCE_S) == 2, one.announced
    for each in words:
        assert each in one.announced
    assert flown.relay.armed == armed
    assert flown.relay.commanded["MISSION_COUNT"] == uploads


def test_a_second_vehicle_with_another_id_is_listed_and_refused(flown, launch):
    def alongside(message):
        yield from unchanged(message)
        if message.get_type() in VEHICLE and message.get_srcComponent() == 1:
            yield 0.0, packed(message, system_id=7)

    refused(
        flown,
        launch,
        alongside,
        "several vehicles share the link",
        "system 7 (",
        "select one with --set link.system_id",
    )


def test_a_second_vehicle_with_the_same_id_is_reported_before_anything_is_armed(flown, launch):
    numbers = itertools.count()

    def alongside(message):
        yield from unchanged(message)
        if message.get_type() in VEHICLE and message.get_srcComponent() == 1:
            yield 0.0, packed(message, seq=next(numbers) % 256)

    refused(flown, launch, alongside, "two vehicles speak with the same system id")


# -- in flight -----------------------------------------------------------------------------------------------


def test_a_signal_in_the_climb_lets_it_fly_to_its_first_circle(flown, launch):
    one = launch()
    one.wait_for("taking off")
    flown.wait(8.0)
    summary = one.end(signal.SIGINT)
    assert one.process.returncode == 130
    assert "interrupted by SIGINT: the aircraft flies to its first circle and stays on it." in one.announced
    assert summary["outcome"] == "interrupted"
    flown.wait(60.0)
    assert flown.relay.armed
    assert flown.relay.mode == MISSION_MODE[flown.flavour]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_it_circling_and_reports_so(flown, launch, number):
    one = launch()
    one.wait_for(WATCHED)
    flown.wait(10.0)
    summary = one.end(number)
    assert one.process.returncode == 130
    assert f"interrupted by {number.name}: {GOES_ON}" in one.announced
    assert summary["outcome"] == "interrupted"
    flown.wait(10.0)
    assert flown.relay.mode == MISSION_MODE[flown.flavour]


@pytest.mark.parametrize("lost", ["a reader", "space"])
def test_a_terminal_that_cannot_be_written_does_not_reach_the_flight(flown, launch, lost):
    if lost == "space":
        stdout = os.open("/dev/full", os.O_WRONLY)
    else:
        reading, stdout = os.pipe()
        os.close(reading)
    one = launch("--duration", "20", stdout=stdout)
    os.close(stdout)
    assert one.process.wait(PATIENCE_S) == 0, one.announced
    assert "the terminal could not be written" in one.announced
    assert one.end()["outcome"] == "completed"


def test_a_payload_an_hour_ahead_is_corrected(flown, launch):
    def ahead(message):
        if message.get_type() in PAYLOAD:
            yield 0.0, packed(message, time_boot_ms=message.time_boot_ms + 3_600_000)
        else:
            yield from unchanged(message)

    one = launch()
    flown.relay.change = ahead
    one.wait_for("3600 s ahead: corrected")
    one.wait_for(WATCHED)
    one.wait_for("the target is in sight")
    flown.wait(60.0)
    summary = one.end()
    assert summary["rejected"] < 0.06 * summary["sightings"]
    assert "has not been seen" not in one.announced


def test_a_position_that_jumps_is_bridged_and_a_longer_jump_rejected(flown, watching):
    def away(message):
        if message.get_type() == "GLOBAL_POSITION_INT":
            yield 0.0, packed(message, lat=message.lat + 135_000)  # 1.5 km
        else:
            yield from unchanged(message)

    watching.wait_for("the target is in sight")
    flown.relay.change = away
    flown.wait(1.5)
    flown.relay.change = unchanged
    watching.wait_for("the position jumped by")
    flown.wait(20.0)
    assert "holding the circle" not in watching.announced
    flown.relay.change = away
    watching.wait_for("holding the circle, nothing is decided on it")
    flown.relay.change = unchanged
    watching.wait_for("the aircraft's position is accepted again")
    flown.wait(20.0)
    summary = watching.end()
    assert summary["min_range_m"] > 90.0
    assert summary["outcome"] == "interrupted"


def test_single_wrong_words_mislead_no_one(flown, watching):
    watching.wait_for("the target is in sight")
    flown.wait(5.0)
    now_ms = flown.relay.time_boot_ms
    for kind, wrong in (
        ("GLOBAL_POSITION_INT", {"time_boot_ms": now_ms + 3_600_000}),
        ("GLOBAL_POSITION_INT", {"time_boot_ms": 2**32 - 1}),
        ("GLOBAL_POSITION_INT", {"lat": -450_000_000, "lon": 1_700_000_000}),
        ("ATTITUDE", {"time_boot_ms": 2**32 - 1}),
        ("DISTANCE_SENSOR", {"time_boot_ms": now_ms + 3_600_000}),
        ("GIMBAL_DEVICE_ATTITUDE_STATUS", {"time_boot_ms": 2**32 - 1}),
    ):
        flown.relay.once(kind, wrong)
        flown.wait(4.0)
    flown.relay.announce(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, 4), component_id=191)
    flown.relay.announce(mavlink.MAVLink_wind_message(90.0, 300.0, 0.0), component_id=191)
    flown.relay.announce(mavlink.MAVLink_statustext_message(2, b"\x1b[31m\xff\xfe"), component_id=191)
    flown.wait(30.0)
    assert "holding the circle" not in watching.announced
    assert "has not been seen" not in watching.announced
    summary = watching.end()
    assert summary["outcome"] == "interrupted", watching.announced
    assert "\x1b[31m" not in watching.announced
    assert summary["min_range_m"] > 90.0


def test_a_receiver_without_a_fix_holds_the_circle(flown, watching):
    name, kind, off, on = next(one for one in RECEIVER[flown.flavour] if flown.relay.has_parameter(one[0]))
    watching.wait_for("the target is in sight")
    flown.relay.set_parameter(name, off, kind)
    try:
        watching.wait_for("holding the circle, nothing is decided on it")
        flown.wait(5.0)
    finally:
        flown.relay.set_parameter(name, on, kind)
    watching.wait_for("the aircraft's position is accepted again")
    flown.wait(20.0)
    assert watching.end()["outcome"] == "interrupted", watching.announced


def test_late_words_of_what_is_flown_end_in_no_yield(flown, launch):
    def late(message):
        delay_s = 3.0 / SPEED if message.get_type() == "MISSION_CURRENT" else 0.0
        yield delay_s, bytes(message.get_msgbuf())

    one = launch("--planner", "paper", program=WANDERING)
    one.wait_for(WATCHED)
    flown.relay.change = late
    flown.wait(150.0)
    reported_as_flown(one)


def test_plan_changes_over_a_slow_and_lossy_link_are_reported_as_flown(flown, launch):
    one = launch("--planner", "paper", program=WANDERING)
    one.wait_for(WATCHED)
    flown.relay.spoil(LinkFaults(loss=0.05, delay_s=1.0 / SPEED))
    flown.wait(250.0)
    flown.relay.spoil(GOOD)
    flown.wait(20.0)
    reported_as_flown(one)


def reported_as_flown(one):
    summary = one.end()
    assert summary["outcome"] == "interrupted", one.announced
    events = list(JournalReader(one.run / "journal.jsonl", JOURNAL_TYPES))
    activated = [event.number for event in events if isinstance(event, ActivatePlan)]
    departed = {event.number for event in events if isinstance(event, PlanStatus) and event.stage == "departed"}
    print(f"{len(activated)} plans activated, {len(set(activated) & departed)} reported as flown")
    assert activated
    assert set(activated[:-1]) <= departed  # the last may still have been on its way


def of_laser(message):
    """Return whether a message is the payload's range, and not PX4's own distance to the ground."""
    is_range = message.get_type() == "DISTANCE_SENSOR"
    return is_range and message.orientation == mavlink.MAV_SENSOR_ROTATION_CUSTOM


def of_gimbal(message):
    return message.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS"


def of_position(message):
    return message.get_type() == "GLOBAL_POSITION_INT"


def repeated(field):
    """Return a change that repeats the first value of each device."""
    first = {}
    return lambda message: {field: first.setdefault(message.get_srcComponent(), getattr(message, field))}


# The messages that change, what becomes of them (None: they are lost), the reported input, and words of the report.
INPUT_FAULTS = {
    "stuck range": (of_laser, lambda: repeated("current_distance"), Input.LASER, "it repeats the same range"),
    "range in a tenth": (
        of_laser,
        lambda: lambda message: {"current_distance": round(message.current_distance / 10.0)},
        Input.LASER,
        "correct its unit",
    ),
    "wrong flags": (of_gimbal, lambda: lambda _message: {"flags": 44}, Input.GIMBAL, "its frame flags are wrong"),
    "frozen gimbal": (of_gimbal, lambda: repeated("q"), Input.GIMBAL, "its orientation is frozen"),
    "silent position": (of_position, lambda: None, Input.POSITION, "no position from the autopilot"),
}


@pytest.mark.parametrize("fault", INPUT_FAULTS)
def test_an_input_fault_is_reported_and_the_range_is_kept(flown, watching, fault):
    changes, made, kind, words = INPUT_FAULTS[fault]
    fields_of = made()

    def faulty(message):
        if not changes(message):
            yield from unchanged(message)
        elif fields_of is not None:
            yield 0.0, packed(message, **fields_of(message))

    watching.wait_for("the target is in sight")
    flown.wait(60.0)
    begin_s = flown.now_s
    flown.relay.change = faulty
    watching.wait_for(words)
    flown.wait(FAULT_S)
    flown.relay.change = unchanged
    watching.wait_for("is received again" if fault == "silent position" else "agrees again")
    flown.wait(20.0)
    nearest_m = flown.nearest_m(begin_s)
    summary = watching.end()
    events = JournalReader(watching.run / "journal.jsonl", JOURNAL_TYPES)
    found_s = [one.time_s for one in events if isinstance(one, HealthChanged) and one.input is kind]
    reported_s = min(time_s - begin_s for time_s in found_s if time_s > begin_s)
    print(f"{flown.flavour} {fault}: reported after {reported_s:.1f} s, least true range {nearest_m:.0f} m")
    assert summary["outcome"] == "interrupted", watching.announced
    assert reported_s <= REPORTED_WITHIN_S
    assert nearest_m >= NEAREST_M


def with_yaw_turned(message):
    """Return the orientation of a gimbal whose mounting is turned by 90 degrees to the right."""
    w, x, y, z = message.q
    half = math.sqrt(0.5)
    return {"q": [half * (w - z), half * (x - y), half * (y + x), half * (z + w)]}


# The messages that change, what becomes of them, the report, and the error in it.
LARGE_ERRORS = {
    "ranges 1.5 times the distance": (
        of_laser,
        lambda message: {"current_distance": min(round(1.5 * message.current_distance), 65_535)},
        r"the laser's ranges are about (\S+) times the distance",
        1.5,
    ),
    "yaw off by 90 degrees": (
        of_gimbal,
        with_yaw_turned,
        r"the gimbal's yaw is off by about (\S+) degrees, and corrected",
        90.0,
    ),
}


@pytest.mark.parametrize("error", LARGE_ERRORS)
def test_a_large_error_is_reported_and_corrected(flown, watching, error):
    changes, fields_of, report, value = LARGE_ERRORS[error]

    def erring(message):
        yield from [(0.0, packed(message, **fields_of(message)))] if changes(message) else unchanged(message)

    watching.wait_for("the target is in sight")
    flown.wait(60.0)
    begin_s = flown.now_s
    flown.relay.change = erring
    watching.wait_for(report.split(" (")[0])
    after_s = flown.now_s - begin_s
    flown.wait(60.0)
    nearest_m = flown.nearest_m(begin_s)
    assert watching.end()["outcome"] == "interrupted", watching.announced
    found = re.findall(report, watching.announced)
    print(f"{flown.flavour} {error}: {found} after {after_s:.0f} s, least true range {nearest_m:.0f} m")
    assert float(found[-1]) == pytest.approx(value, rel=0.1)
    assert nearest_m >= NEAREST_M


# -- another station flies -------------------------------------------------------------------------------------


def yielded(flown, one, act, *words):
    one.wait_for("the target is in sight")
    flown.wait(10.0)
    act()
    one.wait_for(NO_MORE)
    flown.wait(3.0)
    before = flown.commanded
    flown.wait(20.0)
    assert flown.commanded == before
    summary = one.end()
    assert summary["outcome"].startswith("yielded")
    for each in words:
        assert each in summary["outcome"]


def test_another_station_changes_the_mode(flown, watching):
    number, name = PILOTS_MODE[flown.flavour]
    main, sub = (number, 0) if flown.flavour == "arduplane" else (number >> 16 & 0xFF, number >> 24)
    yielded(flown, watching, lambda: flown.relay.command(mavlink.MAV_CMD_DO_SET_MODE, 1, main, sub), f"to {name}")


def test_another_station_uploads_a_mission(flown, watching):
    def upload():
        latitude_e7, longitude_e7 = flown.relay.place
        frame, commands = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, ((16, 0.0), (16, 0.0), (17, 90.0))
        flown.relay.upload(
            [
                mavlink.MAVLink_mission_item_int_message(
                    *(flown.relay.system_id, 1, seq, frame, command, int(seq == 0), 1),
                    *(0.0, 0.0, radius_m, 0.0, latitude_e7 + 10_000, longitude_e7, 100.0),
                )
                for seq, (command, radius_m) in enumerate(commands)
            ]
        )

    # A mission without a landing makes PX4 loiter at once.
    yielded(flown, watching, upload, {"arduplane": "mission", "px4": "changed to LOITER"}[flown.flavour])


def test_a_second_vehicle_with_the_same_id_that_comes_later_is_yielded_to(flown, watching):
    def alongside(message):
        yield from unchanged(message)
        if message.get_type() in ("GLOBAL_POSITION_INT", "ATTITUDE"):
            moved = {"lat": message.lat + 20_000} if message.get_type() == "GLOBAL_POSITION_INT" else {}
            yield 0.0, packed(message, time_boot_ms=message.time_boot_ms + 400_000, **moved)

    def come():
        flown.relay.change = alongside

    yielded(flown, watching, come, "two vehicles speak with the same system id")
