"""Room for the look ahead along a route; :mod:`sidelong.mission.predictive.decision_kernel` fills it.

Source: docs/routes.md#how-the-route-is-used.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import new_record
from sidelong.mission.predictive.cost_kernel import Table
from sidelong.mission.predictive.foresight_kernel import (
    CELLS,
    HEADINGS,
    HORIZON_S,
    LAYERS,
    SIZE,
    RouteValues,
    layer_s,
    resample,
)
from sidelong.mission.predictive.value_table import TableConfiguration
from sidelong.mission.route.progress import way_of
from sidelong.mission.route.progress_kernel import Progress, RouteArrays, fresh_progress
from sidelong.mission.route.route import Route

_NOTHING = np.zeros((1, 1, 1, 1), np.float32)


def no_route_values() -> RouteValues:
    """Return what a planner without a route looks ahead with."""
    way = RouteArrays(np.zeros((0, 2)), 1.0, False, 1.0, math.nan, 0.0)
    return RouteValues(way, fresh_progress(0), _NOTHING, _NOTHING, 1.0, np.zeros(1), new_record(LAYERS))


def route_values(route: Route, own: Table, c: TableConfiguration, progress: Progress) -> RouteValues:
    """Return room for the layers along a route, and the table's classes on their grid.

    Args:
        route: The target's route.
        own: Value table of the planner.
        c: Its configuration, or that of a table for another wind.
        progress: State of the progress filter, which tables for several winds share.
    """
    classes = len(own.values)
    layers = math.ceil(HORIZON_S / layer_s(c.airspeed_m_s, c.radius_m)) + 1
    cell_m = c.half_width_m / CELLS
    values = np.zeros((classes + layers, HEADINGS, SIZE, SIZE), np.float32)
    after_turn = np.zeros((classes + HEADINGS, HEADINGS, SIZE, SIZE), np.float32)
    share = np.array([[[1.0, 0.0, 0.0, 0.0]]])
    for one in range(classes):
        mixed = np.array([[[one, 0, 0, 0]]])
        resample(own.values, own.cell_m, mixed, share, 0, 0, cell_m, 0.0, values[one])
        resample(own.after_turn, own.cell_m, mixed, share, 0, 0, cell_m, 0.0, after_turn[one])
    least = values.min(axis=(1, 2, 3)).astype(np.float64)
    state = new_record(LAYERS)
    state[0].computed_s = -np.inf
    return RouteValues(way_of(route), progress, values, after_turn, cell_m, least, state)
