"""The page's process: what it serves, to whom, and whose buttons it takes."""

from __future__ import annotations

import asyncio
import json
import re
import socket
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPCookieProcessor, OpenerDirector, Request, build_opener, urlopen

import pytest
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay, served
from sidelong.app.view.panel import Panel
from sidelong.app.view.server import button_of
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import OperatorRequest
from sidelong.mission.core.requirement import Side

PLANE = LocalPlane(47.4, 8.5)
OTHER_LOOPBACK = "127.0.0.2"  # of this machine as well, but not the address that goes without a token


def display_at(host: str) -> ViewDisplay:
    return ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(host, 0))


@pytest.fixture(scope="module")
def shown(flight):
    """Return a display that has shown a flight of 60 s."""
    with display_at("127.0.0.1") as display:
        display.watching_began(100.0, None)
        for _, _, controller in flight(60.0):
            display.show(controller.snapshot())
        yield display


@pytest.fixture(scope="module")
def guarded():
    with display_at(OTHER_LOOPBACK) as display:
        yield display


def status(url: str, opener: OpenerDirector | None = None, **options) -> int:
    try:
        return (opener.open if opener else urlopen)(Request(url, **options)).status
    except HTTPError as error:
        return error.code


def press(display: ViewDisplay, press: dict, **headers: str) -> int:
    origin = {"Origin": display.url.rstrip("/"), "Content-Type": "application/json"}
    address, data = f"{display.url}press", json.dumps(press).encode()
    while (answer := status(address, data=data, headers=origin | headers)) == 429:
        pass  # the tests together press too many at once
    return answer


def requests_after(display: ViewDisplay) -> list[OperatorRequest]:
    """Return what the buttons pressed so far have come to, and wait for the last: it marks the end."""
    got: list[OperatorRequest] = []
    display.begin(PLANE, got.append)
    press(display, {"action": "end"})
    while not got or got[-1].action != "end":
        display.pump()
    return got[:-1]


def test_an_end_on_a_services_page_releases_and_nothing_else_reaches_a_flight_that_has_ended(flight):
    console, flown, released = Panel(Console(), quiet=True).of(), [], []
    with ViewDisplay({"": console}, {"": Config()}, PageAddress(port=0), is_service=True) as display:
        display.service = lambda request, who: released.append(request) or (True, "")
        display.begin(PLANE, flown.append)
        for _, _, controller in flight(5.0):
            display.show(controller.snapshot())
        press(display, {"action": "hold"})
        while not flown:
            display.pump()
        display.let_go()
        press(display, {"action": "hold"})
        press(display, {"action": "end"})
        while not released:
            display.pump()
    assert [one.action for one in flown] == ["hold"]
    assert released == ["release"]


def test_the_page_and_all_it_needs_are_served_here(shown):
    page = urlopen(shown.url).read().decode()
    names = re.findall(r'(?:href|src)="([^"]+)"', page)
    names += re.findall(r'from "\./([^"]+)"', urlopen(f"{shown.url}page.js").read().decode())
    local = [name for name in names if not name.startswith("data:")]
    assert len(local) >= 4
    for name in local:
        body = urlopen(f"{shown.url}{name}").read().decode()
        assert "://" not in body
    assert "://" not in page


def test_the_browser_is_ordered_to_load_nothing_from_elsewhere(shown):
    policy = urlopen(shown.url).headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert set(re.findall(r"-src ([^;]+)", policy)) == {"'none'", "'self'", "'self' data:"}


def test_a_page_that_opens_late_is_reported_what_was_before(shown):
    shown.pump()
    update = json.loads(urlopen(f"{shown.url}state").read())
    assert update["restart"]
    assert update["setting"]["band_m"] == [100.0, 500.0]
    assert len(update["trail"]) == pytest.approx(120, abs=2)
    assert update["state"]["phase"] == "watching"
    assert update["state"]["target"]["quality"] == "good"


def test_a_page_is_sent_only_what_it_has_not(shown):
    shown.pump()
    first = json.loads(urlopen(f"{shown.url}state").read())
    shown.note("something")
    second = json.loads(urlopen(f"{shown.url}state?have={first['at']}").read())
    assert "restart" not in second
    assert "setting" not in second
    assert second["trail"] == []
    assert [text for _, _, text in second["announcements"]] == ["something"]


def test_a_client_with_many_open_maps_learns_why_it_sees_no_other():
    with ExitStack() as stack:
        shown = stack.enter_context(display_at("127.0.0.1"))
        have = json.loads(urlopen(f"{shown.url}state").read())["at"]
        host = urlsplit(shown.url)
        for _ in range(16):  # each waits for news
            client = stack.enter_context(closing(HTTPConnection(host.hostname, host.port)))
            client.request("GET", f"/state?have={have}")
        with pytest.raises(HTTPError) as refused:
            while True:  # the sixteen may not have been taken yet
                urlopen(f"{shown.url}state?have={have}", timeout=0.2)
        assert (refused.value.code, refused.value.read()) == (
            503,
            b"too many live maps are open; close one and load this page again",
        )


def test_a_foreign_name_for_this_machine_is_refused(shown):
    port = urlsplit(shown.url).port
    assert status(shown.url, headers={"Host": f"evil.example:{port}"}) == 403
    assert status(f"{shown.url}state", headers={"Host": f"evil.example:{port}"}) == 403


def test_buttons_come_back_as_requests_at_the_vehicle_s_time(shown):
    assert press(shown, {"action": "hold"}) == 202
    assert press(shown, {"action": "side", "side": "right"}) == 202
    hold, side = requests_after(shown)
    assert (hold.action, hold.side) == ("hold", None)
    assert hold.time_s == pytest.approx(159.9)
    assert (side.action, side.side) == ("side", Side.RIGHT)


def test_the_picture_is_served_and_what_is_clicked_in_it_comes_back(shown):
    assert status(f"{shown.url}picture") == 404
    shown.show_picture(lambda: b"{}\njpeg")
    shown.show_picture(lambda: pytest.fail("a second picture within the same 0.2 s is encoded"))
    shown.pump()
    while not json.loads(urlopen(f"{shown.url}state").read())["setting"]["camera"]:
        shown.pump()
    assert urlopen(f"{shown.url}picture").read() == b"{}\njpeg"
    assert press(shown, {"action": "track", "where": [0.25, 0.75]}) == 202
    (point,) = requests_after(shown)
    assert (point.where, point.time_s) == ((0.25, 0.75), pytest.approx(159.9))
    assert button_of({"action": "track", "where": []})["where"] == []
    for where in ([0.5, 1.2], [0.5, True], [0.5], [0.5, "0.5"], [0.1, 0.2, 0.3]):
        with pytest.raises(ValueError):  # the page's own words are not needed
            button_of({"action": "track", "where": where})


@pytest.mark.parametrize(
    ("pressed", "headers", "answer"),
    [
        ({"action": "hold"}, {"Origin": "http://evil.example"}, 403),
        ({"action": "hold"}, {"Origin": ""}, 403),
        ({"action": "hold"}, {"Content-Type": "text/plain"}, 403),
        ({"action": "hold"}, {"Host": "evil.example"}, 403),
        ({"action": "fly"}, {}, 400),
        ({"action": "side"}, {}, 400),
        ({"action": "hold", "side": "left"}, {}, 400),
        ({"action": ["hold"]}, {}, 400),
        ([], {}, 400),
    ],
)
def test_what_is_no_button_of_the_page_is_refused(shown, pressed, headers, answer):
    assert press(shown, pressed, **headers) == answer
    assert requests_after(shown) == []


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"radius_m": "80"},
        {"radius_m": True},
        {"radius_m": 1e9},
        {"height_m": -5},
        {"side": "x" * 30},
        {"airspeed_m_s": 15},
        [["radius_m", 80]],
    ],
)
def test_a_change_has_known_names_and_plain_values(values):
    with pytest.raises((ValueError, AttributeError)):
        button_of({"action": "change", "values": values})


def test_a_change_is_passed_on(shown):
    assert press(shown, {"action": "change", "values": {"radius_m": 80, "side": "right"}}) == 202
    (change,) = requests_after(shown)
    assert (change.radius_m, change.side) == (80, "right")


def test_a_button_before_anything_flies_is_answered_in_words(capsys):
    with display_at("127.0.0.1") as display:
        announced: list[str] = []
        display._inner.note = announced.append
        press(display, {"action": "hold"})
        while not announced:
            display.pump()
    assert announced == ["hold refused: nothing is flown yet"]


def test_off_loopback_everything_asks_for_the_token(guarded):
    base = guarded.url.partition("?")[0]
    assert [status(base + name) for name in ("", "page.js", "state")] == [403, 403, 403]
    assert status(f"{base}?token=guess") == 403
    headers = {"Origin": base.rstrip("/"), "Content-Type": "application/json"}
    assert status(f"{base}press", data=b'{"action":"end"}', headers=headers) == 403


def test_what_is_announced_has_no_token(tmp_path, monkeypatch):
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))

    async def serve():
        async with served(display_at(OTHER_LOOPBACK), announced.append) as page:
            (file,) = tmp_path.iterdir()
            assert file.stat().st_mode & 0o777 == 0o600
            assert file.read_text() == f"operator: {page.url}\nto watch only: {page.viewer_url}\n"
            assert str(file) in announced[0]
            return [url.rpartition("=")[2] for url in (page.url, page.viewer_url)]

    announced: list[str] = []
    tokens = asyncio.run(serve())
    assert all(tokens)
    assert not [text for text in announced if any(token in text for token in tokens)]
    assert not list(tmp_path.iterdir())


def test_the_printed_address_carries_the_token_and_the_page_keeps_it_out_of_sight(guarded):
    opener = build_opener(HTTPCookieProcessor())
    entered = opener.open(guarded.url)
    assert entered.status == 200
    assert "token" not in entered.url
    assert status(f"{guarded.url.partition('?')[0]}page.js", opener) == 200


def test_a_port_in_use_is_reported(shown):
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(InputError, match=f"{taken.getsockname()[1]}.*--view-port"),
        ViewDisplay(
            {"": Panel(Console(), quiet=True).of()},
            {"": Config()},
            PageAddress("127.0.0.1", taken.getsockname()[1]),
        ),
    ):
        pytest.fail("it came up")


def test_one_aircraft_has_no_button_to_relieve_it(shown):
    assert press(shown, {"action": "relieve", "name": "aircraft-1"}) == 400
    with pytest.raises(ValueError, match="aircraft-9"):
        button_of({"action": "relieve", "name": "aircraft-9"}, frozenset({"aircraft-1"}))
    assert button_of({"action": "relieve", "name": "aircraft-1"}, frozenset({"aircraft-1"}))["name"] == "aircraft-1"


@pytest.mark.parametrize("line", [b'{"action":"change","who":"w"}', b'{"action":"side","side":1}', b"[]"])
def test_nothing_from_the_page_raises_into_the_control_loop(flight, capsys, line):
    with display_at("127.0.0.1") as display:
        display.begin(PLANE, lambda _request: None)
        for _, _, controller in flight(2.0):
            last = controller.snapshot()
        lines = [[], [line, line]]
        display._feed.lines = lambda: lines.pop() if lines else []
        notes = []
        display._inner.note = notes.append
        display._sent_at_s = -1e9
        display.show(last)
        assert sum("a request from the page caused an internal error" in note for note in notes) == 1
        display.encoder.state = None  # the page's own picture fails
        display._sent_at_s = -1e9
        display.show(last)
        display.show(last)
        assert "the page's state caused an internal error" in notes[-1]
        assert "the flight continues" in notes[-1]
