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
from sidelong.estimators.sensing.pose import AXIS_AHEAD_S, PoseHistory, ReadingHistory, gimbal_at
from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
)
from sidelong.estimators.sensing.sighting import parent_of_gimbal
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.sources import SourceSelector, axis_rank

_GIMBAL_SPAN_S = 6.0
_ESTIMATE_AGE_MAX_S = 3.0  # of the estimate's last sighting: its velocity still describes the target
_FRESH_S, _GEO_S, _GEO_SIGMA_MAX_M = 2.0, 9.0, 15.0  # hidden for these times, the gimbal looks at the estimate

Edges = tuple[float, float, float, float]
"""Left, top, right and bottom edge in shares of a picture's width and height."""


@dataclass(frozen=True, slots=True)
class Pictured:
    """What one picture gave.

    Attributes:
        time_s: When it was taken.
        tracked: The object.
        view: From where it was taken.
        position: Of the aircraft then.
        attitude: Of the aircraft then.
        estimate: Of the target then, None while it is lost.
    """

    time_s: float
    tracked: Tracked
    view: View
    position: PositionReading
    attitude: AttitudeReading
    estimate: TargetEstimate | None

    @property
    def edges(self) -> Edges | None:
        """Where the object is seen, or expected while it is hidden."""
        box, (width, height) = self.tracked.box, self.view.size_px
        if box is None:
            return None
        across, down = 0.5 * box.width_px, 0.5 * box.height_px
        return (
            (box.x_px - across) / width,
            (box.y_px - down) / height,
            (box.x_px + across) / width,
            (box.y_px + down) / height,
        )


class TargetCamera:
    """Follows what was clicked, and keeps the gimbal on it.

    Args:
        view_rad: Horizontal field of view, without zoom.
        mount: Rotation from the gimbal's mount to its parent frame.
        lead_s: How far ahead a command points: the delay of link and gimbal.
        terrain: The ground; None: it is level.
        estimate: Returns the estimate of the target at a time.
        kind: The tracker.

    Attributes:
        latest: What the latest picture gave.
    """

    def __init__(
        self,
        view_rad: float,
        mount: Quaternion,
        lead_s: float,
        terrain: Ground | None,
        estimate: Callable[[float], TargetEstimate | None],
        kind: TrackerKind = "kcf",
    ) -> None:
        self.view_rad = view_rad
        self.latest: Pictured | None = None
        self._mount, self._lead_s = mount, lead_s
        self._terrain, self._estimate = terrain, estimate
        self._tracker = ObjectTracker(kind)
        self._poses = PoseHistory()
        self._gimbals: ReadingHistory[GimbalReading] = ReadingHistory(_GIMBAL_SPAN_S)
        self._axis_source = SourceSelector(axis_rank)
        self._wish: tuple[float, float, float, float] | None = None

    # -- what happens --------------------------------------------------------------------------------------

    def event(self, event: object) -> None:
        """Keep poses and lines of sight of the flight's events; other events change nothing."""
        if isinstance(event, PositionReading):
            self._poses.positions.add(event)
        elif isinstance(event, AttitudeReading):
            self._poses.attitudes.add(event)
        elif isinstance(event, GimbalReading) and self._axis_source.accepts(event.source, event.time_s):
            self._gimbals.add(event)

    def follow(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None:
        """Follow what the next picture shows there; middle and size in shares of the picture, size 0: a point."""
        self._wish = x, y, width, height

    def stop(self) -> None:
        """Follow nothing; the gimbal stays where it is."""
        self._wish = None
        self._tracker.stop()
        if self.latest is not None:
            self.latest = replace(self.latest, tracked=Tracked("idle"))

    def picture(self, picture: Picture, time_s: float) -> Pictured | None:
        """Process a picture (BGR); return the result, None while the camera's position or attitude is unknown."""
        position, found = self._poses.position_at(time_s), gimbal_at(self._gimbals, time_s, AXIS_AHEAD_S)
        gimbal = self._gimbals.newest() if found is None else found[0]
        attitude = self._poses.attitude_at(time_s) or self._poses.attitudes.newest()
        if position is None or gimbal is None or attitude is None:
            return None
        if gimbal.time_s and abs(time_s - gimbal.time_s) > AXIS_AHEAD_S:
            return None
        height, width = picture.shape[:2]
        sight = multiply(parent_of_gimbal(gimbal, attitude, self._mount), normalized(gimbal.quaternion_wxyz))
        focal_px = 0.5 * width / math.tan(0.5 * self.view_rad)
        here_m = position.east_m, position.north_m, position.height_m
        view = View(here_m, sight, focal_px, (width, height), self._terrain)
        if self._wish is not None:
            (x, y, across, down), self._wish = self._wish, None
            box = Box(x * width, y * height, across * width, down * height) if across and down else None
            self._tracker.start(picture, time_s, view, x * width, y * height, box)
        estimate, velocity_m_s, sigma_m_s = self._known(time_s), None, 0.0
        if estimate is not None and time_s - estimate.last_sighting_s < _ESTIMATE_AGE_MAX_S:
            velocity_m_s = estimate.velocity_east_m_s, estimate.velocity_north_m_s
            sigma_m_s = math.sqrt(max(estimate.covariance.diagonal()[2:4]))
        tracked = self._tracker.update(picture, time_s, view, velocity_m_s, sigma_m_s)
        self.latest = Pictured(time_s, tracked, view, position, attitude, estimate)
        return self.latest

    # -- what follows from it ------------------------------------------------------------------------------

    def pointing(self, now_s: float) -> tuple[float, float] | None:
        """Return pitch and yaw (clockwise from north) to command now; None while the gimbal is the operator's.

        While the object is seen, the gimbal leads on by its motion and the aircraft's; hidden, it looks where the
        estimate is, and without an estimate where the object was last seen.
        """
        position = self._poses.positions.newest()
        aim_m = self._aim_m(now_s + self._lead_s)
        if position is None or aim_m is None or self.latest is None:
            return None
        ahead_s = now_s + self._lead_s - position.time_s
        east_m = aim_m[0] - position.east_m - ahead_s * position.velocity_east_m_s
        north_m = aim_m[1] - position.north_m - ahead_s * position.velocity_north_m_s
        down_m = position.height_m + ahead_s * position.velocity_up_m_s - self.latest.view.ground_m(*aim_m)
        return -math.atan2(down_m, math.hypot(east_m, north_m)), math.atan2(east_m, north_m)

    def _known(self, time_s: float) -> TargetEstimate | None:
        estimate = self._estimate(time_s)
        return None if estimate is None or estimate.quality is TrackQuality.LOST else estimate

    def _aim_m(self, time_s: float) -> tuple[float, float] | None:
        if self._tracker.state == "idle":
            return None
        estimate = self._known(time_s)
        if estimate is None or not _FRESH_S < self._tracker.hidden_s(time_s) < _GEO_S:
            return self._tracker.expected_m(time_s)
        is_known = float(max(estimate.covariance.diagonal()[:2])) < _GEO_SIGMA_MAX_M**2
        return estimate.position_m(time_s) if is_known else self._tracker.expected_m(time_s)
