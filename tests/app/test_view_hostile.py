"""A hostile client on the page: requests of forty kinds change nothing, and cost little.

HOSTILE_REQUESTS=10000 python -m pytest tests/app/test_view_hostile.py -s -k changes_nothing   sends this many.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import socket
import ssl
import subprocess
from pathlib import Path
from urllib.request import HTTPCookieProcessor, HTTPSHandler, Request, build_opener, urlopen

import pytest
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.network import Allowances
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.panel import Panel
from sidelong.app.view.server import Access, Listener, Server
from sidelong.estimators.frames import LocalPlane

REQUESTS = int(os.environ.get("HOSTILE_REQUESTS", "240"))
NOT_LOOPBACK_NAME = "127.0.0.2"  # of this machine, but served as to a network: with tokens
GROWTH_MAX_KB = 8192


def display_at(address: PageAddress) -> ViewDisplay:
    return ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": Config()}, address)


@pytest.fixture(scope="module")
def shown(flight):
    with display_at(PageAddress("127.0.0.1", 0)) as display:
        display.watching_began(100.0, None)
        for _, _, controller in flight(20.0):
            display.show(controller.snapshot())
        yield display


@pytest.fixture(scope="module")
def guarded():
    with display_at(PageAddress(NOT_LOOPBACK_NAME, 0)) as display:
        yield display


def port_of(display) -> int:
    return int(display.url.split(":")[2].split("/")[0])


def press_request(host: str, body: bytes, **headers: str) -> bytes:
    """Return a press as the page sends it, with other headers where they are given ('' leaves one out)."""
    usual = {
        "Host": host,
        "Origin": f"http://{host}",
        "Content-Type": "application/json",
        "Content-Length": str(len(body)),
    }
    named = usual | {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [f"{name}: {value}" for name, value in named.items() if value]
    return ("POST /press HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\n").encode() + body


def get(host: str, path: str = "/", *lines: str, method: str = "GET") -> bytes:
    return "\r\n".join((f"{method} {path} HTTP/1.1", f"Host: {host}", *lines, "", "")).encode("latin1")


def hostile(host: str) -> list[bytes]:
    """Return requests of forty kinds, none of which is to be obeyed."""
    hold, deep = b'{"action":"hold"}', b"[" * 1000
    return [
        press_request(host, hold, Origin="http://["),
        press_request(host, hold, Origin="http://evil.example"),
        press_request(host, hold, Origin="null"),
        press_request(host, hold, Origin=""),
        press_request(host, hold, Origin=f"https://{host}"),
        press_request(host, hold, Origin=f"http://{host}.evil.example"),
        press_request(host, hold, Origin=f"http://user@{host}"),
        press_request(host, hold, Host="evil.example", Origin="http://evil.example"),
        press_request(host, hold, Host="[", Origin="http://["),
        press_request(host, hold, Content_Type="text/plain"),
        press_request(host, hold, Content_Type="application/x-www-form-urlencoded"),
        press_request(host, hold, Content_Type=""),
        press_request(host, hold, Sec_Fetch_Site="cross-site"),
        press_request(host, deep),
        press_request(host, b'{"action":' * 100),
        press_request(host, b"x" * 100_000),
        press_request(host, hold + b" " * 100_000),
        press_request(host, b"", Content_Length="1000000000"),
        press_request(host, hold, Content_Length="-1"),
        press_request(host, hold, Content_Length="1e3"),
        press_request(host, hold, Transfer_Encoding="chunked"),
        press_request(host, b"\xff\xfe\x00"),
        press_request(host, b"null"),
        press_request(host, b'{"action":"fly"}'),
        press_request(host, b'{"action":["hold"]}'),
        press_request(host, b'{"action":{"hold":1}}'),
        press_request(host, b'{"action":"side","side":["left"]}'),
        press_request(host, b'{"action":"hold","side":"left"}'),
        press_request(host, b'{"action":"side","side":1e999}'),
        press_request(host, b'{"action":"' + b"9" * 900 + b'"}'),
        get(host, "/press"),
        get(host, "/press", method="PUT"),
        get(host, "/press", "Access-Control-Request-Method: POST", "Origin: http://evil.example", method="OPTIONS"),
        get(host, "/../../etc/passwd"),
        get(host, "/%2e%2e%2fetc%2fpasswd"),
        get(host, "/index.html%00"),
        get(host, "/" + "a" * 10_000),
        get("evil.example", "/state"),
        get(host, "/", "X: " + "y" * 60_000),
        get(host, "/state", "Sec-Fetch-Site: cross-site"),
        get(host, "/state", "Upgrade: websocket", "Connection: Upgrade", "Host: evil.example"),
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\r\n" * 500,
        bytes(2000),
    ]


def answered(display, data: bytes) -> bytes:
    """Send bytes; return the answer's beginning, b'' where there is none."""
    with socket.create_connection((display.url.split("/")[2].split(":")[0], port_of(display)), 5.0) as client:
        with contextlib.suppress(OSError):
            client.sendall(data)
            client.shutdown(socket.SHUT_WR)
        try:
            return client.recv(2000)
        except OSError:
            return b""


def memory_kb(display) -> int:
    status = Path(f"/proc/{display._feed._process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])


@pytest.mark.parametrize("kind", ["local", "guarded"])
def test_a_hostile_client_changes_nothing(kind, shown, guarded):
    display = shown if kind == "local" else guarded
    host = display.url.split("/")[2]
    requests = hostile(host)
    assert len(requests) >= 40
    got: list[object] = []
    display.begin(LocalPlane(47.4, 8.5), got.append)
    rng, statuses, before_kb = random.Random(1), set(), 0
    for number in range(REQUESTS):
        data = requests[number] if number < len(requests) else rng.choice(requests)
        answer = answered(display, data)
        if answer.startswith(b"HTTP/1.1 "):
            statuses.add(int(answer[9:12]))
            allowed = b"200" if data.startswith(b"GET / ") or b"/index" in data else b""
            assert not answer.startswith(b"HTTP/1.1 2") or allowed, (data[:200], answer)
            if answer[9:12] in (b"403", b"404", b"413"):
                assert b"x-frame-options: DENY" in answer
        if number == min(REQUESTS // 2, 1000):
            before_kb = memory_kb(display)
    display.pump()
    assert got == []
    assert 500 not in statuses
    assert {403, 400} <= statuses
    growth_kb = memory_kb(display) - before_kb
    print(f"{kind}: {REQUESTS} requests of {len(requests)} kinds, answers {sorted(statuses)}, {growth_kb} kB more")
    assert growth_kb < GROWTH_MAX_KB
    while (answer := answered(display, get(host))[9:12]) == b"429":
        pass  # the guesses refill within seconds; the test's timeout bounds the wait
    assert answer == (b"200" if kind == "local" else b"403")


def test_many_connections_and_slow_ones_leave_room_for_others(shown):
    idle = []
    for number in range(150):
        with contextlib.suppress(OSError):
            client = socket.create_connection(("127.0.0.1", port_of(shown)), 5.0, (f"127.0.1.{number % 3 + 1}", 0))
            client.sendall(b"GET / HTTP/1.1\r\nHost: 127.")  # and never more
            idle.append(client)
    with urlopen(shown.url) as page:
        assert page.status == 200
    for client in idle:
        client.close()


# -- who ----------------------------------------------------------------------------------------------------------


def press(opener, display, action="hold") -> int:
    base = display.url.partition("?")[0]
    headers = {"Origin": base.rstrip("/"), "Content-Type": "application/json"}
    try:
        data = json.dumps({"action": action}).encode()
        return opener.open(Request(f"{base}press", data=data, headers=headers)).status
    except OSError as error:
        return error.code


def entered(url, *handlers):
    opener = build_opener(HTTPCookieProcessor(), *handlers)
    assert opener.open(url).status == 200
    return opener


def test_one_operator_and_any_number_of_viewers(guarded, flight):
    viewer, first = entered(guarded.viewer_url), entered(guarded.url)
    assert press(viewer, guarded) == 403
    assert press(first, guarded) == 202
    second = entered(guarded.url)
    assert press(first, guarded) == 403  # the buttons have been taken over
    assert press(second, guarded) == 202
    assert viewer.open(guarded.url.partition("?")[0] + "page.js").status == 200
    got: list = []
    announced: list[str] = []
    guarded._inner.note = announced.append
    guarded.begin(LocalPlane(47.4, 8.5), got.append)
    for _, _, controller in flight(1.0):
        guarded.show(controller.snapshot())
    assert press(second, guarded, "end") == 202
    while not got or got[-1].action != "end":
        guarded.pump()
    assert got[-1].who == "operator at 127.0.0.1"
    assert "end by operator at 127.0.0.1" in announced


def test_tokens_cannot_be_guessed_quickly(guarded):
    base = guarded.url.partition("?")[0]
    answers = [answered(guarded, get(base.split("/")[2], f"/?token={number}"))[9:12] for number in range(30)]
    assert answers[0] == b"403"
    assert answers[-1] == b"429"


def test_no_tile_is_read_for_a_client_without_a_token(monkeypatch):
    read, sent = [], []
    monkeypatch.setattr("sidelong.app.view.server.readable_tile", lambda *at: read.append(at))
    server = Server(Access("192.0.2.1", "operator", "viewer"), lambda _press: None)
    server._tiles = object()

    async def send(message):
        sent.append(message)

    def ask(*headers):
        sent.clear()
        scope = {"type": "http", "method": "GET", "path": "/map/1/0/0", "query_string": b"", "root_path": ""}
        scope |= {"headers": [(b"host", b"192.0.2.1"), *headers], "client": ("192.0.2.7", 5000), "scheme": "http"}
        asyncio.run(server.app(scope, None, send))
        return sent[0]["status"]

    assert ask() == 403
    assert read == []
    session = server._access.entered("viewer")
    assert ask((b"cookie", f"sidelong={session}".encode())) == 404  # there is no such tile
    assert len(read) == 1


def test_sessions_are_bounded_and_the_operator_keeps_the_buttons():
    access = Access("192.0.2.1", "operator", "viewer")
    operator = access.entered("operator")
    for _ in range(500):
        assert access.refusal(access.entered("viewer")) == "this page is for watching only"
    assert access.refusal(operator) is None
    assert len(access._sessions) <= 100
    assert access.entered("") is None
    assert access.refusal("") is not None


@pytest.mark.parametrize(
    ("served", "name", "known"),
    [
        ("127.0.0.1", "127.0.0.1:80", True),
        ("127.0.0.1", "localhost", True),
        ("127.0.0.1", "evil.example", False),
        ("127.0.0.1", "192.0.2.1", False),
        ("0.0.0.0", "192.0.2.1:80", True),
        ("0.0.0.0", "evil.example:80", False),
        ("plane.example", "plane.example:80", True),
        ("0.0.0.0", "", False),
    ],
)
def test_only_names_it_is_served_at_are_known(served, name, known):
    assert Access(served, "a", "b").knows_host(name) is known


def test_an_allowance_is_each_client_s_own_and_fills_again():
    allowances = Allowances(3.0, 1.0, senders_max=2)
    assert [allowances.used("one", 0.0) for _ in range(5)] == [True, True, True, False, False]
    assert allowances.used("two", 0.0)
    assert allowances.used("one", 1.0)
    assert not allowances.used("one", 1.0)


# -- TLS and the address ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tls")
    cert, key = folder / "cert.pem", folder / "key.pem"
    options = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    subject = ["-subj", "/CN=sidelong", "-addext", f"subjectAltName=IP:{NOT_LOOPBACK_NAME}"]
    command = ["openssl", "req", "-x509", *options, *subject, "-keyout", key, "-out", cert]
    subprocess.run(command, check=True, capture_output=True)
    return cert, key


def test_the_page_is_served_by_tls_and_its_cookie_goes_nowhere_else(certificate):
    with display_at(PageAddress(NOT_LOOPBACK_NAME, 0, *certificate)) as display:
        assert display.url.startswith("https://")
        trusting = HTTPSHandler(context=ssl.create_default_context(cafile=certificate[0]))
        jar = HTTPCookieProcessor()
        opener = build_opener(jar, trusting)
        assert opener.open(display.url).status == 200
        (cookie,) = jar.cookiejar
        assert cookie.secure
        assert press(opener, display) == 202


def test_a_certificate_that_is_none_is_reported(tmp_path):
    for name in ("cert.pem", "key.pem"):
        (tmp_path / name).write_text("no certificate")
    with (
        pytest.raises(InputError, match="certificate or its key cannot be used"),
        display_at(PageAddress("127.0.0.1", 0, tmp_path / "cert.pem", tmp_path / "key.pem")),
    ):
        pytest.fail("it came up")


@pytest.mark.parametrize(
    "options",
    [
        {"host": ""},
        {"host": " "},
        {"host": "999.0.0.1"},
        {"host": "::1"},
        {"cert": Path("a")},
        {"cert": Path("a"), "key": Path("b")},
    ],
)
def test_an_address_that_cannot_be_is_reported(options):
    with pytest.raises(InputError, match=r"display.host|display.certificate_file|PEM"):
        PageAddress(**options)


def test_connections_without_a_handshake_are_counted(certificate):
    with display_at(PageAddress(NOT_LOOPBACK_NAME, 0, *certificate)) as display:
        idle = [
            socket.create_connection((NOT_LOOPBACK_NAME, port_of(display)), 5.0, ("127.0.1.9", 0)) for _ in range(60)
        ]
        refused = 0
        for client in idle[24:]:
            with contextlib.suppress(ConnectionResetError):
                assert client.recv(1) == b""  # closed at once; those within the limit are left open
            refused += 1
        assert refused == 36
        context = ssl.create_default_context(cafile=certificate[0])
        assert build_opener(HTTPCookieProcessor(), HTTPSHandler(context=context)).open(display.url).status == 200
        for client in idle:
            client.close()


def test_a_connection_without_a_handshake_is_closed_in_time(monkeypatch):
    monkeypatch.setattr("sidelong.app.view.server._REQUEST_WITHIN_S", 0.01)

    async def idle() -> bytes:
        listener = Listener(socket.AF_INET, socket.SOCK_STREAM)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        server = await asyncio.get_running_loop().create_server(asyncio.Protocol, sock=listener, ssl=tls)
        reader, writer = await asyncio.open_connection(*listener.getsockname())
        end = await reader.read()  # nothing is sent: only the time limit ends this
        writer.close()
        server.close()
        return end

    assert asyncio.run(idle()) == b""


def test_the_right_token_does_not_pass_while_guesses_are_spent(certificate):
    with display_at(PageAddress(NOT_LOOPBACK_NAME, 0)) as display:
        host = display.url.split("/")[2]
        for number in range(12):
            answered(display, get(host, f"/?token={number}"))
        assert answered(display, get(host, "/" + display.url.split("/", 3)[3]))[9:12] == b"429"
