"""The table of programs that were flown."""

import math

from sidelong.app.flight.recording import JOURNAL_TYPES  # noqa: F401  # the journal's records are registered by it
from sidelong.app.records.journal import Header, JournalWriter
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import PlanStatus, UploadPlan
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Wind
from tests.autopilot.matrix import flight_row, rows, upload_s
from tests.autopilot.real_vehicle import Program, programs

CIRCLE = Circle(0.0, 0.0, 80.0, True)


def test_each_program_has_its_version_tests_flights_and_failures():
    flown = ("flight", flight_row("mission, 5 minutes", 0.912, 1.0, 61.7, 0.183))
    reports = [
        ("passed", [("version", "ArduPlane 4.6.3 (3fc7011a)"), flown, ("program", "a"), ("test", "test_a_flight")]),
        ("passed", [("program", "a"), ("test", "test_of_faults")]),
        ("passed", [("program", "a"), ("flight", flight_row("command, 5 minutes", 1.0, 1.0, 12.0, 0.0))]),
        ("failed", [("program", "b"), ("test", "test_of_faults[b]")]),
        ("passed", []),  # of a simulated vehicle
    ]
    assert list(rows(reports)) == [
        "| ArduPlane 4.6.3 (3fc7011a) | 3 of 3 | mission, 5 minutes | 91.2 % | 100.0 % | 62 | 0.18 s |  |",
        "|  |  | command, 5 minutes | 100.0 % | 100.0 % | 12 | - |  |",
        "| b | 0 of 1 | - | - | - | - | - | failed: test_of_faults[b] |",
    ]


def test_without_a_program_of_your_own_there_is_no_table():
    assert list(rows([("passed", [])])) == []


def test_the_median_upload_is_counted_from_the_order_to_the_confirmation(tmp_path):
    path = tmp_path / "journal.jsonl"
    writer = JournalWriter(path, Header("test", {}, None, {}), lambda text: None)
    for number, (begun_s, ready_s) in enumerate([(10.0, 10.2), (20.0, 20.6), (30.0, 30.4)]):
        plan = Plan(CIRCLE)
        writer.write(UploadPlan(begun_s, number, plan, CIRCLE, plan, Wind(0.0, 0.0), ""))
        writer.write(PlanStatus(ready_s, number, "ready"))
    writer.write(UploadPlan(40.0, 9, plan, CIRCLE, plan, Wind(0.0, 0.0), ""))  # never confirmed
    writer.close()
    assert math.isclose(upload_s(path), 0.4)


def test_programs_are_found_by_their_names_in_a_folder(tmp_path):
    for name in ("4.6.3/arduplane", "1.16.2/bin/px4", "1.16.2/etc/rcS"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    (tmp_path / "px4").mkdir()
    found = [param.values[0] for param in programs({"SIDELONG_PROGRAMS": str(tmp_path)})]
    assert [(str(one), one.label) for one in found] == [("px4", "1.16.2/bin/px4"), ("arduplane", "4.6.3/arduplane")]
    assert {"arduplane": 1}[found[1]] == 1


def test_without_a_folder_each_flavour_is_skipped_or_flown_by_the_named_program():
    found = [param.values[0] for param in programs({"SIDELONG_PX4": "/opt/px4"})]
    assert [(one, one.path and str(one.path)) for one in found] == [("arduplane", None), ("px4", "/opt/px4")]
    assert isinstance(found[0], Program)
