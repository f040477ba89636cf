"""GeoTIFF files through rasterio, which comes with the extra ``terrain``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sidelong.app.errors import InputError, missing_package
from sidelong.app.terrain.tile import HIGHEST_M, LOWEST_M, HeightArray, Posts, at_posts, needed

_MARGIN = 1e-9
_METRES = dict.fromkeys(("", "m", "metre", "meter", "metres", "meters"), 1.0)
_METRES |= dict.fromkeys(("ft", "foot", "feet"), 0.3048) | dict.fromkeys(("us-ft", "us survey foot"), 1200.0 / 3937.0)
# This number of pixels is decimated in a few seconds; they must be unpacked for it.
_PIXELS_MAX = 400_000_000


class GeoTiff:
    """See :class:`sidelong.app.terrain.tile.Tile`. Any projection; the first band is the height above sea level."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            import rasterio  # noqa: PLC0415  # an extra: SRTM tiles do without it
            from rasterio.vrt import WarpedVRT  # noqa: PLC0415
        except ImportError as error:
            raise missing_package(f"{path}: a GeoTIFF", "rasterio", "give .hgt tiles") from error
        try:
            with rasterio.Env():  # else errors are printed
                # Another format might be a list of other files, or of addresses.
                dataset = rasterio.open(path, driver="GTiff")
        except Exception as error:  # here and below: those of GDAL have no public class
            raise InputError(f"{path}: is no readable GeoTIFF ({error}); replace it.") from error
        self._check(dataset)
        try:
            with rasterio.Env():
                self._raster: Any = WarpedVRT(dataset, crs="EPSG:4326", resampling=rasterio.enums.Resampling.bilinear)
        except Exception as error:
            raise InputError(
                f"{path}: cannot be converted to latitude and longitude; write it in another coordinate system."
            ) from error
        self._scale = dataset.scales[0] * _METRES[_unit(dataset)]
        self._offset_m = dataset.offsets[0] * _METRES[_unit(dataset)]
        self._thins = bool(dataset.overviews(1))
        transform = self._raster.transform
        rows, columns = self._raster.height, self._raster.width
        if rows < 2 or columns < 2 or not all(map(math.isfinite, transform[:6])):
            raise InputError(f"{path}: has no raster of heights; replace it.")
        # Posts stand in the middle of the pixels; rows come from north to south.
        self.posts = Posts(
            transform.f + (rows - 0.5) * transform.e,
            transform.c + 0.5 * transform.a,
            -transform.e,
            transform.a,
            rows,
            columns,
        )

    def _check(self, dataset: Any) -> None:
        if dataset.crs is None:
            raise InputError(f"{self.path}: has no coordinate system; write it with one.")
        if dataset.colorinterp[0].name not in ("gray", "undefined") or "complex" in dataset.dtypes[0]:
            raise InputError(f"{self.path}: is a picture, and no heights; give a GeoTIFF of elevation data.")
        if _unit(dataset) not in _METRES:
            raise InputError(f"{self.path}: has heights in {_unit(dataset)}; write it in metres or feet.")

    def read(self, wanted: Posts) -> HeightArray:
        """See :class:`sidelong.app.terrain.tile.Tile`."""
        own = self.posts
        south, north, west, east = needed(wanted, own)
        if south == north or west == east:
            return np.full((wanted.rows, wanted.columns), np.nan, np.float32)
        # Far finer than wanted, the file is thinned out while it is read, so that memory stays bounded.
        thin_rows = max(1, int(wanted.step_north_deg / own.step_north_deg + _MARGIN))
        thin_columns = max(1, int(wanted.step_east_deg / own.step_east_deg + _MARGIN))
        if thin_rows > 1:
            south, north = max(south - thin_rows, 0), min(north + thin_rows, own.rows)
        if thin_columns > 1:
            west, east = max(west - thin_columns, 0), min(east + thin_columns, own.columns)
        window = ((own.rows - north, own.rows - south), (west, east))
        shape = (math.ceil((north - south) / thin_rows), math.ceil((east - west) / thin_columns))
        pixels = (north - south) * (east - west)
        if pixels > _PIXELS_MAX and not self._thins:
            raise InputError(
                f"{self.path}: has {pixels:,} pixels there, {_PIXELS_MAX:,} at most serve; make it coarser "
                "(gdalwarp -tr) or give it overviews (gdaladdo)."
            )
        try:
            band = self._raster.read(1, window=window, out_shape=shape, masked=True)
        except Exception as error:
            raise InputError(f"{self.path}: cannot be read ({error}); replace it.") from error
        heights: HeightArray = np.ma.filled(band.astype(np.float32), np.nan)[::-1]
        heights *= np.float32(self._scale)
        heights += np.float32(self._offset_m)
        heights[~((heights >= LOWEST_M) & (heights <= HIGHEST_M))] = np.nan
        if shape == (north - south, east - west):
            return at_posts(wanted, own, heights, south, west)
        step_north, step_east = (
            (north - south) / shape[0] * own.step_north_deg,
            (east - west) / shape[1] * own.step_east_deg,
        )
        thinned = Posts(
            own.south_deg + south * own.step_north_deg + 0.5 * (step_north - own.step_north_deg),
            own.west_deg + west * own.step_east_deg + 0.5 * (step_east - own.step_east_deg),
            step_north,
            step_east,
            *shape,
        )
        return at_posts(wanted, thinned, heights, 0, 0)


def _unit(dataset: Any) -> str:
    return (dataset.units[0] or "").lower()
