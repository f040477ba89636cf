from __future__ import annotations

import gzip
import json
import math
import os
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.errors import InputError
from sidelong.app.terrain.elevation_data import ElevationData, Posts
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from tests.terrain.patch import patch_of

HOME_DEG = (36.59, -84.24)
STEP_DEG = 1.0 / 1200.0


def test_the_posts_of_a_tile_are_found_where_its_format_puts_them(
    hills_folder: Path, tile_heights: np.ndarray
) -> None:
    data = ElevationData(hills_folder)
    rng = np.random.default_rng(1)
    for row, column in rng.integers((350, 720), (640, 1090), size=(50, 2)):
        latitude_deg, longitude_deg = 37.0 - row * STEP_DEG, -85.0 + column * STEP_DEG
        assert data.height_above_sea_m(latitude_deg, longitude_deg) == tile_heights[row, column]


def test_the_ground_counts_from_home_and_lies_in_the_plane(
    ground: Ground, hills_folder: Path, plane: LocalPlane
) -> None:
    data = ElevationData(hills_folder)
    home_m = data.height_above_sea_m(*HOME_DEG)
    assert ground.height_m(0.0, 0.0) == pytest.approx(0.0, abs=1e-3)
    places = np.random.default_rng(5).uniform(-9000.0, 9000.0, (300, 2))
    there = [data.height_above_sea_m(*plane.latitude_longitude_deg(*place)) - home_m for place in places]
    off_m = ground.heights_at_m(*places.T) - there
    assert np.sqrt(np.mean(off_m**2)) < 1.0  # posts of 46 m between posts of 75 x 93 m
    assert abs(off_m.mean()) < 0.1


def test_what_no_tile_knows_is_void(ground: Ground) -> None:
    assert math.isnan(ground.height_m(0.0, 24_000.0))
    assert patch_of(ground, 0.0, 24_000.0) is None


def test_neighbouring_tiles_join_without_a_seam(tmp_path: Path) -> None:
    """A plane that rises by 1 m a post: two tiles of 3 seconds, one of 1 second, reported by the same formula."""

    def write(name: str, latitude_deg: int, longitude_deg: int, side: int) -> None:
        north = latitude_deg + 1 - np.arange(side) / (side - 1)
        east = longitude_deg + np.arange(side) / (side - 1)
        ((north[:, None] - 40.0) * 1200.0 + (east[None, :] - 10.0) * 1200.0).round().astype(">i2").tofile(
            tmp_path / name
        )

    write("N40E010.hgt", 40, 10, 1201)
    write("N40E011.hgt", 40, 11, 3601)
    home_deg = (40.5, 10.999)
    ground = ElevationData(tmp_path).ground(LocalPlane(*home_deg), home_deg, 4.0, reach_m=3000.0)
    east_m = np.linspace(-2500.0, 2500.0, 201)
    heights_m = ground.heights_at_m(east_m, np.zeros_like(east_m))
    slope = 1.0 / (LocalPlane(*home_deg).east_north_m(40.5, 10.999 + STEP_DEG)[0])
    assert np.abs(heights_m - slope * east_m).max() < 1.0  # both are rounded to metres


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("N36W085.hgt", 1_000_000, "has 1,000,000 bytes where an SRTM tile has 2,884,802 or 25,934,402"),
        ("N36W085.hgt", 0, "has 0 bytes"),
        ("hills.hgt", 2_884_802, "is not named after its south-west corner"),
        ("N99W085.hgt", 2_884_802, "no place on earth"),
    ],
)
def test_a_damaged_tile_is_one_sentence(tmp_path: Path, name: str, size: int, words: str) -> None:
    (tmp_path / name).write_bytes(bytes(size))
    with pytest.raises(InputError) as error:
        ElevationData(tmp_path)
    assert words in str(error.value)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_heights_that_no_place_has_count_as_void(tmp_path: Path, tile_heights: np.ndarray) -> None:
    damaged = tile_heights.copy()
    damaged[400:420, 800:820] = 31_000
    damaged.astype(">i2").tofile(tmp_path / "N36W085.hgt")
    data = ElevationData(tmp_path)
    assert math.isnan(data.height_above_sea_m(37.0 - 410 * STEP_DEG, -85.0 + 810 * STEP_DEG))
    assert data.height_above_sea_m(37.0 - 421 * STEP_DEG, -85.0 + 821 * STEP_DEG) == tile_heights[421, 821]


def test_next_to_a_void_nothing_is_known(tmp_path: Path, tile_heights: np.ndarray) -> None:
    tile = tile_heights.copy()
    tile[500, 900] = -32768
    tile.astype(">i2").tofile(tmp_path / "N36W085.hgt")
    ground = ElevationData(tmp_path).ground(LocalPlane(*HOME_DEG), HOME_DEG, 4.0)
    east_m, north_m = LocalPlane(*HOME_DEG).east_north_m(37.0 - 500 * STEP_DEG, -85.0 + 900 * STEP_DEG)
    assert math.isnan(ground.height_m(east_m + 30.0, north_m + 30.0))
    assert not math.isnan(ground.height_m(east_m + 180.0, north_m))


@pytest.mark.parametrize(
    ("home_deg", "words"),
    [((36.1, -84.9), "void at home"), ((47.4, 8.5), "add N47E008.hgt")],
)
def test_home_without_data_is_one_sentence(hills_folder: Path, home_deg: tuple[float, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        ElevationData(hills_folder).ground(LocalPlane(*home_deg), home_deg, 4.0)


@pytest.mark.parametrize("name", ["N36W085.hgt.zip", "N36W085.SRTMGL3.hgt.zip", "tiles.zip", "N36W085.hgt.gz"])
def test_a_zipped_tile_is_read_like_the_tile(tmp_path: Path, hills_folder: Path, name: str) -> None:
    tile, packed = hills_folder / "N36W085.hgt", tmp_path / name
    if name.endswith(".gz"):
        packed.write_bytes(gzip.compress(tile.read_bytes(), 1))
    else:
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(tile, "dem/N36W085.hgt")
    same, own = ElevationData(tmp_path), ElevationData(hills_folder)
    posts = Posts(36.5, -84.3, STEP_DEG, STEP_DEG, 60, 60)
    np.testing.assert_array_equal(same.read(posts), own.read(posts))


def test_a_damaged_archive_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "N36W085.hgt.zip").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(InputError, match=r"N36W085\.hgt\.zip: is no readable archive"):
        ElevationData(tmp_path)
    with zipfile.ZipFile(tmp_path / "N36W085.hgt.zip", "w") as archive:
        archive.writestr("N36W085.hgt", bytes(1000))
    with pytest.raises(InputError, match=r"N36W085\.hgt\.zip: has 1,000 bytes where an SRTM tile has"):
        ElevationData(tmp_path)
    with zipfile.ZipFile(tmp_path / "N36W085.hgt.zip", "w") as archive:
        archive.writestr("readme.txt", "no tile")
    with pytest.raises(InputError, match="holds no elevation data"):
        ElevationData(tmp_path)


def test_folders_without_data_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        ElevationData(tmp_path / "nowhere")
    with pytest.raises(InputError, match="holds no elevation data"):
        ElevationData(tmp_path)
    (tmp_path / "notes.txt").write_text("hills")
    with pytest.raises(InputError, match="give such a file or a folder of them"):
        ElevationData(tmp_path / "notes.txt")


def test_a_hundred_fine_tiles_take_no_more_memory_than_the_window(tmp_path: Path) -> None:
    """2.6 GB of tiles on disk (holes in the file, zeros when read); the window is 13 MB."""
    for latitude_deg in range(40, 50):
        for longitude_deg in range(10, 20):
            with (tmp_path / f"N{latitude_deg}E{longitude_deg:03d}.hgt").open("wb") as file:
                file.truncate(2 * 3601 * 3601)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    home_deg = (45.0, 15.0)  # where four tiles meet
    ground = ElevationData(tmp_path).ground(LocalPlane(*home_deg), home_deg, 4.0)
    assert np.isfinite(ground.heights_m).all()
    assert ground.heights_m.nbytes < 30_000_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 400_000


def test_the_command_reports_coverage_and_voids(hills_folder: Path, tile_heights: np.ndarray, tmp_path: Path) -> None:
    summary = tmp_path / "coverage.json"
    arguments = ["terrain", str(hills_folder), "--bounds", "36,-85,37,-83", "--json", str(summary)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    given = json.loads(summary.read_text())
    share = float((tile_heights > -500).mean())
    assert given["covered"] == pytest.approx(share / 2.0, rel=0.01)
    assert given["void"] == pytest.approx((1.0 - share) / 2.0, rel=0.01)
    assert given["tiles"][0]["min_height_m"] == 236
    assert given["tiles"][0]["max_height_m"] == 1076
    assert "N36W085.hgt" in result.output
    assert "% without a tile" in result.output


@pytest.mark.parametrize("bounds", ["36,-85,37", "37,-85,36,-84", "a, b, c, d", "36,-85,37,-185"])
def test_bounds_that_are_none_are_one_sentence(hills_folder: Path, bounds: str) -> None:
    result = CliRunner().invoke(app, ["terrain", str(hills_folder), "--bounds", bounds])
    assert isinstance(result.exception, InputError)
    assert "--bounds" in str(result.exception)


# -- GeoTIFF -----------------------------------------------------------------------------------------------


def write_geotiff(
    path: Path,
    heights: np.ndarray,
    crs: str | None,
    transform: object,
    nodata: float,
    dtype: str = "float32",
    count: int = 1,
) -> None:
    rasterio = pytest.importorskip("rasterio")
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": count, "dtype": dtype}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, nodata=nodata, **shape) as file:
        for band in range(count):
            file.write(heights.astype(dtype), band + 1)


def hills_geotiff(path: Path, tile_heights: np.ndarray) -> None:
    transform = pytest.importorskip("rasterio.transform")
    part = tile_heights[340:640, 720:1080].astype(np.float32)
    # Pixels are areas: the first one's corner lies half a post to the north-west of its height.
    corner = transform.from_origin(-85.0 + 719.5 * STEP_DEG, 37.0 - 339.5 * STEP_DEG, STEP_DEG, STEP_DEG)
    write_geotiff(path, part, "EPSG:4326", corner, -32768.0)


def test_a_geotiff_reports_the_same_ground_as_the_tile(
    ground: Ground, tile_heights: np.ndarray, tmp_path: Path, plane: LocalPlane
) -> None:
    hills_geotiff(tmp_path / "hills.tif", tile_heights)
    same = ElevationData(tmp_path).ground(plane, HOME_DEG, 4.0)
    places = np.random.default_rng(2).uniform(-6000.0, 6000.0, (2, 500))
    assert np.abs(same.heights_at_m(*places) - ground.heights_at_m(*places)).max() < 0.05


def test_a_projected_geotiff_is_turned_into_place(
    ground: Ground, tile_heights: np.ndarray, tmp_path: Path, plane: LocalPlane
) -> None:
    warp = pytest.importorskip("rasterio.warp")
    rasterio = pytest.importorskip("rasterio")
    hills_geotiff(tmp_path / "hills.tif", tile_heights)
    with rasterio.open(tmp_path / "hills.tif") as file:
        source, bounds = file.read(1), file.bounds
        transform, width, height = warp.calculate_default_transform(
            file.crs, "EPSG:32616", file.width, file.height, *bounds
        )
        turned = np.full((height, width), -32768.0, np.float32)
        warp.reproject(
            source,
            turned,
            src_transform=file.transform,
            src_crs=file.crs,
            dst_transform=transform,
            dst_crs="EPSG:32616",
            src_nodata=-32768.0,
            dst_nodata=-32768.0,
            resampling=warp.Resampling.bilinear,
        )
    folder = tmp_path / "utm"
    folder.mkdir()
    write_geotiff(folder / "hills.tif", turned, "EPSG:32616", transform, -32768.0)
    turned_data, own_data = ElevationData(folder), ElevationData(tmp_path / "hills.tif")
    posts = Posts(36.55, -84.30, STEP_DEG, STEP_DEG, 120, 120)
    own = own_data.read(posts)
    off_m = turned_data.read(posts) - own
    # Interpolated twice more, peaks and valleys are cut; a shift by a post would be an error along the slope.
    assert abs(np.mean(off_m)) < 0.5
    for slope in np.gradient(own):
        assert abs(np.sum(off_m * slope) / np.sum(slope**2)) < 0.1  # posts


def test_damaged_geotiffs_are_one_sentence(tile_heights: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "hills.tif").write_bytes(b"no raster at all")
    with pytest.raises(InputError, match=r"hills\.tif: is no readable GeoTIFF"):
        ElevationData(tmp_path)
    hills_geotiff(tmp_path / "hills.tif", tile_heights)
    whole = (tmp_path / "hills.tif").read_bytes()
    (tmp_path / "hills.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"hills\.tif: "):
        ElevationData(tmp_path).ground(LocalPlane(*HOME_DEG), HOME_DEG, 4.0)


def test_a_geotiff_without_a_place_is_one_sentence(tmp_path: Path) -> None:
    transform = pytest.importorskip("rasterio.transform")
    write_geotiff(tmp_path / "a.tif", np.ones((20, 20)), None, transform.from_origin(0, 0, 1, 1), -1.0)
    with pytest.raises(InputError, match="no coordinate system"):
        ElevationData(tmp_path)


@pytest.mark.parametrize(
    ("crs", "dtype", "count", "words"),
    [
        ('LOCAL_CS["site",UNIT["metre",1]]', "float32", 1, "cannot be converted to latitude"),
        ("+proj=longlat +a=1737400 +b=1737400 +no_defs", "float32", 1, "cannot be converted to latitude"),
        ("EPSG:4978", "float32", 1, "no raster of heights"),
        ("EPSG:4326", "uint8", 3, "is a picture"),
        ("EPSG:4326", "complex64", 1, "is a picture"),
    ],
)
def test_a_geotiff_that_is_no_ground_is_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], crs: str, dtype: str, count: int, words: str
) -> None:
    transform = pytest.importorskip("rasterio.transform")
    corner = transform.from_origin(10.0, 40.0, STEP_DEG, STEP_DEG)
    write_geotiff(tmp_path / "a.tif", np.full((20, 20), 100.0), crs, corner, 0.0, dtype, count)
    capfd.readouterr()
    with pytest.raises(InputError, match=words) as error:
        ElevationData(tmp_path)
    assert "a.tif" in str(error.value)
    assert "\n" not in str(error.value)
    assert capfd.readouterr().err == ""


def test_a_list_of_other_files_is_no_geotiff(tile_heights: np.ndarray, tmp_path: Path) -> None:
    """GDAL would follow it, to any file and over the network."""
    shutil = pytest.importorskip("rasterio.shutil")
    hills_geotiff(tmp_path / "hills.tif", tile_heights)
    (tmp_path / "list").mkdir()
    shutil.copy(tmp_path / "hills.tif", tmp_path / "list" / "hills.tif", driver="VRT")
    with pytest.raises(InputError, match="is no readable GeoTIFF"):
        ElevationData(tmp_path / "list")


@pytest.mark.parametrize("name", ["N36W085.hgt", "hills.tif"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "loop"])
def test_what_is_no_file_is_not_waited_for(tmp_path: Path, name: str, kind: str) -> None:
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(path)
    with pytest.raises(InputError, match="is no file that can be read"):
        ElevationData(tmp_path)


def test_scales_and_feet_are_heeded(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    path, corner = tmp_path / "a.tif", rasterio.transform.from_origin(10.0, 40.0, STEP_DEG, STEP_DEG)
    write_geotiff(path, np.full((20, 20), 2000), "EPSG:4326", corner, -32768, "int16")
    for unit, scale, offset, height_m in (
        ("m", 1.0, 0.0, 2000.0),
        ("m", 0.1, 5.0, 205.0),
        ("ft", 0.5, 10.0, 307.848),
    ):
        with rasterio.open(path, "r+") as file:
            file.units, file.scales, file.offsets = (unit,), (scale,), (offset,)
        assert ElevationData(path).height_above_sea_m(39.995, 10.005) == pytest.approx(height_m, abs=0.01)
    with rasterio.open(path, "r+") as file:
        file.units = ("fathom",)
    with pytest.raises(InputError, match="heights in fathom; write it in metres or feet"):
        ElevationData(path)


def test_ten_billion_pixels_are_not_unpacked(tmp_path: Path) -> None:
    """A sparse file of a megabyte; a place in it is reported, all of it is not."""
    rasterio = pytest.importorskip("rasterio")
    path, side = tmp_path / "a.tif", 100_000
    corner = rasterio.transform.from_origin(10.0, 41.0, 1e-5, 1e-5)
    shape = {"height": side, "width": side, "count": 1, "dtype": "float32", "crs": "EPSG:4326", "transform": corner}
    with rasterio.open(path, "w", driver="GTiff", tiled=True, sparse_ok=True, BIGTIFF="YES", **shape):
        pass
    data = ElevationData(path)
    assert data.height_above_sea_m(40.5, 10.5) == 0.0
    with pytest.raises(InputError, match=r"pixels there, 400,000,000 at most serve; make it coarser"):
        data.ground(LocalPlane(40.5, 10.5), (40.5, 10.5))


def test_a_fine_geotiff_is_thinned_out_while_it_is_read(tmp_path: Path) -> None:
    """5,000 x 5,000 pixels of 2 m; a window of all of it at 20 m is what a plane reports."""
    transform = pytest.importorskip("rasterio.transform")
    step_deg = 2.0 / 111_320.0
    count = 3000
    heights = np.add.outer(np.arange(count)[::-1] * 0.1, np.arange(count) * 0.2)
    corner = transform.from_origin(10.0, 40.0, step_deg, step_deg)
    write_geotiff(tmp_path / "fine.tif", heights, "EPSG:4326", corner, -9999.0)
    south_deg, west_deg = 40.0 - (count - 0.5) * step_deg, 10.0 + 0.5 * step_deg
    posts = Posts(south_deg + 100 * step_deg, west_deg + 100 * step_deg, 10 * step_deg, 10 * step_deg, 250, 250)
    found = ElevationData(tmp_path).read(posts)
    expected = np.add.outer((100 + 10 * np.arange(250)) * 0.1, (100 + 10 * np.arange(250)) * 0.2)
    assert np.abs(found - expected).max() < 1.5  # half a thinned pixel of slope
