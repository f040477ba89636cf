"""The study's figure: path, range, observation angle and its histogram, like the paper's figures 16, 20, 22, 23."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sidelong.app.study.judging import Track
from sidelong.app.study.settings import PlannerName, StudySettings
from sidelong.app.study.study import StudyResult, flown_again

_TICK_S = 50.0


def write_figure(result: StudyResult, file: Path) -> None:
    """Draw the first run of each planner and the histogram of all runs. Raises OSError; ValueError for its format."""
    figure = Figure(figsize=(14.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    tracks = {name: flown_again(planner.runs[0], result.settings) for name, planner in result.planners.items()}
    draw_paths(axes[0, 0], tracks)
    axes[0, 0].set_title(f"run {result.settings.numbers[0]}, a dot every {_TICK_S:.0f} s")
    _range(axes[0, 1], result.settings, tracks)
    _angle(axes[1, 0], tracks)
    _histogram(axes[1, 1], result)
    figure.savefig(file, dpi=110)


def draw_paths(axes: Axes, tracks: Mapping[PlannerName, Track]) -> None:
    """Draw the planners' paths together with the target, which is the same for all."""
    for k, (name, track) in enumerate(tracks.items()):
        axes.plot(*track.aircraft_m.T, linewidth=0.8, label=name, zorder=3 - 0.1 * k)
    target = next(iter(tracks.values()))
    axes.plot(*target.target_m.T, "k", linewidth=2.0, label="target")
    ticks = np.searchsorted(target.time_s, np.arange(0.0, target.time_s[-1], _TICK_S))
    axes.plot(*target.target_m[ticks].T, "k.", markersize=6.0)
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend()
    axes.grid(alpha=0.3)


def _range(axes: Axes, settings: StudySettings, tracks: Mapping[PlannerName, Track]) -> None:
    axes.axhspan(settings.range_min_m, settings.range_max_m, color="0.93")
    for name, track in tracks.items():
        axes.plot(track.time_s, track.judged.range_m, linewidth=0.9, label=name)
    axes.set(title="range to the target; grey: the band", xlabel="time, s", ylabel="range, m", ylim=(0.0, None))
    axes.legend()
    axes.grid(alpha=0.3)


def _angle(axes: Axes, tracks: Mapping[PlannerName, Track]) -> None:
    axes.axhspan(-90.0, 90.0, color="0.93")
    for name, track in tracks.items():
        angle_deg = np.degrees(track.judged.observation_rad)
        # No line across the jump from 180 to -180 degrees.
        jump = np.flatnonzero(np.abs(np.diff(angle_deg)) > 180.0) + 1
        time_s = np.insert(track.time_s, jump, math.nan)
        axes.plot(time_s, np.insert(angle_deg, jump, math.nan), linewidth=0.9, label=name)
    axes.set(
        title="observation angle, from the normal of the target's course; grey: the side",
        xlabel="time, s",
        ylabel="angle, °",
        ylim=(-180.0, 180.0),
        yticks=range(-180, 181, 45),
    )
    axes.legend()
    axes.grid(alpha=0.3)


def _histogram(axes: Axes, result: StudyResult) -> None:
    axes.axvspan(-90.0, 90.0, color="0.93")
    for name, planner in result.planners.items():
        counts = planner.observation_histogram
        axes.stairs(100.0 * counts / counts.sum(), np.linspace(-180.0, 180.0, counts.size + 1), label=name)
    axes.set(
        title=f"observation angle of all {len(result.settings.numbers)} runs",
        xlabel="angle, °",
        ylabel="share of the time in 5°, %",
        xlim=(-180.0, 180.0),
        xticks=range(-180, 181, 45),
    )
    axes.legend()
    axes.grid(alpha=0.3)
