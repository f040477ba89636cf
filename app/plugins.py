"""Find planners, payloads and autopilots of other distributions by their entry points."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import entry_points

from sidelong.app.errors import InputError


def found(group: str, own: Iterable[str], methods: tuple[str, ...]) -> list[object]:
    """Return what the entry points of a group name, made where that is a class without arguments.

    Args:
        group: ``sidelong.planners``, ``sidelong.payloads`` or ``sidelong.autopilots``.
        own: The names that are taken already.
        methods: What each object needs to have, besides a name.

    Raises:
        InputError: One cannot be loaded, lacks something, or has a name that is taken.
    """
    taken, objects = set(own), []
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
        if one.name in taken:
            raise InputError(f"{origin} of {group}: the name {one.name!r} is taken; rename it or uninstall it.")
        taken.add(one.name)
        objects.append(one)
    return objects
