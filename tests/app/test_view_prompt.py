"""What is typed at the terminal in flight."""

import asyncio
import io
import os
import pty
import termios

import pytest
from rich.console import Console

from sidelong.app.view.panel import HELP, WHO, Panel, Prompt, read_wish
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import MissionChange, OperatorRequest


@pytest.mark.parametrize(
    ("line", "wish"),
    [
        ("radius 80", MissionChange(0.0, radius_m=80.0, who=WHO)),
        ("band 120-450", MissionChange(0.0, range_min_m=120.0, range_max_m=450.0, who=WHO)),
        ("band 120 to 450, height 90.5", MissionChange(0.0, None, 120.0, 450.0, 90.5, who=WHO)),
        ("side 120-200", MissionChange(0.0, side="120-200", who=WHO)),
        (" hold ", OperatorRequest(0.0, "hold", who=WHO)),
        ("radius", None),
        ("radius -80", None),
        ("radius 80 m", None),
        ("radius nan", None),
        ("band 120", None),
        ("speed 12", None),
        ("radius 80,", None),
        ("", None),
    ],
)
def test_a_line_is_a_wish_or_is_not_understood(line, wish):
    assert read_wish(line) == wish


def typed(*lines: str) -> tuple[list, list[str]]:
    wishes: list = []
    prompt = Prompt(wishes.append)
    shown = []
    for line in lines:
        for key in line:
            prompt.key(key)
        shown.append(prompt.text)
    return wishes, shown


def test_a_change_is_asked_once_and_done_by_y_alone():
    wishes, shown = typed("cradius 80\r", "y", "y")
    assert shown == ["radius 80 m: y does it, any other key leaves it", HELP, HELP]
    assert wishes == [MissionChange(0.0, radius_m=80.0, who=WHO)]
    assert typed("cradius 80\r", "\r")[0] == []


def test_keys_do_nothing_before_c_and_after_escape():
    assert typed("radius 80\ry")[0] == []
    assert typed("cend\x1b\ry\ry")[0] == []


def test_what_is_typed_can_be_mended_and_is_reported_where_not_understood():
    wishes, shown = typed("cradios", "\x7f\x7fus 80", "\r", "y")
    assert shown[:2] == ["> radios", "> radius 80"]
    assert len(wishes) == 1
    _, shown = typed("cspeed 9\r")
    assert shown[0].startswith("not understood: 'speed 9'; > (radius 80 |")


@pytest.fixture(scope="module")
def snapshot(flight):
    return [controller.snapshot() for _, _, controller in flight(130.0)][-1]


def test_a_change_typed_at_a_terminal_reaches_the_flight(snapshot):
    operator, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)

    async def flown() -> MissionChange:
        wishes: asyncio.Queue[MissionChange] = asyncio.Queue()
        console = Console(file=io.StringIO(), force_terminal=True, width=100)
        with Panel(console, keyboard=terminal) as shown:
            panel = shown.of()
            panel.show(snapshot)
            panel.begin(LocalPlane(47.4, 8.5), wishes.put_nowait)
            assert not termios.tcgetattr(terminal)[3] & (termios.ECHO | termios.ICANON)
            os.write(operator, b"cside right\ry")
            return await asyncio.wait_for(wishes.get(), 10.0)

    assert asyncio.run(flown()) == MissionChange(snapshot.time_s, side="right", who=WHO)
    assert termios.tcgetattr(terminal) == before
    os.close(operator)
    os.close(terminal)
