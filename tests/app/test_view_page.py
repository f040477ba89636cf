"""The live map in a real browser: what a person sees, and what the buttons do."""

from __future__ import annotations

import itertools
import json
import math
import re
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import TimeoutError as NotYet
from playwright.sync_api import expect
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.panel import Panel, clock
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.control.present import Alarm, Phase, VehicleStatus
from sidelong.mission.core.events import AlarmReported, Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Side
from tests.app.conftest import SCHEMES, SIZES

START_S = 100.0
PLANE = LocalPlane(47.4, 8.5)
FENCES = {
    "rally": [PLANE.latitude_longitude_deg(600, 300)],
    "keep_in": [[PLANE.latitude_longitude_deg(*c) for c in ((-500, -500), (1500, -500), (1500, 900), (-500, 900))]],
    "keep_out": [[PLANE.latitude_longitude_deg(*c) for c in ((600, 100), (800, 100), (800, 0))]],
}


STATUS = VehicleStatus(
    19, 10.9, "3D, 11 satellites", True, 97, 0.12, endurance_s=1200.0, home_s=100.0, home_m=(-200.0, 50.0)
)
LOST = Alarm(
    "target", "the target has not been seen for 33 s; it flies home in 267 s", "point the camera", 100.0, 267.0
)

PRIMES = {0x2032: "'", 0x2033: '"'}
SEEN = replace(LOST, key="laser", acknowledged=True)


@pytest.fixture(scope="module")
def snapshots(flight):
    """Return the snapshots of 110 s, at whose end the circle is being moved, with the announcements."""
    taken = []
    for _, commands, controller in flight(110.0):
        taken.append(
            (
                replace(controller.snapshot(), vehicle=STATUS),
                [command for command in commands if isinstance(command, Announce)],
            )
        )
    return taken


@contextmanager
def display_of(snapshots):
    config = Config.model_validate({"planner": {"name": "paper"}, "fences": FENCES})
    with ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": config}, PageAddress(port=0)) as display:
        display.begin(PLANE, lambda _request: None)
        display.watching_began(START_S, None)
        for tick, (snapshot, announced) in enumerate(snapshots):
            for announcement in announced:
                display.say(announcement)
            display.show(snapshot)
            if tick % 20 == 0:
                display.pump()
        yield display


@pytest.fixture(scope="module")
def module_display(snapshots):
    with display_of(snapshots) as display:
        yield display


@pytest.fixture
def display(module_display, snapshots):
    """Return the display, showing the flight's last snapshot."""
    module_display.show(snapshots[-1][0])
    module_display._received_at_s = time.monotonic() + 60.0  # the aircraft's messages go on
    module_display.pump()
    return module_display


@pytest.fixture
def page(browser, display, snapshots):
    """Return the page, open and showing the flight's end; at its own nothing may have been complained about."""
    with opened(browser, display) as page:
        end = page.locator("#clock", has_text=clock(snapshots[-1][0].time_s - START_S))
        while not end.is_visible():
            display.pump()  # a state is dropped while the pipe to the page is full
            with suppress(NotYet):
                end.wait_for(timeout=1_000.0)
        yield page


@contextmanager
def opened(browser, display, size=(1400, 860), scheme="light", gone=False, ages=False):
    """Open a page. gone: its program ends, so that requests fail; ages: what it shows becomes old."""
    viewport = {"width": size[0], "height": size[1]}
    # axe is put into the page, which allows no script but its own: only that is lifted.
    page = browser.new_context(viewport=viewport, color_scheme=scheme, bypass_csp=True).new_page()
    if not ages:
        page.add_init_script("performance.now = () => 1e6; Date.now = () => 1e12;")
    complaints: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(display.url)
    page.locator("#phase", has_text="watching").wait_for()
    yield page
    assert [one for one in complaints if not (gone and "Failed to load resource" in one)] == []
    assert all(url.startswith((display.url, "data:")) for url in asked)
    page.context.close()


def pressed(page, display, name: str, answer: str) -> list[OperatorRequest]:
    """Press a button, answer its question, and return what came of it."""
    got: list[OperatorRequest] = []
    display.begin(PLANE, got.append)
    page.get_by_role("button", name=name, exact=True).click()
    page.get_by_role("dialog").get_by_role("button", name=answer, exact=True).click()
    page.get_by_role("dialog").wait_for(state="hidden")
    if answer == "Yes":
        while not got:
            display.pump()
    else:  # the next button's request would come after this one's
        display.note("done")
        page.locator("#log li", has_text="done").first.wait_for()
        display.pump()
    return got


def centre(box) -> tuple[float, float]:
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_everything_lies_within_the_window_and_nothing_on_top_of_anything(page):
    boxes = [page.locator(name).bounding_box() for name in ("header", "#watch", "#where", "#announcements", "aside")]
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= 1400 for box in boxes)
    assert all(box["y"] >= 0 and box["y"] + box["height"] <= 860 for box in boxes)
    for n, a in enumerate(boxes):
        for b in boxes[n + 1 :]:
            alongside = a["x"] + a["width"] <= b["x"] or b["x"] + b["width"] <= a["x"]
            above = a["y"] + a["height"] <= b["y"] or b["y"] + b["height"] <= a["y"]
            assert alongside or above


BOXES = "all => all.map(([name, k]) => document.querySelectorAll(name)[k].getBoundingClientRect().toJSON())"


def test_the_map_is_to_scale(page, snapshots):
    last = snapshots[-1][0]
    # All in one moment: a banner may change the size of the map.
    names = [["#map .ring", 1], ["#map circle.target", 0], ["#map path.aircraft", 0], ["#map .circle", 0]]
    ring, *marks, circle = page.evaluate(BOXES, names)
    px_per_m = ring["width"] / 1000.0  # Dmax is 500 m
    target, aircraft = map(centre, marks)
    estimate = last.estimate
    ahead_s = last.time_s - estimate.time_s
    east_m = last.aircraft.east_m - estimate.east_m - ahead_s * estimate.velocity_east_m_s
    north_m = last.aircraft.north_m - estimate.north_m - ahead_s * estimate.velocity_north_m_s
    assert (aircraft[0] - target[0]) / px_per_m == pytest.approx(east_m, abs=12.0)
    assert (target[1] - aircraft[1]) / px_per_m == pytest.approx(north_m, abs=12.0)
    assert circle["width"] / px_per_m == pytest.approx(100.0, abs=5.0)  # a stroke is 2 px wide


def test_map_and_plots_show_what_there_is(page):
    for name in (
        "ellipse.ellipse",
        "polyline.predicted",
        "path.side",
        "polygon.keep-in",
        "polygon.keep-out",
    ):
        assert page.locator(f"#map {name}").count() == 1, name
        assert page.locator(f"#map {name}").bounding_box()["width"] > 0, name
    assert page.locator("#map .trail polyline.a0").bounding_box()["width"] > 0
    page.locator("#engineers summary").click()
    plots = page.locator(":is(#plots, #inner-plots) figure:not([hidden]) svg")
    assert plots.count() == 5
    assert all(plots.nth(n).locator("polyline").count() >= 1 for n in range(5))
    assert page.locator("#map .rally").count() == 1
    assert page.locator("#legend li.fence").is_visible()
    assert page.locator("#legend li.rally").is_visible()


def test_the_side_asked_for_is_shaded(page):
    # The target drives east and is watched from the left: the shade lies above it on the map.
    shade, target = (page.locator(f"#map {name}").bounding_box() for name in ("path.side", "circle.target"))
    assert shade["y"] + shade["height"] / 2 < centre(target)[1] - 20
    assert shade["width"] > 1.8 * shade["height"]


def test_decisions_are_reported_in_plain_words_newest_first(page, snapshots):
    announced = [one.text for _, announcements in snapshots for one in announcements]
    shown = [line for line in page.locator("#log li").all_inner_texts() if "done" not in line]
    assert len(shown) == len(announced)
    assert all(text in line for text, line in zip(reversed(announced), shown, strict=True))


def test_the_range_of_the_indicator_is_that_of_the_flight(page, snapshots):
    last = snapshots[-1][0]
    range_m = math.hypot(last.aircraft.east_m - last.estimate.east_m, last.aircraft.north_m - last.estimate.north_m)
    shown = re.search(r"now: (\d+) m", page.locator("#band span").inner_text())[1]
    assert float(shown) == pytest.approx(range_m, abs=4.0)


def test_the_vehicle_s_state_is_on_tiles(page):
    page.locator("#more summary").click()
    for name, text, look in (
        ("battery", "19 %", "bad"),
        ("fly home in", "18 min", ""),
        ("voltage", "10.9\u00a0V", ""),
        ("GPS", "3D, 11 satellites", ""),
        ("link", "97 %, 120\u00a0ms", ""),
    ):
        tile = page.locator(".tiles div", has=page.locator("dt", has_text=re.compile(f"^{name}$"))).locator("dd")
        assert (name, tile.inner_text(), tile.get_attribute("class")) == (name, text, look)


def test_a_click_in_the_camera_s_picture_comes_back_as_a_request(page, display):
    jpeg = cv2.imencode(".jpg", np.full((180, 320, 3), 90, np.uint8))[1].tobytes()
    marks = {"time_s": 1.0, "state": "object", "confidence": 0.9, "box": [0.4, 0.4, 0.6, 0.6]}
    marks |= {"estimate": [0.5, 0.5], "ellipse": [[0.3, 0.5], [0.5, 0.6], [0.7, 0.5], [0.3, 0.5]]}
    display.show_picture(lambda: json.dumps(marks).encode() + b"\n" + jpeg)
    got = []
    display.begin(PLANE, got.append)
    words = page.locator("#camera output", has_text="tracked, confidence 90 %")
    while not words.is_visible():
        display.pump()
        with suppress(NotYet):
            words.wait_for(timeout=1_000.0)
    canvas = page.locator("#camera canvas").bounding_box()
    page.locator("#camera canvas").click(position={"x": 0.25 * canvas["width"], "y": 0.5 * canvas["height"]})
    page.locator("#camera button").click()
    while len(got) < 2:
        page.wait_for_timeout(20)
        display.pump()
    assert got[0].where == pytest.approx((0.25, 0.5), abs=0.01)
    assert got[1].where == ()


def test_a_button_asks_once_and_then_comes_back_as_a_request(page, display):
    (request,) = pressed(page, display, "Hold", "Yes")
    assert request.action == "hold"


def test_a_button_that_is_not_confirmed_does_nothing(page, display):
    assert pressed(page, display, "End", "No") == []


def test_other_side_names_the_side(page, display):
    page.get_by_role("button", name="Other side").click()
    assert "right" in page.get_by_role("dialog").inner_text()
    page.get_by_role("dialog").get_by_role("button", name="No").click()
    (request,) = pressed(page, display, "Other side", "Yes")
    assert (request.action, request.side) == ("side", Side.RIGHT)


def test_what_is_flown_is_changed_after_one_question(page, display):
    got: list[MissionChange] = []
    display.begin(PLANE, got.append)
    page.get_by_role("button", name="Change…").click()
    assert page.get_by_label("Radius of the circle, m", exact=True).input_value() == "50"
    page.get_by_label("Radius of the circle, m", exact=True).fill("80")
    page.get_by_label("Side: ").fill("120-200")
    page.get_by_role("button", name="Change", exact=True).click()
    page.locator("#ask", has_text="radius 80 m instead of 50 m, side 120-200 instead of left").wait_for()
    page.locator("#ask").get_by_role("button", name="Yes").click()
    while not got:
        display.pump()
    (change,) = got
    assert (change.radius_m, change.side, change.height_m) == (80.0, "120-200", None)
    assert isinstance(change.radius_m, float)  # an int would have the planner compiled again, in flight
    assert change.who == "operator at this machine"


def test_what_became_of_a_wish_is_seen(page, display):
    display.say(Announce(START_S, "operator", "radius 5 m refused: the circle is too tight"))
    display.pump()
    page.locator("#answer", has_text="too tight").wait_for()


@pytest.mark.parametrize(("phase", "offered"), [(Phase.YIELDED, ["Resume"]), (Phase.ENDED, [])])
def test_only_resume_is_offered_after_a_yield_and_nothing_after_the_end(page, display, snapshots, phase, offered):
    display.show(replace(snapshots[-1][0], phase=phase))
    display.pump()
    page.locator("#phase", has_text=phase).wait_for()
    buttons = page.locator("#buttons button").all()[:5]
    assert [button.inner_text() for button in buttons if button.is_enabled()] == offered
    assert phase in next(button for button in buttons if not button.is_enabled()).get_attribute("title")


def test_resume_is_offered_while_holding_only(page, display, snapshots):
    resume, hold = (page.get_by_role("button", name=name, exact=True) for name in ("Resume", "Hold"))
    assert (resume.is_enabled(), hold.is_enabled()) == (False, True)
    display.show(replace(snapshots[-1][0], phase=Phase.HOLDING))
    display.pump()
    page.locator("#phase", has_text="holding").wait_for()
    assert (resume.is_enabled(), hold.is_enabled()) == (True, False)


def test_the_horizon_turns_against_the_bank_and_sinks_as_the_nose_rises(page, display, snapshots):
    last = snapshots[-1][0]
    attitude = AttitudeReading(last.time_s, math.radians(20.0), math.radians(5.0), 0.0)
    display.show(replace(last, attitude=attitude))
    display.pump()
    page.locator('#horizon[aria-label="Attitude: bank 20° right, nose 5°"]').wait_for()
    assert page.locator("#ground").get_attribute("transform") == "rotate(-20.0) translate(0 5.0)"
    display.show(replace(last, attitude=None))
    display.pump()
    page.locator("#horizon").wait_for(state="hidden")


def test_a_lost_track_and_a_lost_link_catch_the_eye(page, display, snapshots):
    last = snapshots[-1][0]
    display.show(replace(last, connected=False, estimate=replace(last.estimate, quality="lost")))
    display.pump()
    page.locator("#quality.bad", has_text="track lost").wait_for()
    assert page.locator("#link.bad").inner_text() == "link lost"
    assert "No message of the aircraft" in page.locator("#seen.bad").inner_text()


def test_before_the_flight_there_are_no_empty_plots_and_a_long_name_is_cut(browser, snapshots):
    config = Config.model_validate({"link": {"urls": [f"serial:///dev/serial/by-id/{'usb-radio-' * 12}:57600"]}})
    with ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": config}, PageAddress(port=0)) as display:
        display.note("connecting")
        display.pump()
        page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
        page.goto(display.url)
        page.locator("#log li", has_text="connecting").wait_for()
        name = page.locator("#name")
        assert not page.locator("#plots").is_visible()
        assert page.locator("header").bounding_box()["height"] < 60
        assert name.get_attribute("title") == name.inner_text() == config.link.urls[0]
        page.context.close()


@pytest.mark.parametrize("width", [1400, 390])
def test_the_names_of_a_fleet_are_reported_within_the_map(browser, snapshots, width):
    names = ("north-survey-plane", "a-wing-with-a-long-name")
    panel = Panel(Console(), quiet=True)
    view = ViewDisplay({name: panel.of(name) for name in names}, dict.fromkeys(names, Config()), PageAddress(port=0))
    with view:
        for name in names:
            view.of(name).begin(PLANE, lambda _request: None)
            view.of(name).watching_began(START_S, None)
        last = replace(snapshots[-1][0], vehicle=VehicleStatus(19, 10.9, "3D, 11 satellites", True, 97, 0.12))
        view.of(names[0]).show(last)
        view.of(names[1]).show(replace(last, aircraft=replace(last.aircraft, east_m=last.aircraft.east_m + 600.0)))
        view.show(last)
        view.pump()
        with opened(browser, view, (width, 860)) as page:
            page.locator("#map .label", has_text=names[1]).wait_for()
            where = page.locator("#where").bounding_box()
            for name in names:
                box = page.locator("#map .label", has_text=name).bounding_box()
                assert where["x"] <= box["x"]
                assert box["x"] + box["width"] <= where["x"] + where["width"]
                button = page.get_by_role("button", name=f"Relieve {name}").bounding_box()
                assert button["x"] + button["width"] <= width
                assert button["height"] < 50
            assert page.locator(".place[data-of=aircraft]").inner_text().startswith(f"{names[0]} 47.")


def test_when_the_flight_s_program_ends_the_page_reports_so(browser, snapshots):
    with display_of(snapshots) as display, opened(browser, display, gone=True) as page:
        display.show_end([("outcome", "completed"), ("time in band", "98 %")], Path("runs/x"))
        display.__exit__(None, None, None)
        page.locator("#stage h2", has_text="The flight has ended").wait_for()
        assert "98 %" in page.locator("#summary").inner_text()
        assert page.locator("#next code").all_inner_texts() == [
            "sidelong report runs/x",
            "sidelong replay runs/x --view",
        ]
        assert page.locator("#buttons button:enabled").count() == 0
        page.locator("#band.unknown").wait_for()
        assert page.locator(".good").filter(visible=True).count() == 0
        assert not page.locator("#day").is_visible()


def test_the_map_can_be_dragged_and_brought_back(page):
    box = page.locator("#map").bounding_box()
    middle = centre(box)
    before = centre(page.locator("#map circle.target").bounding_box())
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 100, middle[1] + 50)
    page.mouse.up()
    after = centre(page.locator("#map circle.target").bounding_box())
    assert (after[0] - before[0], after[1] - before[1]) == pytest.approx((100, 50), abs=2)
    page.get_by_role("button", name="Follow the target").click()
    assert centre(page.locator("#map circle.target").bounding_box()) == pytest.approx(before, abs=2)


def test_numbers_of_the_grid_never_cover_the_name_of_an_axis(page):
    page.locator("#map").focus()
    for _ in range(30):
        page.keyboard.press("ArrowRight")  # to numbers of four digits
    at_x, at_y = centre(page.locator("#map").bounding_box())
    page.mouse.move(at_x, at_y)
    page.mouse.down()
    for step in range(60):
        page.mouse.move(at_x - 4 * step, at_y)
        boxes = page.locator("#map").evaluate(  # at once: each drawing makes new ones
            "map => [...map.querySelectorAll('.tick')].map((one) => one.getBoundingClientRect().toJSON())"
        )
        row = sorted((box for box in boxes if box["bottom"] == boxes[0]["bottom"]), key=lambda box: box["left"])
        assert len(row) > 2
        assert all(before["right"] < after["left"] for before, after in itertools.pairwise(row))
    page.mouse.up()


def test_a_narrow_window_scrolls_and_hides_nothing(page):
    page.set_viewport_size({"width": 700, "height": 900})
    for name in ("#where", "aside", "#announcements", "#buttons"):
        box = page.locator(name).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 700


def test_places_are_reported_in_degrees(page):
    latitude_deg, longitude_deg = map(
        float, page.locator(".place[data-of=target]").inner_text().removeprefix("target ").split(",")
    )
    east_m, north_m = PLANE.east_north_m(latitude_deg, longitude_deg)
    assert math.hypot(east_m, north_m) < 2000.0
    assert page.locator(".place[data-of=aircraft]").inner_text().startswith("aircraft 47.")


def test_the_cursor_reports_its_place_and_what_is_measured(page):
    box = page.locator("#map").bounding_box()
    x, y = centre(box)
    page.get_by_role("button", name="Measure").click()
    page.mouse.click(x, y)
    page.mouse.move(x + 100, y)
    assert re.fullmatch(r"47\.\d{5}, 8\.\d{5} +\d+ m, bearing 090°", page.locator("#cursor").inner_text())


def test_the_map_is_moved_by_keys(page):
    page.locator("#map").focus()
    page.keyboard.press("+")
    page.keyboard.press("ArrowLeft")
    assert page.get_by_role("button", name="Follow the target").is_visible()
    page.keyboard.press("0")
    assert not page.get_by_role("button", name="Follow the target").is_visible()


def test_everybody_can_read_it(browser, display):
    with alarmed(display, LOST, SEEN), opened(browser, display) as page:
        expect(page.locator("#alarms > div")).to_have_count(2)
        page.locator("#engineers summary").click()
        page.locator("#more summary").click()
        for (width, height), scheme in itertools.product(SIZES, SCHEMES):
            page.set_viewport_size({"width": width, "height": height})
            page.emulate_media(color_scheme=scheme)
            found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]})
            assert found.violations_count == 0, f"{width} px, {scheme}: {found.generate_report()}"
            assert page.evaluate("document.documentElement.scrollWidth") <= width


# -- age ------------------------------------------------------------------------------------------------------------


def until_visible(element, display):
    """Let the program go on until an element is visible: on a busy machine its last state may be old already."""
    while not element.is_visible():
        display.pump()
        with suppress(NotYet):
            element.wait_for(timeout=500.0)


def test_data_become_old_by_their_own_age_and_nothing_old_is_green(browser, display):
    with opened(browser, display, ages=True) as page:
        page.clock.install()
        page.reload()
        until_visible(page.locator("#band.good"), display)
        page.clock.run_for(4000)  # no message of the program
        page.locator("#band.unknown").wait_for()
        assert page.locator(".good").filter(visible=True).count() == 0
        assert "No news from sidelong for 0:0" in page.locator("#news").inner_text()
        page.get_by_role("button", name="Hold", exact=True).click()
        assert "old: the aircraft may be elsewhere" in page.locator("#question").inner_text()
        page.keyboard.press("n")
        until_visible(page.locator("#band.good"), display)  # the request that waited for the clock counts as slow

        def late(route):
            answer = route.fetch()
            page.clock.run_for(20_000)  # it lies in the line
            route.fulfill(response=answer)

        page.route("**/state*", late)
        until_visible(page.locator("#band.unknown"), display)
        page.unroute_all(behavior="ignoreErrors")


def test_what_an_aircraft_sent_long_ago_is_old_however_fast_the_line_is(browser, display):
    with opened(browser, display) as page:
        page.locator("#band.good").wait_for()
        display._received_at_s = time.monotonic() - 4.0
        display.pump()
        page.locator("#band.unknown").wait_for()
        assert "All below is from" in page.locator("#seen").inner_text()


# -- before, between and after flights ------------------------------------------------------------------------------


def fresh_display(**options):
    return ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(port=0), **options)


def test_before_a_flight_the_page_shows_what_is_prepared_and_how_far_it_is(browser):
    with fresh_display() as display:
        display.note("compiling planner and filter: 40 %")
        page = browser.new_page()
        page.goto(display.url)
        page.locator("#stage h2", has_text="Preparing").wait_for()
        assert page.locator("#stage progress").get_attribute("value") == "40"
        assert not page.locator("#news").is_visible()
        display.begin(PLANE, lambda _request: None)
        display.note("taking off")
        page.locator("#stage h2", has_text="Taking the aircraft over").wait_for()
        page.locator("#stage-text", has_text="taking off").wait_for()
        assert page.locator("#phase").inner_text() == "taking over"
        page.close()


def test_a_service_is_watched_and_released_on_its_page(browser):
    asked = []
    with fresh_display(is_service=True) as display:
        display.service = lambda request, who: asked.append((request, who)) or (True, "the watch begins")
        checks = [("position", True, "3D fix"), ("home", False, "not known; wait for the GPS")]
        display.show_stage("waiting", checks=checks)
        page = browser.new_page()
        page.goto(display.url)
        page.locator("#checks .bad", has_text="home: not known; wait for the GPS").wait_for()
        assert not page.get_by_role("button", name="Watch").is_enabled()
        display.show_stage("ready", checks=checks[:1])
        page.get_by_role("button", name="Watch").click()
        page.locator("#ask").get_by_role("button", name="Yes").click()
        while not asked:
            display.pump()
        assert asked == [("watch", "operator at this machine")]
        until_visible(page.locator("#answer.accepted", has_text="watch: the watch begins"), display)
        assert not page.get_by_role("button", name="End", exact=True).is_visible()
        page.close()


def test_a_target_that_stands_has_no_side(page, display, snapshots):
    last = snapshots[-1][0]
    still = replace(last.estimate, velocity_east_m_s=0.05, velocity_north_m_s=-0.02)
    display.show(replace(last, estimate=still, course_rad=None))
    display.pump()
    page.locator("#side", has_text="NO SIDE YET").wait_for()
    assert "now: the target stands" in page.locator("#side span").inner_text()
    assert page.locator("#map path.side").get_attribute("d") == ""
    assert not page.locator("#map .target-course").is_visible()
    assert "keeps its range until it moves" in page.locator("#seen").inner_text()


# -- what matters first ---------------------------------------------------------------------------------------------


@contextmanager
def alarmed(display, *alarms):
    """Show alarms as long as the context lasts."""
    status = replace(STATUS, alarms=alarms)
    before = display.snapshot
    display.show(replace(before, vehicle=status))
    display.pump()
    yield
    display.show(before)
    display.pump()


def shown_from(display, snapshot, bearing_deg, range_m):
    """Show the aircraft elsewhere, as seen from the target, which drives east."""
    east_m, north_m = snapshot.estimate.position_m(snapshot.time_s)
    bearing_rad = math.radians(bearing_deg)
    at_m = {"east_m": east_m + range_m * math.sin(bearing_rad), "north_m": north_m + range_m * math.cos(bearing_rad)}
    display.show(replace(snapshot, aircraft=replace(snapshot.aircraft, **at_m)))
    display.pump()


PLACES = (  # bearing in degrees, range in m; class, word and fact of the band and of the side
    (0.0, 300.0, ("good", "IN BAND", "now: 300 m"), ("good", "ON SIDE", "required: left; now: left, ")),
    (0.0, 80.0, ("bad", "OUT OF BAND", "now: 80 m"), ("good", "ON SIDE", "now: left")),
    (170.0, 310.0, ("good", "IN BAND", ""), ("bad", "OFF SIDE", "required: left; now: right, 17")),
    (95.0, 600.0, ("bad", "OUT OF BAND", "now: 600 m"), ("bad", "OFF SIDE", "now: right, 9")),
)


def test_band_and_side_are_reported_as_they_are(page, display, snapshots):
    for bearing_deg, range_m, band, side in PLACES:
        shown_from(display, snapshots[-1][0], bearing_deg, range_m)
        page.locator("#band span", has_text=f"{range_m:.0f} m").wait_for()
        for name, (look, state, fact) in {"#band": band, "#side": side}.items():
            assert page.locator(name).get_attribute("class") == f"indicator {look}"
            assert page.locator(f"{name} strong").inner_text() == state
            assert fact in page.locator(f"{name} span").inner_text()
            assert "required: " in page.locator(f"{name} span").inner_text()


@pytest.mark.parametrize("unknown", ["lost", "silent", "unseen"])
def test_anything_not_known_is_grey(page, display, snapshots, unknown):
    last = snapshots[-1][0]
    quality = TrackQuality.LOST if unknown == "lost" else TrackQuality.GOOD
    estimate = None if unknown == "unseen" else replace(last.estimate, quality=quality)
    display.show(replace(last, estimate=estimate, connected=unknown != "silent"))
    display.pump()
    page.locator("#band.unknown").wait_for()
    assert page.locator("#side.unknown strong").inner_text() == "SIDE UNKNOWN"
    assert page.locator("#phase").get_attribute("class") == ("chip good" if unknown == "unseen" else "chip ")


CONTRAST = """element => {
  const channel = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const luminance = (text) => {
    const [r, g, b] = text.match(/[\\d.]+/g).map(Number).map(channel);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const style = getComputedStyle(element);
  const [a, b] = [luminance(style.color), luminance(style.backgroundColor)];
  return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
}"""


def test_indicators_and_alarms_are_readable_in_the_sun(browser, display):
    with alarmed(display, LOST), opened(browser, display, (1280, 800)) as page:
        for scheme in SCHEMES:
            page.emulate_media(color_scheme=scheme)
            for look in ("good", "bad", "unknown"):
                page.evaluate(f"document.getElementById('band').className = 'indicator {look}'")
                assert page.locator("#band").evaluate(CONTRAST) >= 7.0  # AAA
            assert page.locator("#alarms > div").evaluate(CONTRAST) >= 7.0


def test_fingers_and_eyes_find_it(browser, display):
    with alarmed(display, LOST), opened(browser, display) as page:
        for name in ("#engineers", "#more"):
            page.locator(f"{name} summary").click()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            low = page.evaluate(
                "[...document.querySelectorAll('button, summary, select, input')].filter(e => e.offsetParent)"
                ".filter(e => e.getBoundingClientRect().height < 44).map(e => e.textContent)"
            )
            assert low == []
            small = page.evaluate(
                "[...document.querySelectorAll('body *')].filter(e => e.getClientRects().length)"
                ".filter(e => [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()))"
                ".filter(e => parseFloat(getComputedStyle(e).fontSize) < 14).map(e => e.textContent)"
            )
            assert small == []
            for name in ("#band", "#side", "#key-tiles"):  # above the fold, alarms or not
                box = page.locator(name).bounding_box()
                assert box["y"] + box["height"] <= height


# -- alarms ---------------------------------------------------------------------------------------------------------


def test_an_alarm_has_a_banner_a_title_and_what_to_do(page, display):
    assert not page.locator("#alarms").is_visible()
    with alarmed(display, LOST):
        banner = page.locator("#alarms > div")
        banner.wait_for()
        assert "The target has not been seen for 33 s" in banner.inner_text()
        assert "Point the camera" in banner.inner_text()
        assert page.title().startswith("⚠ the target has not been seen")
    page.locator("#alarms").wait_for(state="hidden")
    assert page.title() == "sidelong: live map"


def test_an_alarm_is_acknowledged_by_a_click(page, display):
    got = []
    display.begin(PLANE, got.append)
    with alarmed(display, LOST):
        page.get_by_role("button", name="Acknowledge").click()
        while not got:
            display.pump()
        (wish,) = got
        assert isinstance(wish, AlarmReported)
        assert (wish.key, wish.stage, wish.who) == ("target", "acknowledged", "operator at this machine")
    with alarmed(display, replace(LOST, acknowledged=True)):
        page.locator("#alarms > div.seen").wait_for()
        assert not page.get_by_role("button", name="Acknowledge").is_visible()
        assert page.title() == "sidelong: live map"


def test_instead_of_flying_home_the_circle_can_be_held(page, display):
    got = []
    display.begin(PLANE, got.append)
    with alarmed(display, LOST):
        page.get_by_role("button", name="Hold instead").click()
        while not got:
            display.pump()
        assert got[0].action == "hold"
    with alarmed(display, replace(LOST, countdown_s=None)):
        page.get_by_role("button", name="Hold instead").wait_for(state="hidden")
        page.locator("#alarms > div").wait_for()  # the last alarm may just have gone, and this one not have come
        assert page.locator("#alarms > div").is_visible()


def test_an_alarm_sounds_until_it_is_muted_or_acknowledged(page, display):
    page.evaluate(
        "() => { window.tones = 0; const make = AudioContext.prototype.createOscillator;"
        "AudioContext.prototype.createOscillator = function () { window.tones += 1; return make.call(this); } }"
    )
    page.locator("#map").click()  # a browser makes no sound before
    with alarmed(display, LOST):
        page.wait_for_function("window.tones > 0")
        page.get_by_role("button", name="Sound: on").click()
        assert page.get_by_role("button", name="Sound: off").get_attribute("aria-pressed") == "true"


def test_a_yield_is_explained_with_what_to_do_next(page, display, snapshots):
    display.show(replace(snapshots[-1][0], phase=Phase.YIELDED, over="the flight mode was changed to RTL"))
    display.pump()
    line = page.locator("#over")
    line.wait_for()
    assert "the flight mode was changed to RTL" in line.inner_text()
    assert "Press Resume" in line.inner_text()


# -- requests -------------------------------------------------------------------------------------------------------


def test_a_request_is_pending_until_it_is_answered_and_replaces_an_older_refusal(page, display):
    display.begin(PLANE, lambda _request: None)
    display.say(Announce(START_S, "operator", "radius 5 m refused: the circle is too tight"))
    display.pump()
    page.locator("#answer.refused", has_text="too tight").wait_for()
    page.get_by_role("button", name="Hold", exact=True).click()
    page.locator("#ask").get_by_role("button", name="Yes").click()
    page.locator("#answer.pending", has_text="hold: pending").wait_for()
    assert "too tight" not in page.locator("#answer").inner_text()
    display.say(Announce(START_S, "operator", "operator: hold"))
    display.pump()
    page.locator("#answer.accepted", has_text="operator: hold").wait_for()


def test_the_form_knows_the_limits(page):
    page.get_by_role("button", name="Change…").click()
    radius = page.get_by_label("Radius of the circle, m", exact=True)
    assert (radius.get_attribute("min"), radius.get_attribute("max")) == ("10", "2000")
    refused = page.get_by_role("button", name="Change", exact=True)
    radius.fill("5")
    refused.click()
    assert page.locator("#change").is_visible()
    radius.fill("50,5")  # a decimal comma is one
    page.get_by_label("Least range, m").fill("600")
    refused.click()
    assert page.locator("#change").is_visible()  # beyond the greatest range
    page.get_by_label("Least range, m").fill("100")
    refused.click()
    page.locator("#question", has_text="radius 50.5 m instead of 50 m?").wait_for()
    page.keyboard.press("n")
    page.get_by_role("button", name="Change…").click()
    page.locator("#change").get_by_role("button", name="Leave as it is").click()


# -- units, positions, keys -----------------------------------------------------------------------------------------


GRID = (
    ((47.4, 8.5), 32632),
    ((60.0, 5.0), 32632),
    ((78.2, 15.6), 32633),
    ((-33.9, 18.4), 32734),
    ((0.5, -60.3), 32620),
)


def test_utm_is_that_of_proj(page):
    """Also in the exceptions of Norway and Svalbard."""
    pyproj = pytest.importorskip("pyproj")
    for at_deg, epsg in GRID:
        east_m, north_m = pyproj.Transformer.from_crs(4326, epsg, always_xy=True).transform(*reversed(at_deg))
        grid = page.evaluate("async (at) => (await import('./units.js')).utm(...at)", list(at_deg))
        assert grid["zone"] == epsg % 100
        assert (grid["east"], grid["north"]) == pytest.approx((east_m, north_m), abs=0.01)


def test_a_position_is_shown_in_each_format(page):
    for coordinates, text in (
        ("degrees", "42.000000, -93.000000"),
        ("dms", "42°00'00.0\"N 093°00'00.0\"W"),
        ("utm", "15T 500000 4649776"),
        ("mgrs", "15T WG 00000 49776"),  # the example of the package mgrs: 15TWG0000049776
    ):
        shown = page.evaluate(
            "async (one) => { const u = await import('./units.js'); u.choose('coordinates', one);"
            "return u.position([42, -93]); }",
            coordinates,
        )
        assert shown.translate(PRIMES) == text


def test_units_are_chosen_by_key_and_kept(page, display, snapshots):
    metres = float(page.locator("#now dd").first.inner_text().split()[0])
    page.keyboard.press("u")
    feet, unit = page.locator("#now dd").first.inner_text().split()
    assert unit == "ft"
    assert float(feet) == pytest.approx(metres / 0.3048, abs=2.0)
    assert "ft" in page.locator("#band span").inner_text()
    page.keyboard.press("p")
    place = page.locator(".place[data-of=target]").inner_text().translate(PRIMES)
    assert re.fullmatch(r"""target 47°\d\d'\d\d\.\d"N 008°\d\d'\d\d\.\d"E""", place)
    page.reload()
    page.locator("#now dd", has_text="ft").first.wait_for()


def test_a_change_typed_in_feet_is_sent_in_metres(page, display, snapshots):
    got = []
    display.begin(PLANE, got.append)
    page.keyboard.press("u")
    page.keyboard.press("c")
    radius = page.get_by_label("Radius of the circle, ft")
    assert float(radius.input_value()) == pytest.approx(snapshots[-1][0].airframe.radius_m / 0.3048, abs=0.1)
    radius.fill("300")
    page.get_by_role("button", name="Change", exact=True).click()
    page.locator("#question", has_text="radius 300 ft instead of").wait_for()
    page.keyboard.press("y")
    while not got:
        display.pump()
    assert isinstance(got[0], MissionChange)
    assert got[0].radius_m == pytest.approx(91.44)
    assert got[0].range_min_m is None  # not touched by the rounding of another unit


def test_the_mission_is_held_by_two_keys(page, display):
    got = []
    display.begin(PLANE, got.append)
    page.keyboard.press("h")
    page.locator("#ask").wait_for()
    page.keyboard.press("y")
    while not got:
        display.pump()
    assert got[0].action == "hold"


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)], ids="{0[0]}".format)
def test_help_lists_the_keys_and_the_map_shows_home(browser, display, size):
    with opened(browser, display, size) as page:
        assert page.locator("#map .home").is_visible()
        page.keyboard.press("?")
        assert page.locator("#help").get_by_text("acknowledge the first alarm").is_visible()
        page.get_by_label("Units").select_option("imperial")
        assert Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa"]}).violations_count == 0
        page.keyboard.press("Escape")
        page.locator("#now dd", has_text="ft").first.wait_for()


def test_the_ground_ahead_and_the_waypoints_are_drawn_where_they_are_known(page, display, snapshots, monkeypatch):
    figure, dots = page.locator("#plots figure", has_text="ground ahead"), page.locator("#map .waypoint")
    assert not figure.is_visible()
    monkeypatch.setattr(
        ViewDisplay, "ground", Ground(np.full((81, 81), 40.0, np.float32), -4000.0, -4000.0, 100.0, 100.0)
    )
    display.show(replace(snapshots[-1][0], waypoints_m=((0.0, 100.0), (50.0, 120.0))))
    display.pump()
    expect(figure).to_contain_text("60 at the lowest")
    expect(figure.locator("polyline")).to_have_count(2)
    expect(dots).to_have_count(2)
