"""The terminal and the live map of a fleet."""

from __future__ import annotations

import io
import itertools
import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.panel import Panel
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Alarm, VehicleStatus
from sidelong.mission.core.events import Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Side
from sidelong.mission.route.route import RouteProgress, route_of
from tests.app.conftest import SCHEMES, SIZES

PLANE = LocalPlane(47.4, 8.5)
NAMES = ("plane", "wing")


def view_of(names, sides=MappingProxyType({})):
    """Return a fleet's map without a page."""
    panel = Panel(Console(file=io.StringIO()), quiet=True)
    displays = {name: panel.of(name) for name in names}
    return ViewDisplay(displays, dict.fromkeys(names, Config()), PageAddress(port=0), sides)


@pytest.fixture(scope="module")
def snapshot(flight):
    *_, (_, _, controller) = flight(20.0)
    return controller.snapshot()


@pytest.fixture
def view():
    """Return a fleet's map without a page, and the wishes that reach each aircraft."""
    made = view_of(NAMES)
    wishes: dict[str, list] = {name: [] for name in NAMES}
    for name in NAMES:
        made.of(name).begin(PLANE, wishes[name].append)
    return made, wishes


def alongside(snapshot):
    aircraft = replace(snapshot.aircraft, east_m=snapshot.aircraft.east_m + 300.0)
    return replace(snapshot, aircraft=aircraft, time_s=snapshot.time_s + 50.0)


def test_what_is_reported_names_the_aircraft(snapshot):
    out = io.StringIO()
    with Panel(Console(file=out, width=200)) as panel:
        plane, _ = (panel.of(name) for name in NAMES)
        panel.note("starting")
        plane.note("connecting")
        plane.watching_began(snapshot.time_s - 61.0, None)
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
    shown.ask_all(wish)
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
    shown.of("plane").show(on_the_right(snapshot))  # its role: the other side
    assert shown._update()["fleet"][0]["wanted"] == Side.LEFT
    shown._pressed({"action": "side", "side": "right", "who": "operator 1"})
    assert shown.requests.asked == [(Side.RIGHT, "operator 1")]
    assert shown._update()["fleet"][0]["wanted"] == (Side.LEFT if refused else Side.RIGHT)
    assert wishes == {"plane": [], "wing": []}


@pytest.fixture
def page(browser, view, snapshot):
    """Return the page of a fleet in flight."""
    shown, _ = view
    shown.requests = Requests()
    with shown:
        for name, one in zip(NAMES, (snapshot, alongside(snapshot)), strict=True):
            shown.of(name).watching_began(one.time_s, None)
            shown.of(name).show(one)
        opened = browser.new_page()
        opened.goto(shown.url)
        button = opened.get_by_role("button", name="Relieve wing")
        while not (button.count() and button.is_enabled()):
            shown.pump()  # again: what finds the process of the page busy is dropped
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
    assert float(circle.get_attribute("r")) == pytest.approx(snapshot.plan.circle.radius_m)


def test_of_several_targets_the_page_names_each_and_whose_decisions_are_reported(snapshot):
    shown = view_of(NAMES, {"boat": Side.LEFT, "bike": Side.RIGHT})
    for name, target in zip(NAMES, ("boat", "bike"), strict=True):
        shown.of(name).begin(PLANE, lambda _wish: None)
        shown.of(name).show(replace(snapshot, target=target))
    states = shown._update()["fleet"]
    assert [one["target"]["name"] for one in states] == ["boat", "bike"]
    assert [one["wanted"] for one in states] == [Side.LEFT, Side.RIGHT]
    for name in NAMES:
        shown.of(name).say(Announce(snapshot.time_s, "decision", "moving"))
    assert [one[1:] for one in shown._announced] == [["decision", f"{name}: moving"] for name in NAMES]


def on_route(snapshot, target, east_m):
    """Return a snapshot of an aircraft at a target that is expected to go 400 m north."""
    route = route_of(np.array([east_m, east_m]), np.array([0.0, 400.0]))
    return replace(snapshot, target=target, route=RouteProgress(route, True, 100.0, 4.0, 0.9, math.nan))


def test_the_map_draws_the_route_of_each_target_once(browser, snapshot):
    names = ("plane", "wing", "kite")
    shown = view_of(names)
    with shown:
        for name, target, east_m in zip(names, ("boat", "bike", "bike"), (0.0, 70.0, 70.0), strict=True):
            shown.of(name).show(on_route(snapshot, target, east_m))
        shown.pump()
        page = browser.new_page()
        page.goto(shown.url)
        page.locator("#map path.aircraft.other").nth(1).wait_for(state="attached")
        drawn = [one.get_attribute("points") for one in page.locator("#map polyline.route").all()]
        assert [(one.split()[0], one.split()[-1]) for one in drawn] == [("0,0", "0,400"), ("70,0", "70,400")]
        assert page.locator("#legend li.route").is_visible()
        page.close()


def test_the_routes_are_sent_again_only_when_one_changes(view, snapshot):
    shown, _ = view
    shown.of("plane").show(on_route(snapshot, "boat", 0.0))
    shown.of("wing").show(on_route(snapshot, "bike", 70.0))
    assert [line[0] for line in shown._update()["setting"]["routes"]] == [[0.0, 0.0], [70.0, 0.0]]
    shown._setting = None  # as after it was sent
    assert "setting" not in shown._update()
    shown.of("wing").show(replace(snapshot, target="bike"))
    assert [line[0] for line in shown._update()["setting"]["routes"]] == [[0.0, 0.0]]


def test_all_messages_are_logged_by_the_clock_of_the_first_aircraft(view, snapshot):
    shown, _ = view
    shown.of("plane").watching_began(snapshot.time_s - 30.0, None)
    shown.of("plane").show(snapshot)
    shown.of("wing").watching_began(500.0, None)
    shown.of("wing").say(Announce(530.0, "decision", "moving"))
    assert shown._announced[-1] == [snapshot.time_s, "decision", "wing: moving"]


def test_an_aircraft_that_is_not_flown_answers_that_it_is_not(view, snapshot):
    shown, wishes = view
    shown.of("plane").show(snapshot)
    shown._pressed({"action": "hold", "side": None, "who": "operator 1"})
    assert [len(one) for one in wishes.values()] == [1, 0]
    assert shown._announced[-1][2] == "wing: refused: it is not flown yet"


BATTERIES = {"plane": 74, "wing": 20}


def on_the_right(snapshot):
    """Return the state of an aircraft whose role is the right side."""
    return replace(snapshot, requirement=replace(snapshot.requirement, side=Side.RIGHT))


LOST = Alarm("target", "target lost for 60 s", "Find it.", 60.0)


@pytest.fixture
def described(browser, view, snapshot):
    """Return the page of a fleet whose second aircraft is on the other side, with a low battery and an alarm."""
    shown, _ = view
    shown.requests = Requests()
    with shown:
        for name in NAMES:
            alarms = (LOST,) if name == "wing" else ()
            status = VehicleStatus(BATTERIES[name], 11.0, "3D", True, 97, 0.1, alarms=alarms)
            own = snapshot if name == "plane" else on_the_right(alongside(snapshot))
            shown.of(name).show(replace(own, vehicle=status))
        shown.pump()
        opened = browser.new_page()
        opened.goto(shown.url)
        opened.locator("#fleet tbody tr").nth(1).wait_for()
        yield opened
        opened.close()


def cells(page, name):
    return page.locator(f"#fleet tr[data-name={name}] td[data-title]:not(:last-child)").all_inner_texts()


def test_each_aircraft_has_a_row_with_its_own_values(described):
    state, side, range_m, *rest = cells(described, "plane")
    assert (state, side.split(", ")[0], rest) == ("watching AUTO", "left", ["74 %", "97 %", "none"])
    other_state, other_side, other_range_m, *rest = cells(described, "wing")
    assert (other_state, other_side.split(", ")[0], rest) == ("watching AUTO", "right", ["20 %", "97 %", "1 new"])
    assert range_m != other_range_m
    assert "required side left" in described.locator("#held").inner_text()


def test_the_details_are_those_of_the_selected_aircraft(described):
    battery = described.locator("#key-tiles div", has_text="battery").locator("dd")
    assert described.locator("#whose").inner_text() == "plane"
    assert battery.inner_text() == "74 %"
    described.locator("#fleet").get_by_role("button", name="wing", exact=True).click()
    assert described.locator("#whose").inner_text() == "wing"
    assert battery.inner_text() == "20 %"
    assert "required: right" in described.locator("#side span").inner_text()
    assert described.locator(".place[data-of=aircraft]").inner_text().startswith("wing 47.")
    described.keyboard.press("n")
    assert described.locator("#whose").inner_text() == "plane"


def test_the_rows_are_readable_at_any_width(browser, view, described):
    shown, _ = view
    page = browser.new_context().new_page()
    page.goto(shown.url)
    page.locator("#fleet tbody tr").nth(1).wait_for()
    for (width, height), scheme in itertools.product(SIZES, SCHEMES):
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)
        found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]})
        assert found.violations_count == 0, f"{width} px, {scheme}: {found.generate_report()}"
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for button in page.locator("#fleet button").all():
            assert button.bounding_box()["height"] >= 44
    page.context.close()
