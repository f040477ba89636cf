"""Print what was flown on which program as the README's table, after a run with your own programs.

    SIDELONG_PROGRAMS=FOLDER python -m pytest tests/autopilot
    SIDELONG_PROGRAMS=FOLDER SIDELONG_TARGETS=FOLDER python -m pytest tests/autopilot tests/bench/test_real_flights.py

Each program in the folder that is called ``arduplane`` or ``px4`` is flown; PX4 needs its ``etc`` near its ``bin``.
The name of a row is what the program reports of itself.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.mission.core.events import PlanStatus, UploadPlan
from tests.autopilot.real_vehicle import ROOT, Program

HEADER = (
    "| program | tests passed | flight | on side | in band | moves per hour | upload, median | remarks |",
    "| --- | --- | --- | --- | --- | --- | --- | --- |",
)
_PROGRAM, _VERSION, _FLIGHT, _TEST = "program", "version", "flight", "test"


def version_of(url: str) -> str:
    """Return name, release and commit of the vehicle at a URL, as ``sidelong connect`` reads them."""
    command = [sys.executable, "-m", "sidelong.app", "connect", url, "--listen", "0.5", "--json", "-"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=ROOT, check=False)
    assert done.returncode in (0, 1), done.stderr  # 1: it is not ready to fly
    found = json.loads(done.stdout)
    return f"{found['autopilot']} {found['release']} ({found['commit']})"


def upload_s(journal: Path) -> float:
    """Return the median time from a plan's upload to its confirmation on board, of the vehicle's clock; inf: none."""
    begun_s, took_s = {}, []
    for record in JournalReader(journal, JOURNAL_TYPES):
        if isinstance(record, UploadPlan):
            begun_s[record.number] = record.time_s
        elif isinstance(record, PlanStatus) and record.stage == "ready" and record.number in begun_s:
            took_s.append(record.time_s - begun_s[record.number])
    return median(took_s) if took_s else float("inf")


def flight_row(name: str, side: float, band: float, moves_per_hour: float, uploads_s: float) -> dict[str, Any]:
    """Return one flight's cells, which a test records by ``record_property("flight", ...)``."""
    upload = f"{uploads_s:.2f} s" if 0.0 < uploads_s < float("inf") else "-"  # a command is no upload
    cells = f"{100 * side:.1f} %", f"{100 * band:.1f} %", f"{moves_per_hour:.0f}", upload
    return {"name": name, "cells": cells}


def rows(reports: Iterable[tuple[str, Sequence[tuple[str, Any]]]]) -> Iterator[str]:
    """Return the table's rows.

    Args:
        reports: Outcome of each test (passed, failed, error) with what it recorded.
    """
    outcomes: dict[str, Counter[str]] = defaultdict(Counter)
    versions: dict[str, str] = {}
    flights: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    remarks: dict[str, list[str]] = defaultdict(list)
    for outcome, properties in reports:
        recorded = dict(properties)
        if _PROGRAM not in recorded:
            continue
        name = str(recorded[_PROGRAM])
        outcomes[name][outcome] += 1
        versions[name] = recorded.get(_VERSION, versions.get(name, name))
        flights[name] += [value for key, value in properties if key == _FLIGHT]
        if outcome != "passed":
            remarks[name].append(f"{outcome}: {recorded[_TEST]}")
    for name, counts in outcomes.items():
        passed = f"{counts['passed']} of {counts.total()}"
        for number, one in enumerate(flights[name] or [{"name": "-", "cells": ("-",) * 4}]):
            head = (versions[name], passed) if number == 0 else ("", "")
            last = "; ".join(remarks[name]) if number == 0 else ""
            yield "| " + " | ".join((*head, one["name"], *one["cells"], last)) + " |"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note in each report which program was flown."""
    report = yield
    given = getattr(getattr(item, "callspec", None), "params", {}).values()
    program = next((one for one in given if isinstance(one, Program) and one.path), None)
    if program is not None:
        report.user_properties += [(_PROGRAM, program.label), (_TEST, item.name)]
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the table."""
    stats = terminalreporter.stats
    reports = [
        (outcome, one.user_properties)
        for outcome in ("passed", "failed", "error")
        for one in stats.get(outcome, ())
        if isinstance(one, pytest.TestReport)  # else a file that cannot be imported
    ]
    lines = list(rows(reports))
    if lines:
        terminalreporter.section("programs flown")
        for line in (*HEADER, *lines):
            terminalreporter.write_line(line)
