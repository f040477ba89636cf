"""The live map against another site in the same browser: it can neither press, nor read, nor frame, nor rename it."""

from __future__ import annotations

import http.server
import threading
from contextlib import contextmanager

import pytest
from rich.console import Console

from sidelong.app.config import Config
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.panel import Panel
from sidelong.estimators.frames import LocalPlane

# Everything that a site may try against a page on this machine; each try reports in the title that it is over.
ATTACK = """<!doctype html><title>0</title>
<iframe id=framed src="{url}"></iframe>
<iframe name=answer></iframe>
<form id=form method=post target=answer action="{url}press" enctype="text/plain">
<input name='{{"action":"end","x":"' value='"}}'></form>
<script>
const over = () => {{ document.title = String(Number(document.title) + 1); }};
window.read = [];
const attempt = (path, options) => fetch("{url}" + path, options)
  .then((answer) => answer.text()).then((text) => window.read.push(text)).catch(() => 0).finally(over);
attempt("press", {{ method: "POST", mode: "no-cors", body: '{{"action":"end"}}' }});
attempt("press", {{ method: "POST", body: '{{"action":"end"}}', headers: {{ "Content-Type": "application/json" }} }});
attempt("", {{}});
attempt("", {{ mode: "no-cors" }});
attempt("state", {{}});
document.getElementById("form").submit();
document.getElementsByName("answer")[0].onload = over;
</script>"""
TRIES = 6


@pytest.fixture
def display(flight):
    with ViewDisplay({"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(port=0)) as display:
        display.begin(LocalPlane(47.4, 8.5), lambda _request: None)
        display.watching_began(100.0, None)
        for _, _, controller in flight(110.0):
            snapshot = controller.snapshot()
        display.show(snapshot)
        display.pump()
        yield display


@contextmanager
def served(content: str):
    """Serve a page of another site; its name leads to this machine, as a rebound one would."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(content.encode())

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://evil.localhost:{server.server_port}/"
    server.shutdown()
    thread.join()
    server.server_close()


def test_another_site_presses_reads_and_frames_nothing(browser, display):
    got = []
    display.begin(LocalPlane(47.4, 8.5), got.append)
    with served(ATTACK.format(url=display.url)) as site:
        page = browser.new_context().new_page()
        page.goto(site)
        page.wait_for_function(f"document.title === '{TRIES}'")
        assert [text for text in page.evaluate("window.read") if text] == []
        framed = page.frames[1]
        assert framed.parent_frame == page.main_frame
        assert framed.locator("#phase").count() == 0
        page.context.close()
    page = browser.new_context().new_page()
    page.goto(display.url)
    page.get_by_role("button", name="Hold", exact=True).click()
    page.get_by_role("dialog").get_by_role("button", name="Yes", exact=True).click()
    while not got:
        display.pump()
    assert [request.action for request in got] == ["hold"]
    page.context.close()


def test_a_foreign_name_that_leads_here_shows_nothing(browser, display):
    port = display.url.rsplit(":", 1)[1].strip("/")
    page = browser.new_context().new_page()
    answer = page.goto(f"http://evil.localhost:{port}/")
    assert answer.status >= 400
    assert page.locator("#phase").count() == 0
    pressed = page.evaluate("""() => fetch("/press", {method: "POST", body: '{"action":"end"}',
        headers: {"Content-Type": "application/json"}}).then((answer) => answer.status)""")
    assert pressed >= 400
    page.context.close()
