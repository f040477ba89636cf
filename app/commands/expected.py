"""The warning of ``launch`` about a configuration that ``check`` refuses."""

from __future__ import annotations

from collections.abc import Callable

from sidelong.app.config import Config
from sidelong.estimators.compiled import is_cached


def warn_of_prediction(config: Config, note: Callable[[str], object]) -> None:
    """Report what keeps simulated flights of a configuration from the requirement, as ``check`` would.

    Before the study's code is compiled for the first time this would take up to a minute: ``check`` is then
    recommended instead.
    """
    from sidelong.app.study.flight_kernel import advance  # noqa: PLC0415  # only once the options are checked
    from sidelong.app.study.prediction import predict  # noqa: PLC0415  # likewise

    if not is_cached(advance):
        note("how well this requirement can be kept has not been computed yet: sidelong check does it")
        return
    shortcoming = predict(config).shortcoming(config)
    if shortcoming:
        note(f"warning: sidelong check refuses this configuration: {shortcoming}")
