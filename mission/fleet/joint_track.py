"""One track of a target, fed with the sightings of several payloads on one mission time."""

from __future__ import annotations

from collections.abc import Mapping

from estimators.estimate import TargetEstimate
from estimators.fusion import Fusion, fused
from estimators.settings import TrackerSettings
from estimators.sighting import AnySighting
from estimators.track import Track


class JointTrack:
    """Of one target. settings: what is known of each payload; sightings are on mission time."""

    def __init__(self, settings: Mapping[str, TrackerSettings]) -> None:
        self._tracks = {name: Track(one) for name, one in settings.items()}
        self._fusion = Fusion(None, {})

    def add(self, name: str, sighting: AnySighting, clock_sigma_s: float) -> None:
        """Take a payload's sighting in; clock_sigma_s: how well its time is known."""
        self._tracks[name].add(sighting)

    def estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the estimate at a time; None before the first sighting."""
        known = {name: track.estimate(time_s) for name, track in self._tracks.items()}
        self._fusion = fused({name: one for name, one in known.items() if one is not None})
        return self._fusion.estimate

    @property
    def refused(self) -> Mapping[str, str]:
        """Payloads that the latest estimate leaves out, each with the reason in words."""
        return self._fusion.refused
