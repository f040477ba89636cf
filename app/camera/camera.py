"""A gimbal camera that keeps a target in the middle: pictures and the flight's events in, tracking and pointing out.

Pure: times are the vehicle's. The shell brings pictures, sends the tracking status and points the gimbal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from sidelong.app.camera.tracker import Box, ObjectTracker, Picture, Tracked, TrackerKind
from sidelong.app.camera.view import View
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.rotations import Quaternion, multiply, normalized
from sidelong.estimators.sensing.pose import PoseHistory, ReadingHistory, gimbal_at
from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
)
from sidelong.estimators.sensing.sighting import parent_of_gimbal

_GIMBAL_SPAN_S = 6.0
_GIMBAL_AGE_MAX_S = 0.4  # of the latest attitude, which stands for a picture that is newer
_ESTIMATE_AGE_MAX_S = 3.0  # of the estimate's last sighting: its velocity still describes the target
_FRESH_S, _GEO_S, _GEO_SIGMA_MAX_M = 2.0, 9.0, 15.0  # hidden for these times, the gimbal looks at the estimate


@dataclass(frozen=True, slots=True)
class Pictured:
    """What one picture gave.

    Attributes:
        time_s: When it was taken.
        tracked: The object.
        size_px: Of the picture.
    """

    time_s: float
    tracked: Tracked
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class _Wish:
    """A place in the picture to follow, in shares of its width and height; a rectangle has a size."""

    x: float
    y: float
    width: float = 0.0
    height: float = 0.0


class TargetCamera:
    """Follows what was clicked, and keeps the gimbal on it.

    Args:
        view_rad: Horizontal field of view, without zoom.
        mount: Rotation from the gimbal's mount to its parent frame.
        lead_s: How far ahead a command points: the delay of link and gimbal.
        ground_m: Returns the height of the ground above home at (east, north).
        estimate: Returns the estimate of the target at a time.
        kind: The tracker.

    Attributes:
        latest: What the latest picture gave.
        view: From where that picture was taken.
    """

    def __init__(
        self,
        view_rad: float,
        mount: Quaternion,
        lead_s: float,
        ground_m: Callable[[float, float], float],
        estimate: Callable[[float], TargetEstimate | None],
        kind: TrackerKind = "kcf",
    ) -> None:
        self.view_rad = view_rad
        self.latest: Pictured | None = None
        self.view: View | None = None
        self._mount, self._lead_s = mount, lead_s
        self._ground_m, self._estimate = ground_m, estimate
        self._tracker = ObjectTracker(kind)
        self._poses = PoseHistory()
        self._gimbals: ReadingHistory[GimbalReading] = ReadingHistory(_GIMBAL_SPAN_S)
        self._wish: _Wish | None = None

    # -- what happens --------------------------------------------------------------------------------------

    def event(self, event: object) -> None:
        """Take an event of the flight."""
        if isinstance(event, PositionReading):
            self._poses.positions.add(event)
        elif isinstance(event, AttitudeReading):
            self._poses.attitudes.add(event)
        elif isinstance(event, GimbalReading) and event.source.message != IMAGE_TRACKER:
            self._gimbals.add(event)

    def follow(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None:
        """Follow what the next picture shows there; middle and size in shares of the picture, size 0: a point."""
        self._wish = _Wish(x, y, width, height)

    def stop(self) -> None:
        """Follow nothing; the gimbal stays where it is."""
        self._wish = None
        self._tracker.stop()
        if self.latest is not None:
            self.latest = replace(self.latest, tracked=Tracked("idle"))

    def picture(self, picture: Picture, time_s: float) -> Pictured | None:
        """Take a picture (BGR); return what it gave, None while the camera's position or attitude is unknown."""
        view = self._view_at(time_s, (picture.shape[1], picture.shape[0]))
        if view is None:
            return None
        if self._wish is not None:
            self._begin(picture, time_s, view, self._wish)
            self._wish = None
        estimate, velocity_m_s = self._estimate(time_s), None
        if (
            estimate is not None
            and estimate.quality is not TrackQuality.LOST
            and time_s - estimate.last_sighting_s < _ESTIMATE_AGE_MAX_S
        ):
            velocity_m_s = estimate.velocity_east_m_s, estimate.velocity_north_m_s
        tracked = self._tracker.update(picture, time_s, view, velocity_m_s)
        self.view, self.latest = view, Pictured(time_s, tracked, view.size_px)
        return self.latest

    # -- what follows from it ------------------------------------------------------------------------------

    def pointing(self, now_s: float) -> tuple[float, float] | None:
        """Return pitch and yaw (clockwise from north) to command now; None while the gimbal is the operator's.

        While the object is seen, the gimbal leads on by its motion and the aircraft's; hidden, it looks where the
        estimate is, and without an estimate where the object was last seen.
        """
        position = self._poses.positions.newest()
        aim_m = self._aim_m(now_s + self._lead_s)
        if position is None or aim_m is None:
            return None
        ahead_s = now_s + self._lead_s - position.time_s
        east_m = aim_m[0] - position.east_m - ahead_s * position.velocity_east_m_s
        north_m = aim_m[1] - position.north_m - ahead_s * position.velocity_north_m_s
        down_m = position.height_m + ahead_s * position.velocity_up_m_s - self._ground_m(*aim_m)
        return -math.atan2(down_m, math.hypot(east_m, north_m)), math.atan2(east_m, north_m)

    def status(self) -> dict[str, float | int]:
        """Return the fields of CAMERA_TRACKING_IMAGE_STATUS for the latest picture."""
        latest = self.latest
        state = "idle" if latest is None else latest.tracked.state
        fields: dict[str, float | int] = dict.fromkeys(
            ("point_x", "point_y", "radius", "rec_top_x", "rec_top_y", "rec_bottom_x", "rec_bottom_y"), math.nan
        )
        fields |= {"tracking_status": 0, "tracking_mode": 0, "target_data": 0}
        if latest is None or state == "idle":
            return fields
        fields |= {"tracking_status": 1 if state == "object" else 2, "tracking_mode": 2, "target_data": 4}
        box, (width, height) = latest.tracked.box, latest.size_px
        if state == "object" and box is not None:
            fields |= {
                "point_x": box.x_px / width,
                "point_y": box.y_px / height,
                "rec_top_x": (box.x_px - 0.5 * box.width_px) / width,
                "rec_top_y": (box.y_px - 0.5 * box.height_px) / height,
                "rec_bottom_x": (box.x_px + 0.5 * box.width_px) / width,
                "rec_bottom_y": (box.y_px + 0.5 * box.height_px) / height,
            }
        return fields

    # -- geometry ------------------------------------------------------------------------------------------

    def _begin(self, picture: Picture, time_s: float, view: View, wish: _Wish) -> None:
        width, height = view.size_px
        x_px, y_px = wish.x * width, wish.y * height
        box = Box(x_px, y_px, wish.width * width, wish.height * height) if wish.width and wish.height else None
        self._tracker.start(picture, time_s, view, x_px, y_px, box)

    def _view_at(self, time_s: float, size_px: tuple[int, int]) -> View | None:
        position, found = self._poses.position_at(time_s), gimbal_at(self._gimbals, time_s)
        gimbal = self._gimbals.newest() if found is None else found[0]
        attitude = self._poses.attitude_at(time_s) or self._poses.attitudes.newest()
        if position is None or gimbal is None or attitude is None:
            return None
        if gimbal.time_s and abs(time_s - gimbal.time_s) > _GIMBAL_AGE_MAX_S:
            return None
        sight = multiply(parent_of_gimbal(gimbal, attitude, self._mount), normalized(gimbal.quaternion_wxyz))
        focal_px = 0.5 * size_px[0] / math.tan(0.5 * self.view_rad)
        here_m = position.east_m, position.north_m, position.height_m
        return View(here_m, sight, focal_px, size_px, self._ground_m)

    def _aim_m(self, time_s: float) -> tuple[float, float] | None:
        if self._tracker.state == "idle":
            return None
        hidden_s, estimate = self._tracker.hidden_s(time_s), self._estimate(time_s)
        if estimate is not None and estimate.quality is not TrackQuality.LOST and _FRESH_S < hidden_s < _GEO_S:
            is_known = float(max(estimate.covariance.diagonal()[:2])) < _GEO_SIGMA_MAX_M**2
            return estimate.position_m(time_s) if is_known else self._tracker.expected_m(time_s)
        return self._tracker.expected_m(time_s)
