"""Announcements about the target: in view, not seen for some time, lost, or in view again."""

from __future__ import annotations

from enum import StrEnum

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.events import Announce

# A shorter gap is not announced: lasers often miss for some seconds.
_AFTER_S = 8.0


class _Sight(StrEnum):
    SEEN = "seen"
    UNSEEN = "unseen"
    LOST = "lost"


class TargetNews:
    """Keeps the latest announcement."""

    def __init__(self) -> None:
        self._told: _Sight | None = None

    def tell(self, time_s: float, estimate: TargetEstimate) -> tuple[Announce, ...]:
        """Return a new announcement about the target; None if nothing has changed."""
        unseen_s = time_s - estimate.last_sighting_s
        sight = _Sight.SEEN
        if estimate.quality is TrackQuality.LOST:
            sight = _Sight.LOST
        elif unseen_s > _AFTER_S:
            sight = _Sight.UNSEEN
        before, self._told = self._told, sight
        if sight is before:
            return ()
        match sight:
            case _Sight.SEEN:
                text = "the target is in sight" + (" again" if before is not None else "")
            case _Sight.UNSEEN:
                text = f"the target has not been seen for {unseen_s:.0f} s; its track goes on by its last motion"
            case _Sight.LOST:
                text = (
                    f"the target is lost: {estimate.reason or f'not seen for {unseen_s:.0f} s'}; holding the circle"
                )
        return (Announce(time_s, "track", text),)
