"""Follow one object from picture to picture; after an occlusion, find it again and not one that looks like it.

The tracker is OpenCV's (KCF by default, CSRT by choice). It works in a window that is cut out around the expected
position and resampled to a constant size of the object: neither the motion of the gimbal nor the range shows in it.
Each picture is compared with how the object looked lately, by colour and by correlation. Below a threshold it is
hidden, and its surroundings are searched. Objects that looked alike before, or that stand while the target moved, are
left out. The remaining one is accepted when it is seen repeatedly.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from sidelong.app.camera.view import View

Picture = npt.NDArray[np.uint8]
TrackerKind = Literal["kcf", "csrt"]
TrackingState = Literal["idle", "object", "lost"]

_SIDE_PX = 36  # of the object in the window
_WINDOW_PX, _SEARCH_MAX_PX = 180, 480
_HIDDEN_BELOW, _LEARNT_FROM, _ALIKE_FROM = 0.45, 0.75, 0.65  # shares of how much it looks like itself
_USUAL_RATE, _USUAL_SHARE = 0.05, 0.85  # an object that has looked less alike lately is found by this share of it
_TURNS_PER_S, _END_ON = 0.04, 0.38  # hidden, it may turn: end on it fills less of its box
_HIDDEN_PICTURES = 3
_LEARN_EVERY_S = 0.25
_SEARCH_EVERY_S, _SURVEY_EVERY_S, _SURVEY_M = 0.13, 0.7, 30.0
_CANDIDATES_MAX = 10
_REMEMBERED_S, _SAME_SIZES = 60.0, 0.9
_SEEN_FOR_S, _SEEN_TIMES, _STANDS_FOR_S, _TRIED_S = 0.5, 4, 1.5, 2.0
_FRESH_S = 2.0
_STOPPED_S, _STOOD_FOR_S = 9.0, 4.0  # hidden for this time, the target may have stopped
_MOVES_M_S, _STANDING_SHARE = 0.8, 0.35
_ON_WAY_M = 8.0  # how far off its straight way the target may have stopped; what looks like it stands farther off
_UNSURE_M_S, _MOVED_FOR_S = 1.5, 0.8  # then its own motion in the pictures is known better
_UNKNOWN_M_S = 3.0  # what the target's velocity is off, before there is an estimate of it
_SLACK_M, _SLACK_M_S, _SEARCH_MAX_M = 4.0, 1.0, 45.0  # how far it may be from where it was seen, and how this grows
_OBJECT_M = 4.5
_LOOK_S, _TURNS_M = 2.0, 20.0
# Ahead and aside of where it was last seen; ahead is as far as it has come by now if it went straight on.
_LOOKS = ((1.0, 0.0), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Box:
    """Part of a picture: its middle and its size, pixels."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float


@dataclass(frozen=True, slots=True)
class Tracked:
    """What is known of the object in one picture.

    Attributes:
        state: ``idle`` before a start, ``lost`` while it is hidden.
        box: where it is seen; where it is expected while it is hidden.
        confidence: 0 to 1; it falls before a loss.
    """

    state: TrackingState
    box: Box | None = None
    confidence: float = 0.0


_HUES, _COLOUR_MIN = 24, 0.12
_LEARN, _LEARN_OWN = 0.1, 0.005  # of a learning: for the surroundings; for the object, once it was learnt often
_RARE = 0.02  # share of a box: a colour that less of it has is hardly the object's
_TEMPLATES, _TEMPLATE_EVERY_S, _PROVED_AFTER_S = 4, 1.5, 1.5
_TURNED_DEG = (0.0, -20.0, 20.0)
_CORRELATION = 0.8  # of an object with itself some seconds before
_CENTRED_PX, _DRIFT_PX = 1.0, 4.0  # by a picture; what the tracker is off when it begins again
_MEAN_SHIFT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.5)


class _Look:
    """How the object looks: the colours that it has and its surroundings have not, and some of its recent pictures.

    Colours are shares of blue and red in the sum of the three, which changing light leaves alone.
    """

    def __init__(self) -> None:
        self._inside = np.zeros((_HUES, _HUES))
        self._outside = np.zeros((_HUES, _HUES))
        self._times = 0
        self._colour = 0.0  # mean share of the object's own colours in its box
        self._templates: deque[Picture] = deque(maxlen=_TEMPLATES)
        self._unproved: deque[tuple[float, Picture]] = deque()

    def learn(self, window: Picture, x_px: float, y_px: float, size_px: tuple[int, int], time_s: float) -> None:
        """Take what the object looks like at a place of the window."""
        patch: Picture = cv2.getRectSubPix(window, size_px, (x_px, y_px))  # type: ignore[assignment]
        hues, (width, height) = _hues(window), size_px
        left, top = round(x_px - 0.5 * width), round(y_px - 0.5 * height)
        around = np.ones(window.shape[:2], bool)
        around[max(top - 4, 0) : top + height + 4, max(left - 4, 0) : left + width + 4] = False
        inner = _hues(patch)[height // 4 : -height // 4, width // 4 : -width // 4]
        first, self._times = not self._templates, self._times + 1
        # What hides the object for a moment gives it no colour: those of all its time count alike.
        own_rate = max(1.0 / self._times, _LEARN_OWN)
        self._inside += own_rate * (_shares(inner.reshape(-1, 2)) - self._inside)
        self._outside += (1.0 if first else _LEARN) * (_shares(hues[around]) - self._outside)
        colour = float(self._own_colour(_hues(patch)).mean())
        self._colour += (1.0 if first else _LEARN) * (colour - self._colour)
        if first:
            self._templates.append(patch)
        elif not self._unproved or time_s - self._unproved[-1][0] > _TEMPLATE_EVERY_S:
            self._unproved.append((time_s, patch))
        while self._unproved and time_s - self._unproved[0][0] > _PROVED_AFTER_S:
            self._templates.append(self._unproved.popleft()[1])

    def turned(self, window: Picture, x_px: float, y_px: float, size_px: tuple[int, int]) -> None:
        """Take that the object, found again at a place of the window, fills less of its box than before."""
        patch: Picture = cv2.getRectSubPix(window, size_px, (x_px, y_px))  # type: ignore[assignment]
        if self.has_colour:
            share = float(self._own_colour(_hues(patch)).mean())
            self._colour = min(self._colour, max(share, 1.05 * _COLOUR_MIN))

    def forget_lately(self) -> None:
        """Drop what was learnt just now: it may show what hides the object."""
        self._unproved.clear()

    @property
    def has_colour(self) -> bool:
        """Whether its colours distinguish it from its surroundings."""
        return self._colour > _COLOUR_MIN

    def by_colour(self, window: Picture, size_px: tuple[int, int]) -> npt.NDArray[np.float32]:
        """Return how much each box of the window has the object's colours, 1 being as much as itself.

        Returns:
            Shape (height - object's height + 1, width - object's width + 1), by upper left corner.
        """
        width, height = size_px
        own = self._own_colour(_hues(window))
        mean = cv2.boxFilter(own, -1, size_px, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
        alike = mean[: window.shape[0] - height + 1, : window.shape[1] - width + 1]
        return np.asarray(alike / max(self._colour, 1e-3), np.float32)

    def middle(self, window: Picture, x_px: float, y_px: float, size_px: tuple[int, int]) -> tuple[float, float]:
        """Return the middle of the object's colours next to a place of the window; the place itself without them."""
        if not self.has_colour:
            return x_px, y_px
        width, height = size_px
        near: Picture = cv2.getRectSubPix(window, (3 * width, 3 * height), (x_px, y_px))  # type: ignore[assignment]
        own = cv2.convertScaleAbs(self._own_colour(_hues(near)), alpha=255.0)
        _, (left, top, *_) = cv2.meanShift(own, (width, height, width, height), _MEAN_SHIFT)
        return x_px + left - width, y_px + top - height

    def by_pictures(self, window: Picture, size_px: tuple[int, int], *, turned: bool) -> npt.NDArray[np.float32]:
        """Return the same by correlation with recent pictures of the object; turned: also as it turns."""
        width, height = size_px
        alike = np.full((window.shape[0] - height + 1, window.shape[1] - width + 1), -1.0, np.float32)
        for template in self._templates:
            sized = cv2.resize(template, size_px, interpolation=cv2.INTER_AREA)
            for angle_deg in _TURNED_DEG if turned else (0.0,):
                rotation = cv2.getRotationMatrix2D((0.5 * width, 0.5 * height), angle_deg, 1.0)
                one = cv2.warpAffine(sized, rotation, size_px, borderMode=cv2.BORDER_REPLICATE)
                np.maximum(alike, cv2.matchTemplate(window, one, cv2.TM_CCOEFF_NORMED), out=alike)
        return (alike / _CORRELATION).astype(np.float32)

    def likeness(self, window: Picture, size_px: tuple[int, int], *, turned: bool) -> npt.NDArray[np.float32]:
        """Return the same by both: without its colours nothing is the object."""
        alike = self.by_pictures(window, size_px, turned=turned)
        if not self.has_colour:
            return alike
        colour = self.by_colour(window, size_px)
        both = 0.5 * (np.maximum(alike, 0.6) + colour)
        return np.where(colour < _HIDDEN_BELOW, colour, both).astype(np.float32)

    def _own_colour(self, hues: Picture) -> npt.NDArray[np.float32]:
        share = self._inside / (self._inside + self._outside + _RARE)
        share = np.maximum(2.0 * share - 1.0, 0.0)  # the ground around it has as much of other colours
        return share.astype(np.float32)[hues[..., 0], hues[..., 1]]


def _shares(hues: Picture) -> npt.NDArray[np.float64]:
    """Return the share of each cell in cells of shape (n, 2)."""
    share, *_ = np.histogram2d(hues[:, 0], hues[:, 1], _HUES, ((0, _HUES), (0, _HUES)))
    return share / max(len(hues), 1)


def _hues(picture: Picture) -> Picture:
    """Return the cells of blue and red for each pixel, shape (..., 2)."""
    levels = picture.astype(np.float32)
    levels += 8.0  # dark pixels have no colour
    share = levels[..., (0, 2)]
    share *= 1.5 * _HUES / levels.sum(axis=2, keepdims=True)
    return np.minimum(share, _HUES - 1, out=share).astype(np.uint8)


@dataclass(slots=True)
class _Candidate:
    """Something that may be the object: where it was seen, and when."""

    seen: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=40))  # s, m, m

    @property
    def latest(self) -> tuple[float, float, float]:
        return self.seen[-1]

    @property
    def is_moving(self) -> bool:
        """Whether it has moved while it was seen."""
        speed_m_s = self.speed_m_s(_STANDS_FOR_S)
        return speed_m_s is not None and speed_m_s > _STANDING_SHARE * _MOVES_M_S

    @property
    def velocity_m_s(self) -> tuple[float, float] | None:
        """Its mean velocity since it was first seen; None where it was not seen for long enough."""
        (begin_s, *begin_m), (end_s, *end_m) = self.seen[0], self.latest
        if end_s - begin_s < _MOVED_FOR_S:
            return None
        return (end_m[0] - begin_m[0]) / (end_s - begin_s), (end_m[1] - begin_m[1]) / (end_s - begin_s)

    def speed_m_s(self, over_s: float) -> float | None:
        """Return its mean speed over the last ``over_s``; None where it was not seen for all of it.

        What stands jumps when the gimbal turns quickly: the speed is not higher than over all that was seen of it.
        """
        if not self.seen:
            return None
        end_s, east_m, north_m = self.latest
        past = [one for one in self.seen if one[0] <= end_s - over_s]
        return min(
            (math.dist(one[1:], (east_m, north_m)) / (end_s - one[0]) for one in past[:1] + past[-1:]), default=None
        )


@dataclass(slots=True)
class _Trial:
    """What was found after a loss or passes what looks like it, until it has moved as the object did.

    Attributes:
        lost: where and when the object was seen for sure: time s, east m, north m.
        found: as it is followed now.
    """

    lost: tuple[float, float, float]
    found: _Candidate


class ObjectTracker:
    """Follows one object. Pictures are BGR, shape (height, width, 3); times are of one clock, s."""

    def __init__(self, kind: TrackerKind = "kcf") -> None:
        self._kind = kind
        self._tracker: Any = None
        self._shift_px = (0.0, 0.0)  # of the object from the tracker's box, in the window
        self._size_m = (_OBJECT_M, _OBJECT_M)
        self._look = _Look()
        self._state: TrackingState = "idle"
        self._confidence, self._usual = 0.0, 1.0  # how much the object looks like itself, now and as a rule
        self._at_m = (0.0, 0.0)  # where it was last seen
        self._velocity_m_s, self._velocity_sigma_m_s = (0.0, 0.0), _UNKNOWN_M_S
        self._seen_s = self._learnt_s = self._searched_s = self._surveyed_s = -math.inf
        self._doubts = 0
        self._followed_path = _Candidate()
        self._candidates: list[_Candidate] = []
        self._watched_m: tuple[float, float] | None = None  # the likeliest candidate
        self._trial: _Trial | None = None
        self._alike: list[_Candidate] = []  # what looks like it

    @property
    def state(self) -> TrackingState:
        """Whether an object is followed."""
        return self._state

    def hidden_s(self, time_s: float) -> float:
        """Return for how long it, and what may be it, has not been seen."""
        return time_s - self._seen_s

    def expected_m(self, time_s: float) -> tuple[float, float]:
        """Return where to look for it (east, north): by its last motion, after some seconds around there in turn.

        Then what may be it is looked at until it is known whether it moves.
        """
        hidden_s = time_s - self._seen_s
        east_m, north_m = self._velocity_m_s[0] * _STOPPED_S, self._velocity_m_s[1] * _STOPPED_S
        if hidden_s <= _STOPPED_S:
            share = hidden_s / _STOPPED_S
            return self._at_m[0] + share * east_m, self._at_m[1] + share * north_m
        if self._watched_m is not None:
            return self._watched_m
        far_m = math.hypot(east_m, north_m)
        if far_m < _SLACK_M:
            east_m, north_m = 0.0, _SLACK_M
            far_m = _SLACK_M
        longer = max(far_m, _TURNS_M) / far_m
        ahead, aside = _LOOKS[int((hidden_s - _STOPPED_S) / _LOOK_S) % len(_LOOKS)]
        if ahead > 0.0:
            longer = max(longer, hidden_s / _STOPPED_S)
        return (
            self._at_m[0] + longer * (ahead * east_m + aside * north_m),
            self._at_m[1] + longer * (ahead * north_m - aside * east_m),
        )

    def start(self, picture: Picture, time_s: float, view: View, x_px: float, y_px: float, box: Box | None) -> bool:
        """Follow what is at a pixel, or in a box; return whether the ground is seen there."""
        at = view.ground(x_px, y_px)
        if at is None:
            return False
        scale = view.scale_px_m(*at)
        self._size_m = (_OBJECT_M, _OBJECT_M) if box is None else (box.width_px / scale, box.height_px / scale)
        self._velocity_m_s, self._velocity_sigma_m_s = (0.0, 0.0), _UNKNOWN_M_S
        self._alike, self._candidates, self._trial = [], [], None
        for _ in range(2):  # the click may be at an edge of the object: its middle is known then
            self._look, self._learnt_s, self._usual = _Look(), -math.inf, 1.0
            self._follow(picture, time_s, view, at)
            window = _Window.around(picture, view, at, self._size_m, _WINDOW_PX)
            if window is not None:
                side = 0.5 * _WINDOW_PX
                middle = self._look.middle(window.picture, side, side, _size_px(self._size_m))
                at = view.ground(*window.pixel(*middle)) or at
        return True

    def stop(self) -> None:
        """Follow nothing."""
        self._state, self._tracker, self._confidence = "idle", None, 0.0

    def update(
        self,
        picture: Picture,
        time_s: float,
        view: View,
        velocity_m_s: tuple[float, float] | None = None,
        velocity_sigma_m_s: float = 0.0,
    ) -> Tracked:
        """Search the followed object in a picture (BGR).

        Args:
            time_s: When the picture was taken.
            view: The camera's position and direction then.
            velocity_m_s: The target's velocity (east, north) by the estimate, None where it is not known.
            velocity_sigma_m_s: Its standard deviation.
        """
        if self._state == "idle":
            return Tracked("idle")
        if self._state == "object":
            if velocity_m_s is not None and self._trial is None:
                self._velocity_m_s, self._velocity_sigma_m_s = velocity_m_s, velocity_sigma_m_s
            box = self._followed(picture, time_s, view)
            if box is not None and self._trial is not None:
                self._judge(self._trial, time_s)
            if box is not None and self._state == "object":
                return Tracked("object" if self._trial is None else "lost", box, self._confidence)
        return Tracked("lost", self._sought(picture, time_s, view), 0.0)

    # -- while it is seen ----------------------------------------------------------------------------------

    def _follow(self, picture: Picture, time_s: float, view: View, at_m: tuple[float, float]) -> None:
        """Begin to follow what is on the ground there."""
        window = _Window.around(picture, view, at_m, self._size_m, _WINDOW_PX)
        if window is None:
            return
        middle = 0.5 * _WINDOW_PX, 0.5 * _WINDOW_PX
        self._begin_at(window, *middle)
        self._state, self._at_m, self._seen_s, self._doubts = "object", at_m, time_s, 0
        self._followed_path = _Candidate(deque([(time_s, *at_m)], maxlen=40))
        self._candidates, self._watched_m, self._confidence = [], None, 1.0
        if self._learnt_s == -math.inf:
            self._learn(window, *middle, time_s)
        else:
            self._look.turned(window.picture, *middle, _size_px(self._size_m))

    def _begin_at(self, window: _Window, x_px: float, y_px: float) -> None:
        """Begin the tracker at a place of the window."""
        width, height = _size_px(self._size_m)
        box = round(x_px - 0.5 * width), round(y_px - 0.5 * height), width, height
        self._tracker = (cv2.TrackerCSRT if self._kind == "csrt" else cv2.TrackerKCF).create()
        self._tracker.init(window.picture, box)
        self._shift_px = 0.0, 0.0

    def _followed(self, picture: Picture, time_s: float, view: View) -> Box | None:
        """Return where it is seen; None where it is not, and then it is lost or about to be."""
        expected_m = self.expected_m(time_s)
        window = _Window.around(picture, view, expected_m, self._size_m, _WINDOW_PX)
        if window is None:
            self._lose()
            return None
        ok, (x, y, w, h) = self._tracker.update(window.picture)
        middle = self._centred(window, x + 0.5 * w, y + 0.5 * h) if ok else (0.0, 0.0)
        likeness = self._likeness(window, *middle) if ok else 0.0
        self._confidence += 0.3 * (max(likeness, 0.0) - self._confidence)
        if likeness < _HIDDEN_BELOW:
            self._doubts += 1
            if self._doubts >= _HIDDEN_PICTURES or not ok:
                self._lose()
            return None
        self._doubts = 0
        self._usual += _USUAL_RATE * (min(likeness, 1.0) - self._usual)
        pixel = window.pixel(*middle)
        at = view.ground(*pixel)
        if at is None:
            return None
        self._at_m, self._seen_s = at, time_s
        if self._trial is None:
            self._followed_path.seen.append((time_s, *at))
        if self._trial is None and self._passes(view, at):
            self._trial = _Trial((time_s, *at), _Candidate(deque(maxlen=100)))  # what goes on may be that one
        if likeness > _LEARNT_FROM and time_s - self._learnt_s > _LEARN_EVERY_S:
            self._learn(window, *middle, time_s)
        if self._trial is None and time_s - self._surveyed_s > _SURVEY_EVERY_S:
            self._surveyed_s = time_s
            self._remember_alike(picture, time_s, view)
        scale = view.scale_px_m(*at)
        return Box(*pixel, scale * self._size_m[0], scale * self._size_m[1])

    def _centred(self, window: _Window, x_px: float, y_px: float) -> tuple[float, float]:
        """Return where the object is at the tracker's place: that drifts, and the object's colours do not."""
        x_px, y_px = x_px + self._shift_px[0], y_px + self._shift_px[1]
        off_px = np.subtract(self._look.middle(window.picture, x_px, y_px, _size_px(self._size_m)), (x_px, y_px))
        right_px, down_px = np.clip(off_px, -_CENTRED_PX, _CENTRED_PX).tolist()
        self._shift_px = self._shift_px[0] + right_px, self._shift_px[1] + down_px
        if math.hypot(*self._shift_px) > _DRIFT_PX:
            self._begin_at(window, x_px + right_px, y_px + down_px)
        return x_px + right_px, y_px + down_px

    def _learn(self, window: _Window, x_px: float, y_px: float, time_s: float) -> None:
        self._learnt_s = time_s
        self._look.learn(window.picture, x_px, y_px, _size_px(self._size_m), time_s)

    def _likeness(self, window: _Window, x_px: float, y_px: float) -> float:
        """Return how much a place of the window, or one next to it, looks like the object."""
        width, height = size = _size_px(self._size_m)
        near: Picture = cv2.getRectSubPix(window.picture, (width + 6, height + 6), (x_px, y_px))  # type: ignore[assignment]
        return float(self._look.likeness(near, size, turned=False).max())

    def _judge(self, trial: _Trial, time_s: float) -> None:
        """End a trial: what stands, unlike the object before, is another one."""
        trial.found.seen.append((time_s, *self._at_m))
        speed_m_s = trial.found.speed_m_s(_TRIED_S)
        if speed_m_s is None:
            return
        if speed_m_s < _STANDING_SHARE * math.hypot(*self._velocity_m_s):
            self._alike.append(trial.found)
            self._lose()
        self._trial = None

    def _lose(self) -> None:
        trial, self._trial, followed = self._trial, None, self._followed_path
        if trial is not None:
            moved_m_s = trial.found.speed_m_s(_MOVED_FOR_S)
            if moved_m_s is None or moved_m_s < _STANDING_SHARE * max(math.hypot(*self._velocity_m_s), _MOVES_M_S):
                self._seen_s, self._at_m = trial.lost[0], trial.lost[1:]  # it was not the object
            else:
                followed = trial.found
        if self._velocity_sigma_m_s > _UNSURE_M_S and (velocity_m_s := followed.velocity_m_s) is not None:
            self._velocity_m_s = velocity_m_s
        self._state, self._tracker, self._doubts = "lost", None, 0
        self._candidates, self._watched_m, self._searched_s = [], None, -math.inf
        self._look.forget_lately()

    def _remember_alike(self, picture: Picture, time_s: float, view: View) -> None:
        """Note what else looks like the object now."""
        self._alike = [one for one in self._alike if time_s - one.latest[0] < _REMEMBERED_S]
        for east_m, north_m in self._matches(picture, view, self._at_m, _SURVEY_M):
            here = east_m, north_m
            if not self._is_same(view, here, self._at_m):
                same = [one for one in self._alike if self._is_same(view, one.latest[1:], here)]
                known = same[0] if same else _Candidate()
                known.seen.append((time_s, *here))
                self._alike = [one for one in self._alike if one not in same] + [known]

    def _passes(self, view: View, at_m: tuple[float, float]) -> bool:
        """Return whether the object moves past what looks like it and stands: the tracker may go over to that."""
        speed_m_s = math.hypot(*self._velocity_m_s)
        near = [one for one in self._alike if self._is_same(view, one.latest[1:], at_m)]
        speeds_m_s = [one.speed_m_s(_STOOD_FOR_S) for one in near]
        return speed_m_s > _MOVES_M_S and any(
            other_m_s is not None and other_m_s < _STANDING_SHARE * speed_m_s for other_m_s in speeds_m_s
        )

    def _is_same(self, view: View, one_m: tuple[float, float], other_m: tuple[float, float]) -> bool:
        """Whether two places are one as they are seen: along a low line of sight an error of the gimbal is far."""
        one_px, other_px = view.pixel(*one_m), view.pixel(*other_m)
        if one_px is None or other_px is None:
            return False
        return math.dist(one_px, other_px) < _SAME_SIZES * max(self._size_m) * view.scale_px_m(*one_m)

    # -- while it is hidden --------------------------------------------------------------------------------

    def _sought(self, picture: Picture, time_s: float, view: View) -> Box | None:
        """Search for it; return where it is expected."""
        hidden_s = time_s - self._seen_s
        expected_m, around_m = self.expected_m(time_s), self._at_m
        slack_m_s = max(2.0 * self._velocity_sigma_m_s, _SLACK_M_S)
        away_m = view.focal_px / view.scale_px_m(*self._at_m)
        down_m = max(view.position_m[2] - view.ground_m(*self._at_m), 0.2 * away_m)
        # An error of the box is longer on the ground, the lower the line of sight.
        radius_m = _SLACK_M * away_m / down_m + (slack_m_s + 1.5 * math.hypot(*self._velocity_m_s)) * hidden_s
        if hidden_s > _STOPPED_S:
            around_m = expected_m
        radius_m = min(radius_m, _SEARCH_MAX_M)
        if time_s - self._searched_s >= _SEARCH_EVERY_S:
            self._searched_s = time_s
            found_m = self._matches(picture, view, around_m, radius_m, hidden_s)
            self._take_candidates(time_s, found_m)
            chosen = self._chosen(view, time_s, hidden_s, expected_m)
            if chosen is not None:
                trial = _Trial((self._seen_s, *self._at_m), _Candidate(deque(maxlen=100)))
                self._follow(picture, time_s, view, chosen.latest[1:])
                if chosen.is_moving and hidden_s > _FRESH_S:
                    self._trial = trial
        pixel = view.pixel(*expected_m)
        if pixel is None:
            return None
        scale = view.scale_px_m(*expected_m)
        return Box(*pixel, scale * self._size_m[0], scale * self._size_m[1])

    def _matches(
        self, picture: Picture, view: View, around_m: tuple[float, float], radius_m: float, hidden_s: float = 0.0
    ) -> list[tuple[float, float]]:
        """Return where something looks like the object, within a radius, the most alike first."""
        share = 1.0 if self._look.has_colour else 0.5  # correlation is slow: at half the resolution
        scale = share * _SIDE_PX / max(self._size_m)
        side_px = min(round(2.0 * scale * radius_m) + 2 * _SIDE_PX, _SEARCH_MAX_PX)
        window = _Window.around(picture, view, around_m, self._size_m, side_px, share)
        if window is None:
            return []
        width, height = size = _size_px(self._size_m, share)
        look, alike_from = self._look, min(_ALIKE_FROM, _USUAL_SHARE * self._usual) - _TURNS_PER_S * hidden_s
        alike_from = max(alike_from, _END_ON)
        alike = (
            look.by_colour(window.picture, size)
            if look.has_colour
            else look.by_pictures(window.picture, size, turned=True)
        )
        found: list[tuple[float, float]] = []
        for _ in range(_CANDIDATES_MAX):
            _, value, _, (x, y) = cv2.minMaxLoc(alike)
            if value < alike_from:
                break
            alike[max(y - height, 0) : y + height + 1, max(x - width, 0) : x + width + 1] = -1.0
            at = view.ground(*window.pixel(x + 0.5 * width, y + 0.5 * height))
            near = None if at is None else _Window.around(picture, view, at, self._size_m, 2 * _SIDE_PX)
            if near is None:
                continue
            exact = look.likeness(near.picture, _size_px(self._size_m), turned=True)
            _, value, _, (x, y) = cv2.minMaxLoc(exact)
            full = _size_px(self._size_m)
            middle = look.middle(near.picture, x + 0.5 * full[0], y + 0.5 * full[1], full)
            at = view.ground(*near.pixel(*middle))
            if value < alike_from or at is None or math.dist(at, around_m) > radius_m:
                continue
            if not any(self._is_same(view, at, other) for other in found):
                found.append(at)
        return found

    def _take_candidates(self, time_s: float, found_m: list[tuple[float, float]]) -> None:
        for at in found_m:
            near = [
                one
                for one in self._candidates
                if math.dist(one.latest[1:], at) < 1.5 + 8.0 * (time_s - one.latest[0])
            ]
            candidate = min(near, key=lambda one: math.dist(one.latest[1:], at), default=None)
            if candidate is None:
                candidate = _Candidate()
                self._candidates.append(candidate)
            candidate.seen.append((time_s, *at))
        self._candidates = [one for one in self._candidates if time_s - one.latest[0] < 1.0]

    def _chosen(
        self, view: View, time_s: float, hidden_s: float, expected_m: tuple[float, float]
    ) -> _Candidate | None:
        """Return the candidate that is the object; None while that is not clear."""
        speed_m_s = math.hypot(*self._velocity_m_s)
        rated: list[tuple[float, bool, _Candidate]] = []  # how far off, whether it may be the object, which
        for one in self._candidates:
            if any(self._is_same(view, known.latest[1:], one.latest[1:]) for known in self._alike):
                continue  # it stood there before, next to the object
            off_m, seen_for_s = math.dist(one.latest[1:], expected_m), time_s - one.seen[0][0]
            fits = len(one.seen) >= _SEEN_TIMES and seen_for_s >= _SEEN_FOR_S and time_s - one.latest[0] < 0.3
            may_move = max(speed_m_s, self._velocity_sigma_m_s) > _MOVES_M_S
            if may_move and not (hidden_s < _FRESH_S and self._is_same(view, one.latest[1:], expected_m)):
                moved_m_s = one.speed_m_s(_STANDS_FOR_S)
                stands = moved_m_s is not None and moved_m_s < _STANDING_SHARE * max(speed_m_s, _MOVES_M_S)
                has_stood, is_on_way = seen_for_s >= _STOOD_FOR_S, self._is_on_way(one.latest[1:])
                if stands and has_stood and not is_on_way:
                    self._alike.append(one)
                if stands and not (has_stood and is_on_way and hidden_s > _STOPPED_S):
                    continue  # what stands may have been hidden before, too
                fits &= moved_m_s is not None
            rated.append((off_m, fits, one))
        rated.sort(key=lambda rate: rate[0])
        self._watched_m = rated[0][2].latest[1:] if rated else None
        # The nearest, and not before it is known whether it moves; at first, of two about as near, neither.
        unclear = len(rated) > 1 and rated[0][0] > 0.5 * rated[1][0] and hidden_s < _STOPPED_S
        return rated[0][2] if rated and rated[0][1] and not unclear else None

    def _is_on_way(self, at_m: tuple[float, float]) -> bool:
        """Return whether the object may have stopped there, as it went straight on."""
        speed_m_s = max(math.hypot(*self._velocity_m_s), 1e-3)
        ahead, aside = (one / speed_m_s for one in self._velocity_m_s)
        east_m, north_m = at_m[0] - self._at_m[0], at_m[1] - self._at_m[1]
        along_m = min(max(ahead * east_m + aside * north_m, 0.0), speed_m_s * _STOPPED_S)
        off_m = math.hypot(east_m - along_m * ahead, north_m - along_m * aside)
        return off_m < _ON_WAY_M


@dataclass(frozen=True, slots=True)
class _Window:
    """A square of a picture, resampled.

    Attributes:
        picture: BGR, shape (side, side, 3).
        corner_px: its upper left corner in the picture.
        scale: pixels of the window in one of the picture.
    """

    picture: Picture
    corner_px: tuple[float, float]
    scale: float

    @staticmethod
    def around(
        picture: Picture,
        view: View,
        at_m: tuple[float, float],
        size_m: tuple[float, float],
        side_px: int,
        share: float = 1.0,
    ) -> _Window | None:
        """Cut a window in whose middle a point on the ground is; None where that is outside the picture."""
        pixel = view.pixel(*at_m)
        if pixel is None:
            return None
        scale = share * _SIDE_PX / (max(size_m) * view.scale_px_m(*at_m))
        half = 0.5 * side_px / scale
        x, y = pixel
        height, width = picture.shape[:2]
        if not (-half < x < width + half and -half < y < height + half):
            return None
        affine = np.array([[scale, 0.0, 0.5 * side_px - scale * x], [0.0, scale, 0.5 * side_px - scale * y]])
        cut = cv2.warpAffine(picture, affine, (side_px, side_px), borderMode=cv2.BORDER_REPLICATE)
        return _Window(cut, (x - half, y - half), scale)  # type: ignore[arg-type]

    def pixel(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return the place in the picture of one in the window."""
        return self.corner_px[0] + x_px / self.scale, self.corner_px[1] + y_px / self.scale


def _size_px(size_m: tuple[float, float], share: float = 1.0) -> tuple[int, int]:
    scale = share * _SIDE_PX / max(size_m)
    return max(round(scale * size_m[0]), 8), max(round(scale * size_m[1]), 8)
