"""A replay served on the page until it is left."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable

from sidelong.app.config import Config
from sidelong.app.view.address import PageAddress
from sidelong.app.view.frames import Frames, Player
from sidelong.app.view.picture import PictureFile
from sidelong.app.view.process import page_line, start_page, under_flight
from sidelong.app.view.shading import Shading
from sidelong.app.view.state import setting

_EVERY_S = 0.125


def serve_replay(
    frames: Frames,
    what_if: Frames | None,
    config: Config,
    address: PageAddress,
    name: str,
    speed: float,
    announce: Callable[[str], object],
    film: Callable[[float], bytes | None] | None = None,
) -> None:
    """Serve until Ctrl-C, or until the page's process ends.

    Args:
        announce: Receives the page's address.
        film: Returns the camera's picture of a time.
    """
    player = Player(frames, speed, time.monotonic, what_if)
    feed, url, _ = start_page(address, replay=True)
    has_ground = config.terrain.folder is not None
    shading = Shading(config, frames.plane) if has_ground and frames.plane is not None else None
    setting_sent = False
    pictures = None if film is None else PictureFile()
    announce(f"replay: {url} (Ctrl-C ends it)")
    try:
        with contextlib.suppress(KeyboardInterrupt):
            while feed.alive:
                for line in feed.lines():
                    player.pressed(json.loads(line))
                if feed.ready:
                    update = player.update() | {"made_s": time.monotonic()}
                    new_shade = shading is not None and shading.is_new()
                    if not setting_sent or new_shade:
                        base = setting(config, frames.plane, name, routes=frames.routes.values())
                        update["setting"] = (
                            base | {"replay": player.setting} | under_flight(address, shading, pictures)
                        )
                        setting_sent = True
                    if pictures is not None and film is not None:
                        update["picture"] = str(pictures.file)
                        picture = film(player.at_s)
                        if picture is not None:
                            pictures.put(lambda picture=picture: picture)  # type: ignore[misc]
                    if new_shade and shading is not None:
                        update["shade"] = str(shading.file)
                    feed.send(page_line(update))
                time.sleep(_EVERY_S)
    finally:
        feed.close()
        for one in (shading, pictures):
            if one is not None:
                one.close()
