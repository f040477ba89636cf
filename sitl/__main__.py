"""``python -m sitl``."""

import typer

from sidelong.sitl.cli import run

if __name__ == "__main__":
    typer.run(run)
