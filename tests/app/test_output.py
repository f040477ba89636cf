"""What is printed: texts of strangers are made plain, and a terminal that fails is reported once and left."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from rich.console import Console

from sidelong.app.analysis.summary import SummaryCollector
from sidelong.app.analysis.truth import Truth
from sidelong.app.cli import run
from sidelong.app.commands.output import share_progress, shielded_output, standard
from sidelong.app.config import load_config
from sidelong.app.link.message import plain, plain_fields
from sidelong.app.view.panel import Panel
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Announce


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("PreArm: Gyros", "PreArm: Gyros"),
        ("\x1b]0;title\x07\x1b[2Jgone", "?]0;title??[2Jgone"),
        ("two\nlines\tand more\r", "two lines and more"),
        ("right\u202eto left, \x9b31m", "right?to left, ?31m"),
        ("Höhe 3°", "Höhe 3°"),
    ],
)
def test_what_a_vehicle_reports_is_one_line_without_control_characters(text, shown):
    assert plain(text) == shown
    fields = plain_fields({"text": text, "severity": 2})
    assert (fields["text"].strip(), fields["severity"]) == (shown, 2)


def test_the_terminal_is_not_at_the_mercy_of_what_is_announced():
    written = io.StringIO()
    with Panel(Console(file=written, markup=False)) as terminal:
        panel = terminal.of()
        panel.note("\x1b[2J")
        panel.say(Announce(1.0, "plan", "plan 1 was not taken: \x1b[2J"))
    assert "\x1b" not in written.getvalue()


class Full(io.StringIO):
    encoding = "ascii"

    def write(self, text: str) -> int:
        raise OSError(28, "No space left on device")


def test_a_terminal_that_fails_is_an_error_but_for_a_flight(monkeypatch):
    monkeypatch.setattr(standard, "lost", None)
    monkeypatch.setattr("sys.stdout", Full())
    with pytest.raises(OSError, match="No space"):
        standard.write("x")
    with shielded_output():
        standard.write("x")
        standard.flush()
    assert standard.lost == "No space left on device"


@pytest.mark.parametrize("words", [["--help"], ["init"]])
def test_a_full_disk_under_the_output_is_one_sentence(monkeypatch, capsys, tmp_path, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(standard, "lost", None)
    monkeypatch.setattr("sys.stdout", Full())
    assert run(words) == 2
    announced = capsys.readouterr().err
    assert announced == "sidelong: the output cannot be written (No space left on device); free some space for it.\n"


def test_what_a_terminal_cannot_show_is_no_error(monkeypatch):
    written = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr("sys.stdout", written)
    standard.write("range ● 3°")
    written.flush()
    assert written.buffer.getvalue() == b"range ? 3?"


def test_a_name_with_brackets_is_no_markup(capsys):
    with share_progress("e6[/x]"):
        pass


def truth_at(times_s: list[float]) -> Truth:
    n = len(times_s)
    positions_deg = np.repeat([[47.4], [8.5], [47.401], [8.5]], n, axis=1)
    return Truth(np.array(times_s), positions_deg, np.full((2, n), np.nan), np.full(n, ""))


@pytest.mark.filterwarnings("error")
def test_a_flight_that_never_came_to_its_first_circle_has_a_summary():
    collector = SummaryCollector(load_config(None).requirement.requirement())
    truth = Truth(
        np.array([0.0, 0.5, 1.0]),
        np.array([[47.4] * 3, [8.5] * 3, [47.401] * 3, [8.5] * 3]),
        np.full((2, 3), np.nan),
        np.full(3, ""),
    )
    plane = LocalPlane(47.4, 8.5)
    assert list(truth.moments(plane, math.inf, 1.0, 0.5)) == []
    assert list(truth.moments(plane, 0.0, -math.inf, 0.5)) == []
    assert collector.scored(truth, plane, math.inf).time_in_band is None


def test_times_that_no_flight_has_make_no_more_moments_than_rows():
    truth = truth_at([0.0, 0.5, 1.0, 1e9, 1e9 + 0.5])
    found = [moment.time_s for moment in truth.moments(LocalPlane(47.4, 8.5), -math.inf, math.inf, 0.5)]
    assert found == [0.0, 0.5, 1e9]
    assert truth.at(1000.0, LocalPlane(47.4, 8.5)) is None
