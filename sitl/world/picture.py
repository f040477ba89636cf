"""Pictures of a camera above textured ground: target, look-alikes, trees that hide it, shadows, changing light.

The ground of one picture is the plane that touches the hills where the camera looks. Needs OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Vector = npt.NDArray[np.float64]
Point = tuple[float, float, float]

_TEXTURE_PX, _TEXTURE_M = 2048, 0.2  # a square that repeats; the size of its pixels
_SLOPE_OVER_M = 10.0
_SUN = (0.6, 0.35)  # east and north, by which the top of something 1 m high throws its shadow
_NOISE_SIGMA, _NOISES = 4.0, 4
_LIGHT_PERIOD_S, _LIGHT_SHARE = 70.0, 0.25
_EXPOSURE_S = 0.008
_NEAR_M, _FAR_M = 5.0, 3_000.0
_TREES_PER_KM, _LOOKALIKES_PER_KM, _ALONG_S = 12.0, 10.0, 5
_TURNS_OVER_M = 1.5  # the inaccuracy of a recorded track does not turn the target on the spot
_TREE_OFF_M, _LOOKALIKE_OFF_M = (4.0, 25.0), (10.0, 30.0)


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where a camera is and where it looks, in the plane of home."""

    position_m: Point  # east, north, height
    yaw_rad: float  # of the optical axis, clockwise from north
    pitch_rad: float  # of the optical axis above the horizon
    roll_rad: float = 0.0  # right side down

    @property
    def image_from_plane(self) -> Vector:
        """The rotation (3, 3) from east, north, up; its rows are the image's right and down and the optical axis."""
        sy, cy, sp, cp = (f(a) for a in (self.yaw_rad, self.pitch_rad) for f in (math.sin, math.cos))
        right, down, axis = np.array([[cy, -sy, 0.0], [sp * sy, sp * cy, -cp], [cp * sy, cp * cy, sp]])
        sr, cr = math.sin(self.roll_rad), math.cos(self.roll_rad)
        return np.array([cr * right + sr * down, cr * down - sr * right, axis])


@dataclass(frozen=True, slots=True)
class _Vehicle:
    east_m: float
    north_m: float
    course_rad: float = 0.0
    length_m = 4.4
    width_m = 1.8
    height_m = 1.5
    colour = (40, 40, 170)


@dataclass(frozen=True, slots=True)
class _Tree:
    east_m: float
    north_m: float
    height_m: float
    crown_m: float  # its diameter


class Scenery:
    """What stands along the target's path, and how it looks.

    path_m: the target's positions (east, north), shape (n, 2), one a second. height_m: returns the height of the
    ground above home at (east, north). trees, lookalikes: times the usual number. sees: returns whether no hill is
    between two points (east, north, height).
    """

    def __init__(
        self,
        path_m: Vector,
        height_m: Callable[[float, float], float],
        seed: int,
        *,
        trees: float = 1.0,
        lookalikes: float = 1.0,
        sees: Callable[[Point, Point], bool] = lambda _one_m, _other_m: True,
    ) -> None:
        self._path_m, self._height_m, self._sees = path_m, height_m, sees
        self._rng = np.random.default_rng(seed)
        self._ground = _texture(self._rng)
        size = 720, 1280, 3
        self._noises = [self._rng.normal(0.0, _NOISE_SIGMA, size).astype(np.int16) for _ in range(_NOISES)]
        self.hidden_s: list[tuple[float, float]] = []  # when a crown stands before the target, wherever it is
        self.standing = self._lined(trees, lookalikes)

    def _lined(self, trees: float, lookalikes: float) -> list[_Vehicle | _Tree]:
        path = self._path_m[::_ALONG_S]
        rng, standing = self._rng, list[_Vehicle | _Tree]()
        step_m = np.hypot(*np.diff(path, axis=0).T)
        for at_m, way_m in zip(path[:-1], step_m, strict=True):
            for rate_per_km, is_tree in ((trees * _TREES_PER_KM, True), (lookalikes * _LOOKALIKES_PER_KM, False)):
                if rng.random() >= rate_per_km * way_m / 1000.0:
                    continue
                off_m, bearing_rad = rng.uniform(*(_TREE_OFF_M if is_tree else _LOOKALIKE_OFF_M)), rng.uniform(0, 7)
                place = at_m + off_m * np.array([math.sin(bearing_rad), math.cos(bearing_rad)])
                if is_tree and np.hypot(*(path - place).T).min() < _TREE_OFF_M[0] - 1.0:
                    continue  # no tree on the road
                high_m, crown_m = (rng.uniform(5.0, 10.0), rng.uniform(4.0, 7.0)) if is_tree else (0.0, 0.0)
                course_rad, (east_m, north_m) = rng.uniform(0, 7), map(float, place)
                vehicle = _Vehicle(east_m, north_m, course_rad)
                standing.append(_Tree(east_m, north_m, high_m, crown_m) if is_tree else vehicle)
        return standing

    def target_m(self, time_s: float) -> tuple[float, float]:
        """Return where the target is (east, north)."""
        at = min(max(int(time_s), 0), len(self._path_m) - 2)
        (east_m, north_m), (next_east_m, next_north_m) = self._path_m[at : at + 2].tolist()
        share = min(max(time_s - at, 0.0), 1.0)
        return east_m + share * (next_east_m - east_m), north_m + share * (next_north_m - north_m)

    def _target(self, time_s: float) -> _Vehicle:
        """Return the target; it turns as it moves, and standing keeps the direction of its last motion."""
        here = self.target_m(time_s)
        for over_s in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0):
            before = self.target_m(max(time_s - over_s, 0.0))
            if math.dist(here, before) > _TURNS_OVER_M:
                return _Vehicle(*here, math.atan2(here[0] - before[0], here[1] - before[1]))
        return _Vehicle(*here)

    def picture(
        self, time_s: float, pose: CameraPose, view_rad: float, size_px: tuple[int, int], turn_rad_s: float = 0.0
    ) -> Image:
        """Return what the camera sees: BGR, shape (height, width, 3).

        view_rad: horizontal field of view. size_px: width and height. turn_rad_s: how fast the picture moves
        sideways, which blurs it.
        """
        width, height = size_px
        focal_px = 0.5 * width / math.tan(0.5 * view_rad)
        camera = np.array([[focal_px, 0.0, 0.5 * width], [0.0, focal_px, 0.5 * height], [0.0, 0.0, 1.0]])
        view = _View(focal_px, camera @ pose.image_from_plane, np.array(pose.position_m))
        image = self._ground_seen(view, pose, size_px)
        target = self._target(time_s)
        near = [thing for thing in (*self.standing, target) if self._is_seen(thing, view, pose, size_px)]
        for thing in near:
            self._draw_shadow(image, view, thing)
        for thing in sorted(near, key=lambda thing: -math.dist(pose.position_m[:2], (thing.east_m, thing.north_m))):
            self._draw(image, view, thing)
        if any(begin_s <= time_s < end_s for begin_s, end_s in self.hidden_s):
            self._draw(image, view, _Tree(target.east_m, target.north_m, 9.0, 9.0))
        return self._exposed(image, time_s, focal_px * abs(turn_rad_s) * _EXPOSURE_S)

    def _touching(self, east_m: float, north_m: float) -> tuple[float, float, float]:
        """Return height and slopes (east, north) of the plane that touches the ground there."""
        level_m = [
            self._height_m(east_m + e, north_m + n) for e, n in ((0, 0), (_SLOPE_OVER_M, 0), (0, _SLOPE_OVER_M))
        ]
        here_m, east, north = (0.0 if math.isnan(height_m) else height_m for height_m in level_m)
        return here_m, (east - here_m) / _SLOPE_OVER_M, (north - here_m) / _SLOPE_OVER_M

    def _ground_seen(self, view: _View, pose: CameraPose, size_px: tuple[int, int]) -> Image:
        axis = pose.image_from_plane[2]
        east_m, north_m, up_m = pose.position_m
        at_m, height_m = np.array([east_m, north_m]), 0.0
        for _ in range(4):  # where the axis meets the hills, by fixed point
            reach_m = min((up_m - height_m) / max(-axis[2], 1e-3), _FAR_M)
            at_m = np.array([east_m, north_m]) + reach_m * axis[:2]
            height_m = self._touching(*at_m)[0]
        height_m, slope_east, slope_north = self._touching(*at_m)
        period_m = _TEXTURE_PX * _TEXTURE_M
        corner_m = np.floor(at_m / period_m) * period_m  # single precision counts from here
        plane_from_texture = np.array(
            [[_TEXTURE_M, 0.0, corner_m[0]], [0.0, -_TEXTURE_M, corner_m[1]], [0.0, 0.0, 1.0]]
        )
        level_m = height_m - slope_east * at_m[0] - slope_north * at_m[1] - up_m
        camera_from_plane = np.array([[1, 0, -east_m], [0, 1, -north_m], [slope_east, slope_north, level_m]])
        texture_to_image = view.image_from_camera @ camera_from_plane @ plane_from_texture
        seen: Image = cv2.warpPerspective(  # type: ignore[assignment]
            self._ground, texture_to_image, size_px, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
        )
        return seen

    def _is_seen(self, one: _Vehicle | _Tree, view: _View, pose: CameraPose, size_px: tuple[int, int]) -> bool:
        level_m = self._level_m(one)
        place = view.pixels([[one.east_m, one.north_m, level_m]])
        if place is None:
            return False
        (x, y), margin = place[0], 0.5 * size_px[0]
        if not (-margin < x < size_px[0] + margin and -margin < y < size_px[1] + margin):
            return False
        return self._sees(pose.position_m, (one.east_m, one.north_m, level_m + one.height_m))

    def _level_m(self, one: _Vehicle | _Tree) -> float:
        height_m = self._height_m(one.east_m, one.north_m)
        return 0.0 if math.isnan(height_m) else height_m

    def _draw_shadow(self, image: Image, view: _View, one: _Vehicle | _Tree) -> None:
        shift = np.array([*_SUN, 0.0]) * (0.7 * one.height_m)
        if isinstance(one, _Tree):
            outline = view.pixels(self._ring(one) + shift)
        else:
            floor = self._corners(one)[:4]
            outline = view.pixels(np.concatenate([floor, floor + shift]))
        if outline is not None:
            hull = cv2.convexHull(outline.astype(np.int32))
            x, y, w, h = cv2.boundingRect(hull)
            x0, y0 = max(x, 0), max(y, 0)
            patch = image[y0 : max(y + h, 0), x0 : max(x + w, 0)]
            if patch.size:
                mask = np.zeros(patch.shape[:2], np.uint8)
                cv2.fillConvexPoly(mask, hull - np.array([x0, y0]), 1)
                patch[mask > 0] = (0.55 * patch[mask > 0]).astype(np.uint8)

    def _corners(self, vehicle: _Vehicle) -> Vector:
        """Return the corners, shape (8, 3): the floor's four, then the roof's."""
        sine, cosine, level_m = math.sin(vehicle.course_rad), math.cos(vehicle.course_rad), self._level_m(vehicle)
        ahead, aside = 0.5 * vehicle.length_m, 0.5 * vehicle.width_m
        flat = [(ahead, -aside), (ahead, aside), (-ahead, aside), (-ahead, -aside)]
        return np.array(
            [
                (vehicle.east_m + a * sine + b * cosine, vehicle.north_m + a * cosine - b * sine, level_m + up_m)
                for up_m in (0.0, vehicle.height_m)
                for a, b in flat
            ]
        )

    def _ring(self, tree: _Tree) -> Vector:
        """Return points of the outline of a crown on the ground, shape (8, 3)."""
        angles, radius_m = np.linspace(0.0, 2.0 * math.pi, 9)[:-1], 0.5 * tree.crown_m
        east_m, north_m = tree.east_m + radius_m * np.sin(angles), tree.north_m + radius_m * np.cos(angles)
        return np.stack([east_m, north_m, np.full(8, self._level_m(tree))], axis=1)

    def _draw(self, image: Image, view: _View, one: _Vehicle | _Tree) -> None:
        if isinstance(one, _Tree):
            self._draw_tree(image, view, one)
        elif (seen := view.pixels(self._corners(one))) is not None:
            roof = seen[4:]
            cv2.fillConvexPoly(image, cv2.convexHull(seen.astype(np.int32)), one.colour)
            bright = tuple(min(round(1.35 * c) + 20, 255) for c in one.colour)
            cv2.fillConvexPoly(image, cv2.convexHull(roof.astype(np.int32)), bright)
            windscreen = [roof[0], roof[1], 0.7 * roof[1] + 0.3 * roof[2], 0.7 * roof[0] + 0.3 * roof[3]]
            cv2.fillConvexPoly(image, np.array(windscreen).astype(np.int32), (60, 50, 40))

    def _draw_tree(self, image: Image, view: _View, tree: _Tree) -> None:
        radius_m = 0.5 * tree.crown_m
        rng = np.random.default_rng(abs(int(tree.east_m * 10.0) * 7919 + int(tree.north_m * 10.0)))
        middle = np.array([tree.east_m, tree.north_m, self._level_m(tree) + tree.height_m - radius_m])
        for part in range(7):
            off = rng.normal(0.0, 0.45 * radius_m, 3) if part else np.zeros(3)
            at = view.pixels([middle + off])
            if at is not None:
                px = view.scale_px_m(middle) * radius_m * (1.0 if part == 0 else rng.uniform(0.3, 0.6))
                green = (30 + 8 * part, 70 + 9 * part, 35 + 5 * part)
                cv2.circle(image, (int(at[0][0]), int(at[0][1])), max(int(px), 1), green, -1)

    def _exposed(self, image: Image, time_s: float, blur_px: float) -> Image:
        if blur_px > 1.5:
            image = cv2.blur(image, (min(round(blur_px), 31), 1))  # type: ignore[assignment]
        height, width = image.shape[:2]
        top, left = (int(self._rng.integers(0, room)) for room in (721 - height, 1281 - width))
        noise = self._noises[int(self._rng.integers(_NOISES))][top : top + height, left : left + width]
        gain = 1.0 + _LIGHT_SHARE * math.sin(2.0 * math.pi * time_s / _LIGHT_PERIOD_S)
        lit = cv2.convertScaleAbs(image, alpha=gain)
        return np.asarray(cv2.add(lit, noise, dtype=cv2.CV_8U), np.uint8)


class _View:
    """A pinhole: image_from_camera, shape (3, 3), times the offset from the camera's position, is the pixel."""

    def __init__(self, focal_px: float, image_from_camera: Vector, position_m: Vector) -> None:
        self._focal_px, self.image_from_camera, self._position_m = focal_px, image_from_camera, position_m

    def pixels(self, points_m: npt.ArrayLike) -> Vector | None:
        """Return where points are seen, shape (n, 2); None where one is behind the camera or far away."""
        seen = (np.asarray(points_m) - self._position_m) @ self.image_from_camera.T
        if not ((seen[:, 2] > _NEAR_M) & (seen[:, 2] < _FAR_M)).all():
            return None
        pixels: Vector = seen[:, :2] / seen[:, 2:]
        return np.clip(pixels, -1e4, 1e4)

    def scale_px_m(self, point_m: Vector) -> float:
        """Return the size in the image of a metre at a point."""
        away_m = float((point_m - self._position_m) @ self.image_from_camera[2])
        return self._focal_px / max(away_m, 1.0)


def _texture(rng: np.random.Generator) -> Image:
    """Return ground that repeats without a seam: noise of several scales, by smoothing on a torus."""
    grey = np.full((_TEXTURE_PX, _TEXTURE_PX), 110.0, np.float32)
    for cells, weight in ((16, 26.0), (64, 18.0), (256, 14.0), (1024, 9.0)):
        coarse = np.pad(rng.normal(size=(cells, cells)).astype(np.float32), 2, mode="wrap")
        factor = _TEXTURE_PX // cells
        fine = cv2.resize(coarse, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        grey += weight * fine[2 * factor : -2 * factor, 2 * factor : -2 * factor]
    for _ in range(6):  # tracks and field edges
        at, width = int(rng.integers(0, _TEXTURE_PX)), int(rng.integers(10, 25))
        shade = 25.0 * float(rng.choice([-1.0, 1.0]))
        if rng.random() < 0.5:
            grey[at : at + width] += shade
        else:
            grey[:, at : at + width] += shade
    grey = np.clip(grey, 0, 255)
    return np.stack([0.85 * grey, grey, 0.9 * grey], axis=2).astype(np.uint8)
