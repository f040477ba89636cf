"""The map under the live map: what is served of its file, and what is refused before anything is connected."""

from __future__ import annotations

import io
import sqlite3
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from matplotlib.image import imsave
from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import Writer
from rich.console import Console
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.view.address import PageAddress
from sidelong.app.view.background import MbTiles, background, readable_tile
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.panel import Panel
from sidelong.estimators.frames import LocalPlane

PLANE = LocalPlane(47.4, 8.5)
ZOOM, COLUMN, ROW = 12, 2144, 1434  # 47.4, 8.5 lies in it


def picture(value=0.5):
    written = io.BytesIO()
    imsave(written, np.full((256, 256, 3), value), format="png")
    return written.getvalue()


def mbtiles(path, data):
    with sqlite3.connect(path) as database:
        database.execute(
            "create table tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        rows = [(ZOOM, COLUMN + i, (1 << ZOOM) - 1 - (ROW + j), data) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        database.executemany("insert into tiles values (?, ?, ?, ?)", rows)
    return path


def with_wrong_zoom(path):
    mbtiles(path, picture())
    with sqlite3.connect(path) as database:  # SQLite quotes a text that is not UTF-8 in its message
        database.execute("update tiles set zoom_level = cast(X'890a' as text)")
    return path


def pmtiles(path, data):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.write_tile(zxy_to_tileid(ZOOM, COLUMN, ROW), data)
        header = {"tile_type": TileType.PNG, "tile_compression": Compression.NONE, "min_zoom": ZOOM, "max_zoom": ZOOM}
        bounds = {"min_lon_e7": 0, "min_lat_e7": 0, "max_lon_e7": 0, "max_lat_e7": 0}
        writer.finalize(header | bounds | {"center_zoom": ZOOM, "center_lon_e7": 0, "center_lat_e7": 0}, {})
    return path


@pytest.mark.parametrize("make", [mbtiles, pmtiles])
def test_a_tile_is_found_where_the_world_has_it(tmp_path, make):
    under = background(make(tmp_path / f"a.{make.__name__}", picture()), None)
    assert under.zooms == (ZOOM, ZOOM)
    tiles = under.opened()
    assert tiles.tile(ZOOM, COLUMN, ROW) == picture()
    assert tiles.tile(ZOOM, COLUMN, ROW + 7) is None


def written(path, data):
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("make", "bounds", "sentence"),
    [
        (lambda folder: folder / "none.mbtiles", None, "is no file; give one that ends in .mbtiles, .pmtiles"),
        (lambda folder: written(folder / "a.mbtiles", b"x" * 2000), None, "is not a mbtiles file that can be read"),
        (lambda folder: written(folder / "a.pmtiles", b"x" * 2000), None, "is not a pmtiles file that can be read"),
        (lambda folder: with_wrong_zoom(folder / "a.mbtiles"), None, "Could not decode to UTF-8"),
        (lambda folder: mbtiles(folder / "a.mbtiles", b"\x1f\x8bvector"), None, "not vector ones"),
        (lambda folder: mbtiles(folder / "a.mbtiles", picture()), (1, 2, 3, 4), "tiles know where they lie"),
        (lambda folder: written(folder / "a.png", picture()), None, "add display.map_bounds = [S, W, N, E]"),
        (lambda folder: written(folder / "a.png", picture()), (47.5, 8, 47.3, 9), "is no [S, W, N, E] in degrees"),
        (lambda folder: written(folder / "a.tif", b"II*\0"), (47, 8, 48, 9), "is no map that can be shown"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_sentence(tmp_path, make, bounds, sentence):
    with pytest.raises(InputError) as refused:
        background(make(tmp_path), bounds)
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_wrong_map_ends_launch_before_anything_is_connected(tmp_path):
    ended = CliRunner().invoke(app, ["launch", "--view", "--set", f"display.map_file={tmp_path / 'none.mbtiles'}"])
    assert ended.exit_code != 0
    assert "there is no file" in str(ended.exception)


def test_tiles_are_served_and_nothing_else_of_the_file(tmp_path):
    under = background(mbtiles(tmp_path / "a.mbtiles", picture()), None)
    with ViewDisplay(
        {"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(port=0, map=under)
    ) as display:
        with urlopen(f"{display.url}map/{ZOOM}/{COLUMN}/{ROW}") as answer:
            assert answer.read() == picture()
            assert answer.headers["Content-Type"] == "image/png"
            assert answer.headers.get_all("Cache-Control") == ["private, max-age=3600"]
        for path in (f"map/{ZOOM}/{COLUMN}/{ROW + 9}", "map/99/0/0", f"map/{ZOOM}/{1 << ZOOM}/0", "map", "shade"):
            with pytest.raises(HTTPError) as missing:
                urlopen(f"{display.url}{path}")
            assert missing.value.code == 404


def test_the_map_lies_where_the_flight_is(browser, tmp_path, flight):
    under = background(mbtiles(tmp_path / "a.mbtiles", picture()), None)
    with ViewDisplay(
        {"": Panel(Console(), quiet=True).of()}, {"": Config()}, PageAddress(port=0, map=under)
    ) as display:
        display.begin(PLANE, lambda _wish: None)
        display.watching_began(100.0, None)
        for _, _, controller in flight(5.0):
            display.show(controller.snapshot())
        display.pump()
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        page.goto(display.url)
        page.locator("#map .tile").first.wait_for(state="attached")
        page.wait_for_function("[...document.querySelectorAll('#map .tile')].every((one) => one.getBBox().width > 0)")
        names = (
            f"#map .tile[href='map/{ZOOM}/{COLUMN}/{ROW}']",
            "#map .ring + .ring",
        )  # the ring is 1 km across
        box, ring = page.evaluate(
            "all => all.map((name) => document.querySelector(name).getBoundingClientRect().toJSON())", names
        )
        target_m = controller.estimate.position_m(controller.time_s)
        page.context.close()
    px_per_m = ring["width"] / 1000.0
    west_deg, north_deg = 8.4375, 47.398349200359256  # the tile's corner, by mercantile
    corner_m = PLANE.east_north_m(north_deg, west_deg)
    middle = ring["x"] + ring["width"] / 2, ring["y"] + ring["height"] / 2
    assert (box["x"] - middle[0]) / px_per_m == pytest.approx(corner_m[0] - target_m[0], abs=15.0)
    assert (middle[1] - box["y"]) / px_per_m == pytest.approx(corner_m[1] - target_m[1], abs=15.0)


ENDLESS = """create view tiles as with recursive n(k) as (select 1 union all select k + 1 from n)
    select {zoom} as zoom_level, k as tile_column, k as tile_row, x'89504e470d0a1a0a' as tile_data from n {where}"""


def view_file(path, where, zoom="k"):
    with sqlite3.connect(path) as database:
        database.execute(ENDLESS.format(where=where, zoom=zoom))
    return path


def test_an_endless_view_is_refused_after_a_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("sidelong.app.view.background._OPEN_WITHIN_S", 0.2)
    with pytest.raises(InputError, match=r"is not a mbtiles file that can be read \(interrupted\)"):
        background(view_file(tmp_path / "endless.mbtiles", "where k < 0"), None)


def test_a_tile_of_an_endless_view_is_not_waited_for(tmp_path, monkeypatch):
    tiles = MbTiles(view_file(tmp_path / "bounded.mbtiles", "limit 100"))
    assert tiles.tile(5, 5, 26) is not None
    monkeypatch.setattr("sidelong.app.view.background._TILE_WITHIN_S", -1.0)
    assert readable_tile(MbTiles(view_file(tmp_path / "b.mbtiles", "limit 100000")), 99, 7, 7) is None


def test_a_value_beyond_the_size_limit_is_not_read(tmp_path):
    path = tmp_path / "large.mbtiles"
    with sqlite3.connect(path) as database:
        database.execute(
            "create view tiles as select 1 as zoom_level, 0 as tile_column, 0 as tile_row, "
            "zeroblob(900000000) as tile_data"
        )
    with pytest.raises(InputError, match="too big"):
        background(path, None)
