"""Where the program begins. Until the command line is loaded, which takes a moment, a signal ends it at once."""

from __future__ import annotations

import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
            signal.signal(number, _leave)
    from sidelong.app.process import prefer_installed_packages  # noqa: PLC0415  # after the signals

    prefer_installed_packages()
    from sidelong.app.process import open_standard_streams  # noqa: PLC0415  # after the search path

    open_standard_streams()
    from sidelong.app.cli import main as run  # noqa: PLC0415  # likewise

    run()


def _leave(_number: int, _frame: object) -> NoReturn:
    os.write(2, b"sidelong: interrupted.\n")
    os._exit(130)


if __name__ == "__main__":
    main()
