"""The terminal and the live map of a fleet."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from app.config import Config
from app.view.address import Address
from app.view.fleet_panel import FleetPanel
from app.view.fleet_view import FleetView
from estimators.frames import LocalPlane
from mission.core.events import Announce, MissionChange, OperatorRequest
from mission.core.requirement import Side

PLANE = LocalPlane(47.4, 8.5)
NAMES = ("plane", "wing")


@pytest.fixture(scope="module")
def snapshot(flight):
    *_, (_, _, controller) = flight(20.0)
    return controller.snapshot()


@pytest.fixture
def view():
    """Return a fleet's map without a page, and the wishes that reach each aircraft."""
    panel = FleetPanel(Console(file=io.StringIO()), quiet=True)
    made = FleetView(panel, NAMES, Config(), Address(port=0))
    wishes: dict[str, list] = {name: [] for name in NAMES}
    for name in NAMES:
        made.of(name).begin(PLANE, wishes[name].append)
    return made, wishes


def beside(snapshot):
    aircraft = replace(snapshot.aircraft, east_m=snapshot.aircraft.east_m + 300.0)
    return replace(snapshot, aircraft=aircraft, time_s=snapshot.time_s + 50.0)


def test_what_is_said_names_the_aircraft(snapshot):
    out = io.StringIO()
    with FleetPanel(Console(file=out, width=200)) as panel:
        plane, _ = (panel.of(name) for name in NAMES)
        panel.note("starting")
        plane.note("connecting")
        plane.engage(snapshot.time_s - 61.0, None)
        plane.say(Announce(snapshot.time_s, "decision", "moving"))
        plane.show(snapshot)
    said = out.getvalue().splitlines()
    assert said[:3] == ["starting", "plane: connecting", "   1:01  plane: moving"]
    assert said[3].startswith("   1:01  plane: watching AUTO  left side  range ")


def test_a_button_is_for_all_each_at_its_own_time(view, snapshot):
    shown, wishes = view
    other = beside(snapshot)
    shown.of("plane").show(snapshot)
    shown.of("wing").show(other)
    shown._pressed({"action": "hold", "side": None, "who": "operator 1"})
    assert wishes == {
        "plane": [OperatorRequest(snapshot.time_s, "hold", None, "operator 1")],
        "wing": [OperatorRequest(other.time_s, "hold", None, "operator 1")],
    }


@pytest.mark.parametrize("wish", [OperatorRequest(1.0, "side", Side.RIGHT), MissionChange(1.0, height_m=160.0)])
def test_what_would_bring_them_together_is_refused(view, snapshot, wish):
    shown, wishes = view
    shown.of("plane").show(snapshot)
    shown._request(wish)
    assert wishes == {"plane": [], "wing": []}


def test_the_map_draws_the_others_with_their_circles(browser, snapshot):
    panel = FleetPanel(Console(file=io.StringIO()), quiet=True)
    with FleetView(panel, NAMES, Config(), Address(port=0)) as shown:
        for name, one in zip(NAMES, (snapshot, beside(snapshot)), strict=True):
            shown.of(name).begin(PLANE, lambda _wish: None)
            shown.of(name).show(one)
        shown.pump()
        page = browser.new_page()
        page.goto(shown.url)
        page.locator("#map .label", has_text="wing, 100 m").wait_for()
        assert page.locator("#map path.aircraft").count() == 2
        assert page.locator("#map path.aircraft.other").count() == 1
        circle = page.locator("#map circle.circle.other")
        assert float(circle.get_attribute("r")) == pytest.approx(snapshot.present.circle.radius_m)
        page.close()
