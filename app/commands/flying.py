"""Functions shared by flights of one aircraft and of a fleet: predicting, running and retaining its records."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any, TypeVar

from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.flight.life import Life
from sidelong.app.process import interrupt_dropped, run

_FLIGHTS = 4  # predicted before a launch: 3 s
_NOTHING_COMMANDED = "interrupted: nothing was commanded; no records are kept."

T = TypeVar("T")


def run_flight(flight: Coroutine[Any, Any, T]) -> T:
    """Run a flight to its end. Raises Interrupted where it was ended before anything was commanded."""
    try:
        return run(flight)
    except (asyncio.CancelledError, KeyboardInterrupt) as interrupted:
        raise Interrupted(_NOTHING_COMMANDED) from interrupted
    except Exception as error:
        if interrupt_dropped():  # before a flight alone: in it an interrupt raises nothing
            raise Interrupted(_NOTHING_COMMANDED) from error
        raise


@contextlib.contextmanager
def kept_if_armed(records: Path) -> Iterator[Callable[[Life], Life]]:
    """Remove a run folder if the body of the ``with`` fails before an aircraft was armed.

    Yields a function to call with each flight's life. Raises FlightError if the flight itself failed.
    """
    lives: list[Life] = []

    def begun(life: Life) -> Life:
        lives.append(life)
        return life

    try:
        yield begun
    except BaseException as error:
        if not any(life.was_armed for life in lives):
            shutil.rmtree(records, ignore_errors=True)
        failure = lives[0].failure if lives else None
        if isinstance(error, asyncio.CancelledError) and failure is not None:
            raise FlightError(failure) from None
        raise


def warn_of_prediction(config: Config, note: Callable[[str], object]) -> None:
    """Report what keeps a few simulated flights of a configuration from the requirement; ``check`` flies more.

    Before the code is compiled for the first time, and with figures of eight, this would take up to a minute:
    ``check`` is then recommended instead.
    """
    from sidelong.app.study.prediction import predict  # noqa: PLC0415  # only once the options are checked
    from sidelong.app.study.study import is_compiled  # noqa: PLC0415  # likewise

    if not is_compiled(config.planner.name) or config.aircraft.aircraft().has_pan_limit:
        note("how well this requirement can be kept has not been computed yet: sidelong check does it")
        return
    try:
        prediction = predict(config, flights=_FLIGHTS)
    except InputError as error:  # of the study alone: the flight has been checked
        note(f"how well this requirement can be kept cannot be computed: {error}")
        return
    shortcoming = prediction.shortcoming(config)
    if shortcoming:
        note(f"warning: sidelong check refuses this configuration: {shortcoming}")
