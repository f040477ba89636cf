"""How well recorded targets could be watched by an aircraft that knows their whole way and may turn at any time.

    python -m tests.bench.test_clairvoyant_bound FOLDER --airspeed 12 --radius 40 --target-speed-max 5 [--name car]
    python -m pytest -s tests/bench/test_clairvoyant_bound.py

A dynamic programme goes backwards over the known way: states are the place relative to the target and the heading,
controls are curvatures up to that of the circle, without a limit of the roll. What is printed is then flown forwards
by what it found: it can be reached, and but for the grid's width nothing better can. What a planner stays below it is
the price of not knowing the target, of wanting few moves, and of its own search. With --known it knows this many
seconds at each moment only, and cares for nothing beyond.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sidelong.app.study.recorded import RecordedTarget, recorded_targets
from sidelong.estimators.compiled import compiled
from sidelong.mission.viewpoint.watch_course import courses_made_good_rad

FloatArray = npt.NDArray[np.float64]
OWN = Path(__file__).parents[2] / "app" / "study" / "tracks"
STEP_S, CELL_M, HALF_CELLS, HEADINGS = 2.0, 20.0, 28, 36
NEAR_M, FAR_M, MARGIN_M = 100.0, 500.0, 5.0
START_M, HORIZON_S = 300.0, 20.0
OUTSIDE, OUTSIDE_PER_M = 20.0, 0.5
AGAIN = 3  # steps after which the planner learns the future again


@compiled
def _rates(course_rad: float, found: npt.NDArray[np.float32]) -> None:
    """Fill in what a second costs at each place (n, n): 1 on the wrong side, far more outside the band."""
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            x_m, y_m = (i - HALF_CELLS) * CELL_M, (j - HALF_CELLS) * CELL_M
            range_m = math.hypot(x_m, y_m)
            out_m = max(NEAR_M + MARGIN_M - range_m, range_m - FAR_M + MARGIN_M)
            offset_m = y_m * math.sin(course_rad) - x_m * math.cos(course_rad)
            found[i, j] = min(max(0.5 - (offset_m - 0.5 * CELL_M) / CELL_M, 0.0), 1.0)
            if out_m > 0.0:
                found[i, j] += OUTSIDE + OUTSIDE_PER_M * out_m


@compiled
def _to_go(way: FloatArray, moves: FloatArray, values: npt.NDArray[np.float32]) -> None:
    """Fill in what is still to be paid: values (k, headings, n, n) for a way (k, 3), east, north and course.

    moves (headings, turns, 2): displacements of a step; the middle one of the turns is straight on.
    """
    steps, headings, n, _ = values.shape
    turns = moves.shape[1]
    rates, nearest = np.empty((n, n), np.float32), np.empty(n, np.int64)
    for k in range(steps - 1, -1, -1):
        _rates(way[k, 2], rates)
        for h in range(headings):
            values[k, h] = STEP_S * rates
            if k == steps - 1:
                continue
            best = np.full((n, n), np.inf, np.float32)
            for t in range(turns):
                after = values[k + 1, (h + t - turns // 2) % headings]
                x = (moves[h, t, 0] - way[k + 1, 0] + way[k, 0]) / CELL_M
                y = (moves[h, t, 1] - way[k + 1, 1] + way[k, 1]) / CELL_M
                i, j = math.floor(x), math.floor(y)
                a, b = np.float32(x - i), np.float32(y - j)
                for q in range(n):
                    nearest[q] = min(max(q + j, 0), n - 2)
                for p in range(n):
                    low = min(max(p + i, 0), n - 2)
                    for q in range(n):
                        c = nearest[q]
                        one = after[low, c] + b * (after[low, c + 1] - after[low, c])
                        two = after[low + 1, c] + b * (after[low + 1, c + 1] - after[low + 1, c])
                        best[p, q] = min(best[p, q], one + a * (two - one))
            values[k, h] += best


@compiled
def _flown(
    way: FloatArray,
    moves: FloatArray,
    values: npt.NDArray[np.float32],
    x_m: float,
    y_m: float,
    h: int,
    found: FloatArray,
) -> tuple[float, float, int]:
    """Fly on from a place relative to the target and a heading; fill in places (k, 2), return what comes next."""
    steps, headings, n, _ = values.shape
    turns = moves.shape[1]
    for k in range(len(found)):
        found[k, 0], found[k, 1] = x_m, y_m
        if k == steps - 1:
            break
        least, best = np.inf, 0
        for t in range(turns):
            x = (x_m + moves[h, t, 0] - way[k + 1, 0] + way[k, 0]) / CELL_M + HALF_CELLS
            y = (y_m + moves[h, t, 1] - way[k + 1, 1] + way[k, 1]) / CELL_M + HALF_CELLS
            i, j = min(max(int(x), 0), n - 2), min(max(int(y), 0), n - 2)
            a, b, after = x - i, y - j, values[k + 1, (h + t - turns // 2) % headings]
            low = after[i, j] + b * (after[i, j + 1] - after[i, j])
            high = after[i + 1, j] + b * (after[i + 1, j + 1] - after[i + 1, j])
            if low + a * (high - low) < least:
                least, best = low + a * (high - low), t
        x_m += moves[h, best, 0] - way[k + 1, 0] + way[k, 0]
        y_m += moves[h, best, 1] - way[k + 1, 1] + way[k, 1]
        h = (h + best - turns // 2) % headings
    return x_m, y_m, h


def bound(
    target: RecordedTarget, airspeed_m_s: float, radius_m: float, known_s: float = math.inf
) -> tuple[float, float, float]:
    """Return the shares of time on the left, by the course made good in 20 s, and in the band; the least range."""
    time_s = np.arange(0.0, min(target.duration_s, 1200.0), STEP_S)
    east, north = target.sampled(time_s)[:, :2].T
    place_m = np.stack([east, north], axis=1)
    made_good = courses_made_good_rad(
        time_s, place_m, np.gradient(place_m, STEP_S, axis=0), np.full(time_s.size, HORIZON_S)
    )
    known = ~np.isnan(made_good)
    way = np.column_stack([place_m, np.where(known, made_good, made_good[np.argmax(known)])])
    turn_rad = math.tau / HEADINGS
    most = int(airspeed_m_s * STEP_S / radius_m / turn_rad + 1e-9)
    turned = turn_rad * np.arange(-most, most + 1)
    middle = turn_rad * np.arange(HEADINGS)[:, None] + 0.5 * turned
    chord_m = airspeed_m_s * STEP_S * np.sinc(0.5 * turned / math.pi)
    moves = np.stack([chord_m * np.sin(middle), chord_m * np.cos(middle)], axis=2)
    cells = 2 * HALF_CELLS + 1
    given = round(min(known_s / STEP_S + 1.0, len(way)))
    values = np.empty((given, HEADINGS, cells, cells), np.float32)
    flown, course = np.empty((len(way), 2)), way[:, 2]
    x_m, y_m, heading = -START_M * math.cos(course[0]), START_M * math.sin(course[0]), 0
    restarted = AGAIN if given < len(way) else len(way)
    for first in range(0, len(way), restarted):
        ahead, to_go = way[first : first + given], values[: len(way) - first]
        _to_go(ahead, moves, to_go)
        x_m, y_m, heading = _flown(ahead, moves, to_go, x_m, y_m, heading, flown[first : first + restarted])
    range_m = np.hypot(*flown.T)
    left = flown[:, 1] * np.sin(course) - flown[:, 0] * np.cos(course) >= 0.0
    in_band = (range_m >= NEAR_M) & (range_m <= FAR_M)
    return float(left[known].mean()) if known.any() else math.nan, float(in_band.mean()), float(range_m.min())


def shown(
    folder: Path,
    airspeed_m_s: float,
    radius_m: float,
    speed_max_m_s: float,
    name: str = "",
    worst: int = 12,
    known_s: float = math.inf,
) -> FloatArray:
    """Print and return the bounds (tracks, 3) of those whose names begin with name."""
    tracks = [one for one in recorded_targets([folder], speed_max_m_s).flown if one.name.startswith(name)]
    found = np.array([bound(one, airspeed_m_s, radius_m, known_s) for one in tracks])
    sides = found[:, 0]
    print(f"\n{len(tracks)} tracks: on side {np.nanmean(sides):.4f}, worst {np.nanmin(sides):.3f}; ", end="")
    print(f"in band {found[:, 1].mean():.4f}, least range {found[:, 2].min():.0f} m")
    for k in np.argsort(sides)[:worst]:
        print(f"  {tracks[k].name}: {sides[k]:.3f}")
    return found


def test_whoever_knows_the_way_is_always_on_the_side():
    found = shown(OWN, 12.0, 40.0, 5.0, worst=3)
    assert np.nanmean(found[:, 0]) > 0.99
    assert found[:, 1].min() > 0.999


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    for name in ("airspeed", "radius", "target-speed-max"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--name", default="", help="only tracks whose names begin with this")
    parser.add_argument("--worst", type=int, default=12)
    parser.add_argument("--known", type=float, default=math.inf, help="seconds that are known ahead")
    given = parser.parse_args()
    speed_max_m_s = given.target_speed_max
    shown(given.folder, given.airspeed, given.radius, speed_max_m_s, given.name, given.worst, given.known)


if __name__ == "__main__":
    main()
