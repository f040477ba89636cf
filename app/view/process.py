"""Start the page's process, and send it the data common to flights and replays."""

from __future__ import annotations

import json
import secrets
from collections.abc import Sequence

from sidelong.app.errors import InputError
from sidelong.app.interpreter import helper_command, helper_environment
from sidelong.app.view.address import Address
from sidelong.app.view.feed import Feed, FeedError
from sidelong.app.view.shading import Shading
from sidelong.app.view.state import Json

_UP_S = 30.0  # a second or two; a machine that is busy takes many times that


def start_page(address: Address, replay: bool = False, fleet: Sequence[str] = ()) -> tuple[Feed, str, str]:
    """Start the server and wait for it.

    Args:
        address: Where the page is served.
        replay: Accept only the requests of a replay's page.
        fleet: The names of the aircraft that may be relieved.

    Returns:
        The feed to the server, and the URLs for the operator and for viewers.

    Raises:
        InputError: The server does not start, for example because the port is in use.
    """
    host, port, under = address.host, address.port, address.map
    token, viewer_token = ("", "") if address.is_local else (secrets.token_urlsafe(16), secrets.token_urlsafe(16))
    feed = Feed(helper_command("sidelong.app.view"), helper_environment())
    options: Json = {"host": host, "port": port, "operator_token": token, "viewer_token": viewer_token}
    options["map"] = under and {"path": str(under.path.absolute()), "zooms": under.zooms}
    options |= {"cert": address.cert and str(address.cert), "key": address.key and str(address.key)}
    options |= {"replay": replay, "fleet": list(fleet)}
    feed.send(page_line(options))
    try:
        ready = json.loads(feed.wait_for_line(_UP_S))
    except FeedError as error:
        raise InputError(f"the page cannot be shown on {host}:{port}: {error}; try another --view-port.") from error
    url = f"{address.scheme}://{host}:{ready['port']}/"
    return (feed, f"{url}?token={token}", f"{url}?token={viewer_token}") if token else (feed, url, url)


def under_flight(address: Address, shading: Shading | None) -> Json:
    """Return the page's settings for map and ground."""
    under = address.map
    layers = None if under is None else {"zooms": under.zooms, "bounds_deg": under.bounds_deg}
    return {"map": layers, "shade_m": None if shading is None else shading.edges_m}


def page_line(values: Json) -> bytes:
    """Return a line for the page's process."""
    return json.dumps(values, separators=(",", ":"), allow_nan=False).encode()
