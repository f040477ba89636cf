"""The terminal's panel, and the plain lines where there is no terminal."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from sidelong.app.view.panel import Panel
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import Announce
from sidelong.mission.core.inputs import Input, InputReport, InputState
from sidelong.mission.core.requirement import Requirement, Side

LEFT = Requirement(100.0, 500.0, Side.LEFT, 3.0)


@pytest.fixture(scope="module")
def snapshots(flight):
    return [controller.snapshot() for _, _, controller in flight(130.0)]


def drawn(*shown, terminal: bool, width: int = 100, quiet: bool = False) -> str:
    console = Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system=None)
    with Panel(console, quiet) as panel:
        display = panel.of()
        display.watching_began(100.0, 1200.0)
        display.note("connected")
        display.say(Announce(142.0, "decision", "moving 318 m east: in 42 s the target would be 533 m away"))
        for snapshot in shown:
            display.show(snapshot)
    return console.file.getvalue()


def test_without_a_terminal_there_is_a_line_a_minute(snapshots):
    lines = drawn(*snapshots, terminal=False).splitlines()
    assert lines[0] == "connected"
    assert lines[1] == "   0:42  moving 318 m east: in 42 s the target would be 533 m away"
    assert [line.split()[0] for line in lines[2:]] == ["0:00/20:00", "1:00/20:00", "2:00/20:00"]
    assert "watching AUTO" in lines[3]
    assert "track good" in lines[3]


def test_a_long_line_is_not_broken_for_a_file():
    assert "target would be 533 m away" in drawn(terminal=False, width=40)


@pytest.mark.parametrize("width", [60, 80, 140])
def test_the_panel_shows_the_essentials_at_any_width(snapshots, width):
    text = drawn(snapshots[-1], terminal=True, width=width)
    for word in ("watching", "2:09/20:00", "range", "m/s to", "track good", "moves 1", "laser", "gimbal", "link ok"):
        assert word in " ".join(text.replace("│", " ").split()), word
    assert max(map(len, text.splitlines())) <= width + 12  # control sequences


def test_the_panel_before_anything_is_seen(snapshots):
    text = drawn(snapshots[0], terminal=True)
    assert "not seen yet" in text
    assert "no laser" in text


def test_a_lost_link_is_reported(snapshots):
    last = snapshots[-1]
    text = drawn(replace(last, connected=False, phase=Phase.HOLDING), terminal=True)
    assert "link lost" in text
    assert "holding" in text


def test_inputs_that_are_not_ok_are_shown_with_their_time(snapshots):
    last = snapshots[-1]
    reports = [
        InputReport(one, InputState.STALE, last.time_s - 12.0, 1.0, "")
        for one in (Input.NEIGHBOURS, Input.CLOCK, Input.TERRAIN)
    ]
    shown = replace(last, health=tuple(reports))
    for terminal in (True, False):
        text = drawn(shown, terminal=terminal)
        assert "neighbours stale for 12 s" in text
        assert "clock stale for 12 s" in text
        assert "terrain stale for 12 s" in text


def test_quiet_reports_nothing(snapshots):
    assert drawn(*snapshots, terminal=False, quiet=True) == ""
    assert drawn(*snapshots, terminal=True, quiet=True) == ""
