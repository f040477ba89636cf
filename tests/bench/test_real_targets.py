"""The filter on recorded movers: does its 95 % ellipse hold them, and how far off is it?

    python -m tests.bench.test_real_targets FOLDER [--kind KIND] [--biases drawn] [--draws N] [--worst N]
    python -m pytest -s tests/bench/test_real_targets.py

FOLDER holds tracks as ``sidelong study --targets`` takes them; a track's kind is in ``manifest.csv`` (columns
file, kind) or by its name. The aircraft flies circles of 80 m, 300 m south of the target and 100 m above it; laser
and gimbal measure at 10 Hz with 0.8 m, 0.35 degrees and a yaw error of 0.4 degrees that the filter has to find, or
with three errors drawn as large as the filter assumes: only then can the pooled share be what the ellipse promises,
while single tracks depend on what was drawn for them. The first 5 s are not judged.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sidelong.app.study.recorded import RecordedTarget, recorded_targets
from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.track import Track

OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
STEP_S, SKIPPED_S, HEIGHT_M = 0.1, 5.0, 100.0
CIRCLE_M, ASIDE_M, AIRSPEED_M_S, FOLLOWED_S = 80.0, 300.0, 15.0, 15.0
SIGMAS = np.array([0.8, math.radians(0.35), math.radians(0.35)])
POSITION_SIGMA_M = 0.3
FIXED_BIAS = np.array([math.radians(0.4), 0.0, 0.0])  # yaw, pitch, range
CHI2_95 = 5.991
# The kinds of the settings by those of a collection.
KINDS = {
    **dict.fromkeys(("walker", "pedestrian", "hike", "walk", "run"), "walker"),
    **dict.fromkeys(("cyclist", "cycle", "bike", "ski"), "cyclist"),
    **dict.fromkeys(("car", "tractor", "drive"), "car"),
    "boat": "boat",
    "animal": "animal",
}


@dataclass(frozen=True)
class Held:
    """Of one track: share of the time within the 95 % ellipse, RMSE of place and velocity."""

    name: str
    kind: str
    held: float
    rmse_m: float
    rmse_m_s: float
    steps: int


def sightings(target: RecordedTarget, draw: int, drawn: bool) -> tuple[np.ndarray, list[Sighting]]:
    """Return the truth (n, 4), place and velocity, and what is seen of it; drawn: with biases as the prior's."""
    rng = np.random.default_rng((draw, target.key))
    sigmas = np.sqrt(np.diag(Biases.prior(TrackerSettings()).covariance))
    # The noise is the same either way.
    bias = sigmas * np.random.default_rng((draw, target.key, 1)).standard_normal(3) if drawn else FIXED_BIAS
    yaw_rad, pitch_rad, offset_m = bias
    time_s = np.arange(0.0, target.duration_s, STEP_S)
    truth = target.sampled(time_s)[:, :4]
    angle = rng.uniform(0.0, math.tau) + time_s * AIRSPEED_M_S / CIRCLE_M
    centre, follow = truth[0, :2], 1.0 - math.exp(-STEP_S / FOLLOWED_S)
    seen = []
    for k, place in enumerate(truth[:, :2]):
        centre = centre + follow * (place - centre)
        craft = centre + np.array((CIRCLE_M * math.sin(angle[k]), CIRCLE_M * math.cos(angle[k]) - ASIDE_M))
        east, north = place - craft
        level = math.hypot(east, north)
        true = math.hypot(level, HEIGHT_M), math.atan2(east, north), math.atan2(HEIGHT_M, level)
        measured = np.array(true) + (offset_m, yaw_rad, -pitch_rad) + SIGMAS * rng.standard_normal(3)
        across_rad = POSITION_SIGMA_M / level, POSITION_SIGMA_M / true[0]
        sigmas = np.hypot(SIGMAS, (POSITION_SIGMA_M, *across_rad))
        seen.append(Sighting(float(time_s[k]), *measured.tolist(), *sigmas.tolist(), *craft.tolist(), HEIGHT_M))
    return truth, seen


def followed(target: RecordedTarget, kind: str, settings: TrackerSettings, draw: int, drawn: bool) -> Held:
    track = Track(settings)
    truth, seen = sightings(target, draw, drawn)
    skipped = round(SKIPPED_S / STEP_S)
    errors, nees = np.zeros((len(seen), 4)), np.zeros(len(seen))
    for k, sighting in enumerate(seen):
        track.add(sighting)
        estimate = track.estimate(sighting.time_s)
        assert estimate is not None
        given = estimate.east_m, estimate.north_m, estimate.velocity_east_m_s, estimate.velocity_north_m_s
        errors[k] = np.array(given) - truth[k]
        nees[k] = errors[k, :2] @ np.linalg.solve(estimate.covariance[:2, :2], errors[k, :2])
    errors, nees = errors[skipped:], nees[skipped:]
    square = errors**2
    rmse_m, rmse_m_s = (math.sqrt(square[:, k : k + 2].sum(axis=1).mean()) for k in (0, 2))
    return Held(target.name, kind, float((nees <= CHI2_95).mean()), rmse_m, rmse_m_s, len(nees))


def kinds_of(folder: Path) -> dict[str, str]:
    manifest = folder / "manifest.csv"
    if not manifest.exists():
        return {}
    with manifest.open(newline="", encoding="utf-8") as file:
        return {Path(row["file"]).stem: row["kind"] for row in csv.DictReader(file)}


def measured(
    folder: Path, settings: dict[str, TrackerSettings], draws: int, speed_max_m_s: float, drawn: bool
) -> Iterator[Held]:
    """settings: by kind, or under ``""`` for all; drawn: see :func:`sightings`."""
    given = kinds_of(folder)
    for target in recorded_targets([folder], speed_max_m_s).flown:
        name = given.get(target.name, target.name.partition("_")[0])
        kind = KINDS.get(name, "unknown")
        for draw in range(draws):
            yield followed(target, kind, settings.get(kind, settings.get("", TrackerSettings())), draw, drawn)


def table(found: Iterable[Held], worst: int = 5) -> str:
    found = list(found)
    groups = {"all": found} | {kind: [one for one in found if one.kind == kind] for kind in {f.kind for f in found}}
    lines = ["| kind | tracks | ellipse holds, pooled / worst / best, % | RMSE, m | m/s |", "| --- " * 5 + "|"]
    for kind, of in groups.items():
        weights = np.array([one.steps for one in of], float)
        held, rmse_m, rmse_m_s = (np.array([getattr(o, a) for o in of]) for a in ("held", "rmse_m", "rmse_m_s"))
        lines.append(
            f"| {kind} | {len({o.name for o in of})} | {100 * np.average(held, weights=weights):.1f} / "
            f"{100 * held.min():.1f} / {100 * held.max():.1f} | "
            f"{math.sqrt(np.average(rmse_m**2, weights=weights)):.2f} | "
            f"{math.sqrt(np.average(rmse_m_s**2, weights=weights)):.2f} |"
        )
    for one in sorted(found, key=lambda held: held.held)[:worst]:
        lines.append(f"{one.name}: {100 * one.held:.1f} %, {one.rmse_m:.2f} m, {one.rmse_m_s:.2f} m/s")
    return "\n".join(lines)


def test_the_ellipse_holds_recorded_movers():
    for drawn, draws, pooled_max in ((False, 1, 0.99), (True, 3, 0.98)):
        found = list(measured(OWN, {}, draws, 30.0, drawn))
        print("\n" + table(found))
        assert 0.92 <= np.average([one.held for one in found], weights=[one.steps for one in found]) <= pooled_max
        if not drawn:
            assert min(one.held for one in found) >= 0.85


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kind", help="configure the filter for this kind of target, 'own': each track its own")
    parser.add_argument("--biases", choices=("fixed", "drawn"), default="fixed", help="the payload's errors")
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--speed-max", type=float, default=14.0, help="skip tracks faster than this, m/s")
    parser.add_argument("--worst", type=int, default=5)
    given = parser.parse_args()
    kinds = {*KINDS.values(), "unknown"} if given.kind == "own" else {given.kind} - {None}
    settings = {kind if given.kind == "own" else "": TrackerSettings(target_kind=kind) for kind in kinds}
    print(table(measured(given.folder, settings, given.draws, given.speed_max, given.biases == "drawn"), given.worst))


if __name__ == "__main__":
    main()
