"""``sidelong report``: a flight as one self-contained page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from sidelong.app.analysis.truth import read_truth
from sidelong.app.commands.options import ConfigOption, TruthOption
from sidelong.app.commands.output import checked_file, say, share_progress, warn_of_log, writing
from sidelong.app.errors import InputError
from sidelong.app.records.run_folder import FleetFolder, recording
from sidelong.app.records.text_file import write_text


def report(
    run: Annotated[Path, typer.Argument(help="A run folder, or a recorded tlog.")],
    out: Annotated[Path | None, typer.Option("--out", help="The page [in the run folder, or by the log].")] = None,
    truth: TruthOption = None,
    config: ConfigOption = None,
) -> None:
    """Write one HTML file about a flight: paths, range, angles, errors, uploads, decisions. It opens offline.

    Of a fleet's run folder: one about all aircraft, and one about each in its own folder.

    For example:
      sidelong report runs/20261121T101500Z
      sidelong report flight.tlog --truth flight.truth.csv
    """
    run = recording(run)
    if out is None:
        out = run / "report.html" if run.is_dir() else run.with_suffix(".report.html")
    if truth is not None:
        read_truth(truth)  # report a wrong file before any computation
    write_report(run, out, truth, config)


def write_report(run: Path, out: Path, truth: Path | None = None, config: Path | None = None) -> None:
    """Write the page; of a fleet's run a page about each aircraft too."""
    checked_file("--out", out)
    if not os.access(out if out.exists() else out.parent, os.W_OK):
        raise InputError(f"{out}: cannot be written; give another file to --out.")
    if FleetFolder(run).journal.is_file():
        if truth is not None or config is not None:
            raise InputError(
                f"{run} is the run of a fleet: --truth and --config are for the folder of one aircraft in it."
            )
        _write_fleet(FleetFolder(run), out)
        return
    from sidelong.app.report.history import read_flight  # noqa: PLC0415
    from sidelong.app.report.page import report_page  # noqa: PLC0415  # which takes half a second to load

    with share_progress(f"reading {run.name}") as progress:
        flown = read_flight(run, truth, config, progress, warn=lambda words: warn_of_log(run, words))
    _write(out, report_page(flown))


def _write_fleet(folder: FleetFolder, out: Path) -> None:
    from sidelong.app.fleet.flown import fleet_page, read_fleet  # noqa: PLC0415
    from sidelong.app.report.page import report_page  # noqa: PLC0415

    with share_progress(f"reading {folder.path.name}") as progress:
        flown = read_fleet(folder, progress)
    pages = {craft.name: folder.path / craft.name / "report.html" for craft in flown.aircraft}
    for craft in flown.aircraft:
        _write(pages[craft.name], report_page(craft.flown))
    links = {name: os.path.relpath(page, out.parent) for name, page in pages.items()}
    _write(out, fleet_page(flown, links))


def _write(out: Path, page: str) -> None:
    with writing(out, "--out"):
        write_text(out, page)
    say(f"report: {out} ({out.stat().st_size / 1e6:.1f} MB)")
