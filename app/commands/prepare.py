"""``sidelong prepare``: compile and compute ahead what a first flight would otherwise wait for."""

from __future__ import annotations

import time

from sidelong.app.commands.options import ConfigArgument, SetOption, changed_keys
from sidelong.app.commands.output import say, table_progress
from sidelong.app.config import check_alone, check_flyable, load_config


def prepare(config: ConfigArgument = None, set_: SetOption = None) -> None:
    """Compile the inner loops and compute the planner's value tables, so that the next start takes seconds.

    Run it after each installation, as the user who flies. Machine code and tables are kept in the user's cache; set
    XDG_CACHE_HOME where the home cannot be written.

    For example:
      sidelong prepare
      XDG_CACHE_HOME=/var/cache/sidelong sidelong prepare mission.toml
    """
    settings = load_config(config, changed_keys(set_))
    check_alone(settings)
    check_flyable(settings)
    begun_s = time.monotonic()
    from sidelong.app.assembly import prepared  # noqa: PLC0415  # a wrong configuration is reported first
    from sidelong.app.planners.value_cache import DIRECTORY  # noqa: PLC0415
    from sidelong.estimators.compiled import FOLDER  # noqa: PLC0415

    prepared(settings, table_progress(say), say)
    took_s = time.monotonic() - begun_s
    say(f"prepared in {took_s:.0f} s; machine code in {FOLDER}, value tables in {DIRECTORY}")
