"""The first launch of a newcomer: a target that moves, a page that opens, a console that does not chatter."""

from __future__ import annotations

import io
import socket
from dataclasses import replace

import pytest
from rich.console import Console

from sidelong.app.commands import launch as command
from sidelong.app.config import Config, with_values
from sidelong.app.view import address, display
from sidelong.app.view.address import PageAddress, free_port, is_desktop
from sidelong.app.view.panel import Panel, target_motion
from sidelong.mission.core.events import Announce


@pytest.mark.parametrize(
    ("variables", "terminal", "desktop"),
    [
        ({"DISPLAY": ":0"}, True, True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, True, True),
        ({}, True, False),
        ({"DISPLAY": ":0"}, False, False),
    ],
)
def test_a_desktop_is_a_display_and_a_terminal(monkeypatch, variables, terminal, desktop):
    monkeypatch.setattr(address.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(address.sys, "stdout", type("Out", (io.StringIO,), {"isatty": lambda _self: terminal})())
    assert is_desktop() is desktop


@pytest.mark.parametrize(
    ("view", "silent", "shown"), [(None, False, True), (None, True, False), (False, False, False)]
)
def test_the_map_is_shown_unless_it_was_declined(monkeypatch, view, silent, shown):
    monkeypatch.setattr(command, "is_desktop", lambda: True)
    found = command._map_address(view, silent, with_values(Config(), {"display": {"port": 0}}, "test"))
    assert (found is not None) is shown
    assert found is None or found.opens_browser


def test_a_map_that_was_asked_for_opens_no_browser():
    found = command._map_address(True, False, Config())
    assert not found.opens_browser


def test_a_port_in_use_does_not_keep_the_page_away():
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert free_port(server.getsockname()[1]) == 0
    assert free_port(0) == 0


@pytest.mark.parametrize("opens", [True, False])
def test_the_browser_is_opened_at_the_page(monkeypatch, opens):
    import asyncio  # noqa: PLC0415  # its own loop, in this test only

    opened = []
    monkeypatch.setattr(display.webbrowser, "open", opened.append)
    view = display.ViewDisplay(
        {"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(port=0, opens_browser=opens)
    )

    async def shown() -> str:
        async with display.served(view, lambda _text: None) as page:
            while opens and not opened:
                await asyncio.sleep(0)
            return page.url

    url = asyncio.run(shown())
    assert opened == ([url] if opens else [])


def test_a_console_without_a_panel_prints_each_decision_but_the_state_only_now_and_then(snapshot):
    written = io.StringIO()
    with Panel(Console(file=written, width=200)) as terminal:
        panel = terminal.of()
        panel.watching_began(snapshot.time_s, 1200.0)
        for second in range(600):
            if second % 100 == 50:
                panel.say(Announce(snapshot.time_s + second, "decision", f"moving {second}"))
            panel.show(replace(snapshot, time_s=snapshot.time_s + second))
    printed = written.getvalue().splitlines()
    assert sum("moving" in line for line in printed) == 6
    assert sum("range" in line for line in printed) == 10


def test_a_standing_target_has_no_course(snapshot):
    still = replace(snapshot.estimate, velocity_east_m_s=0.1, velocity_north_m_s=0.1)
    assert target_motion(replace(snapshot, estimate=still)) == "standing"
    assert "m/s to" in target_motion(snapshot)
