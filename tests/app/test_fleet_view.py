"""The terminal and the live map of a fleet."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.fleet.panel import FleetPanel
from sidelong.app.fleet.view import FleetView
from sidelong.app.view.address import Address
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Side

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


def alongside(snapshot):
    aircraft = replace(snapshot.aircraft, east_m=snapshot.aircraft.east_m + 300.0)
    return replace(snapshot, aircraft=aircraft, time_s=snapshot.time_s + 50.0)


def test_what_is_reported_names_the_aircraft(snapshot):
    out = io.StringIO()
    with FleetPanel(Console(file=out, width=200)) as panel:
        plane, _ = (panel.of(name) for name in NAMES)
        panel.note("starting")
        plane.note("connecting")
        plane.engage(snapshot.time_s - 61.0, None)
        plane.say(Announce(snapshot.time_s, "decision", "moving"))
        plane.show(snapshot)
    announced = out.getvalue().splitlines()
    assert announced[:3] == ["starting", "plane: connecting", "   1:01  plane: moving"]
    assert announced[3].startswith("   1:01  plane: watching AUTO  left side  range ")


def test_a_button_is_for_all_each_at_its_own_time(view, snapshot):
    shown, wishes = view
    other = alongside(snapshot)
    shown.of("plane").show(snapshot)
    shown.of("wing").show(other)
    shown._pressed({"action": "hold", "side": None, "who": "operator 1"})
    assert wishes == {
        "plane": [OperatorRequest(snapshot.time_s, "hold", None, "operator 1")],
        "wing": [OperatorRequest(other.time_s, "hold", None, "operator 1")],
    }


@pytest.mark.parametrize("wish", [MissionChange(1.0, side="right"), MissionChange(1.0, height_m=160.0)])
def test_what_would_bring_them_together_is_refused(view, snapshot, wish):
    shown, wishes = view
    shown.of("plane").show(snapshot)
    shown._request(wish)
    assert wishes == {"plane": [], "wing": []}


def test_a_band_is_changed_for_all_each_at_its_own_time(view, snapshot):
    shown, wishes = view
    other = alongside(snapshot)
    shown.of("plane").show(snapshot)
    shown.of("wing").show(other)
    shown._pressed({"action": "change", "values": {"range_min_m": 150}, "who": "operator 1"})
    (one,), (two,) = wishes.values()
    assert (one.time_s, two.time_s) == (snapshot.time_s, other.time_s)
    assert one.range_min_m == two.range_min_m == 150.0


class Requests:
    """Takes down what a person asked of the fleet, and refuses what it is ordered to."""

    def __init__(self, refused=""):
        self.asked, self.refused = [], refused

    def watch_from(self, side, who):
        self.asked.append((side, who))
        return self.refused

    def relieve(self, name, who):
        self.asked.append((name, who))
        return self.refused


@pytest.mark.parametrize("refused", ["", "nothing is flown yet"])
def test_the_side_is_asked_of_the_fleet_and_shown_once_it_is_given(view, snapshot, refused):
    shown, wishes = view
    shown.requests = Requests(refused)
    shown.of("plane").show(replace(snapshot, side=Side.RIGHT))  # its role: the other side
    assert shown._update()["state"]["wanted"] == Side.LEFT
    shown._pressed({"action": "side", "side": "right", "who": "operator 1"})
    assert shown.requests.asked == [(Side.RIGHT, "operator 1")]
    assert shown._update()["state"]["wanted"] == (Side.LEFT if refused else Side.RIGHT)
    assert wishes == {"plane": [], "wing": []}


@pytest.fixture
def page(browser, view, snapshot):
    """Return the page of a fleet in flight."""
    shown, _ = view
    shown.requests = Requests()
    with shown:
        for name, one in zip(NAMES, (snapshot, alongside(snapshot)), strict=True):
            shown.of(name).show(one)
        shown.pump()
        opened = browser.new_page()
        opened.goto(shown.url)
        yield opened
        opened.close()


def test_one_aircraft_is_relieved_by_a_button_of_its_own(view, page):
    shown, _ = view
    page.get_by_role("button", name="Relieve wing").click()
    page.get_by_role("dialog").get_by_role("button", name="Yes").click()
    while not shown.requests.asked:
        shown.pump()
    assert [name for name, _ in shown.requests.asked] == ["wing"]


def test_the_map_draws_the_others_with_their_circles(page, snapshot):
    page.locator("#map .label", has_text="wing, 100 m").wait_for()
    assert page.locator("#map path.aircraft").count() == 2
    assert page.locator("#map path.aircraft.other").count() == 1
    circle = page.locator("#map circle.circle.other")
    assert float(circle.get_attribute("r")) == pytest.approx(snapshot.present.circle.radius_m)


def test_of_several_targets_the_page_names_each_and_whose_decisions_are_reported(snapshot):
    panel = FleetPanel(Console(file=io.StringIO()), quiet=True)
    shown = FleetView(panel, NAMES, Config(), Address(port=0), {"boat": Side.LEFT, "bike": Side.RIGHT})
    for name, target in zip(NAMES, ("boat", "bike"), strict=True):
        shown.of(name).begin(PLANE, lambda _wish: None)
        shown.of(name).show(replace(snapshot, target=target))
    state = shown._state(replace(snapshot, target="boat"), 0.0)
    assert state["target"]["name"] == "boat"
    assert [one["name"] for one in state["targets"]] == ["bike"]
    shown.of("plane").say(Announce(snapshot.time_s, "decision", "moving"))
    assert shown._announced[-1][1:] == ["decision", "plane: moving"]
