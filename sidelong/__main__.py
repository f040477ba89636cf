"""``python -m sidelong`` is the command line."""

from sidelong.app.__main__ import main

main()
