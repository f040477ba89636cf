"""Find planners, payloads and autopilots of other distributions by their entry points."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any, Protocol, TypeVar


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)


def with_plugins(
    group: str,
    own: Sequence[T],
    methods: Sequence[str],
    taken: Sequence[str] = (),
    made: Callable[[str, Any], Any] = lambda _name, loaded: loaded() if isinstance(loaded, type) else loaded,
) -> tuple[T, ...]:
    """Return ``own`` and what the entry points of a group name, but for those that are faulty, which are reported.

    methods: what each object needs to have, besides a name. taken: names that are taken, besides those of ``own``.
    made: makes the object of an entry point's name and what it loads; by default it calls a class.
    """
    objects, names = list(own), {*taken, *(one.name for one in own)}
    for point in entry_points(group=group):
        fault = ""
        try:
            one = made(point.name, point.load())
        except Exception as error:
            fault = f"cannot be loaded ({error!r})"
        else:
            missing = [name for name in ("name", *methods) if not hasattr(one, name)]
            if missing:
                fault = f"lacks {', '.join(missing)}"
            elif one.name in names:
                fault = f"has the name {one.name!r}, which is taken"
        if fault:
            origin = point.dist.name if point.dist is not None else "a distribution"
            entry = f"sidelong: {origin}: entry point {point.name} of {group} {fault}"
            print(f"{entry}; it is left out. Repair it or uninstall it.", file=sys.stderr)
            continue
        names.add(one.name)
        objects.append(one)
    return tuple(objects)
