"""Find planners, payloads and autopilots of other distributions by their entry points."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Protocol, TypeVar

from sidelong.app.errors import InputError


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)


def with_plugins(group: str, own: Sequence[T], methods: Sequence[str], taken: Sequence[str] = ()) -> tuple[T, ...]:
    """Return ``own`` and what the entry points of a group name, made where that is a class without arguments.

    Args:
        group: ``sidelong.planners``, ``sidelong.payloads`` or ``sidelong.autopilots``.
        own: Those of this distribution.
        methods: What each object needs to have, besides a name.
        taken: Names that are taken, besides those of ``own``.

    Raises:
        InputError: One cannot be loaded, lacks something, or has a name that is taken.
    """
    objects, names = list(own), {*taken, *(one.name for one in own)}
    for point in entry_points(group=group):
        origin = f"{point.dist.name if point.dist is not None else 'a distribution'}: entry point {point.name}"
        try:
            loaded = point.load()
            one = loaded() if isinstance(loaded, type) else loaded
        except Exception as error:
            raise InputError(
                f"{origin} of {group} cannot be loaded ({error!r}); repair it or uninstall it."
            ) from error
        missing = [name for name in ("name", *methods) if not hasattr(one, name)]
        if missing:
            raise InputError(f"{origin} of {group} lacks {', '.join(missing)}; repair it or uninstall it.")
        if one.name in names:
            raise InputError(f"{origin} of {group}: the name {one.name!r} is taken; rename it or uninstall it.")
        names.add(one.name)
        objects.append(one)
    return tuple(objects)
