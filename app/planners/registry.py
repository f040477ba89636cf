"""The configurable planners, the default first. Add a new one as a module in this folder and a line here.

Other distributions add theirs by the entry point group ``sidelong.planners``: a class with ``decide``, which is made
with the aircraft and the requirement, or a ``PlannerKind``.
"""

from __future__ import annotations

from sidelong.app.planners.planner_kind import Paper, PlannerKind, Predictive, kind_of
from sidelong.app.plugins import with_plugins

PLANNERS: tuple[PlannerKind, ...] = with_plugins(
    "sidelong.planners",
    (Predictive(), Paper()),
    ("about", "unflyable", "is_compiled", "factory", "make_ready"),
    made=kind_of,
)
PLANNER_NAMES = tuple(planner.name for planner in PLANNERS)


def planner_by_name(name: str) -> PlannerKind:
    """Return the kind of planner of a name. Raises KeyError for an unknown one."""
    return dict(zip(PLANNER_NAMES, PLANNERS, strict=True))[name]
