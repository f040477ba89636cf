"""Logs of others with and without a target, exported, and read by the programs that people open them with."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.commands.export import write_export
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.flight.recording import Recording
from sidelong.app.records.export import Format
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.report.history import feed
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ControlAcquired

DATA = Path(__file__).parents[1] / "data"
NO_LASER = DATA / "no-laser-vtol.tlog"
TRACKS = (Format.KML, Format.GPX, Format.GEOJSON)


def run(*words: object) -> str:
    return subprocess.run([*map(str, words)], check=True, capture_output=True, text=True, timeout=60).stdout


@pytest.mark.parametrize("wanted", [*TRACKS, Format.CSV, Format.MCAP, Format.KLV])
def test_a_log_without_a_laser_has_the_aircrafts_track(tmp_path, wanted):
    write_export(NO_LASER, wanted, tmp_path / "out")
    assert (tmp_path / "out").stat().st_size > 1000
    if wanted is Format.GEOJSON:
        (aircraft,) = json.loads((tmp_path / "out").read_text())["features"]
        assert len(aircraft["geometry"]["coordinates"]) > 20


def test_its_mission_is_not_there_to_export(tmp_path):
    with pytest.raises(InputError, match="no mission items"):
        write_export(NO_LASER, Format.PLAN, tmp_path / "out")


def test_a_place_that_cannot_be_written_is_an_input_error_that_names_it(tmp_path):
    out = tmp_path / "missing" / "out"
    with pytest.raises(InputError, match=f"^{re.escape(str(out))}: cannot be written"):
        write_export(NO_LASER, Format.CSV, out)


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL's programs are not installed")
@pytest.mark.parametrize("wanted", TRACKS)
def test_gdal_reads_it(tmp_path, wanted):
    write_export(NO_LASER, wanted, tmp_path / f"out.{wanted}")
    assert "LINESTRING" in run("ogrinfo", "-al", tmp_path / f"out.{wanted}").upper().replace(" ", "")


@pytest.mark.skipif(shutil.which("gpsbabel") is None, reason="gpsbabel is not installed")
@pytest.mark.parametrize("wanted", [Format.GPX, Format.KML])
def test_gpsbabel_reads_it(tmp_path, wanted):
    write_export(NO_LASER, wanted, tmp_path / "out")
    rows = run("gpsbabel", "-t", "-i", wanted, "-f", tmp_path / "out", "-o", "unicsv", "-F", "-").splitlines()
    assert len(rows) > 20
    assert rows[1].split(",")[1].startswith("-35.36")


def test_an_export_that_is_broken_off_leaves_the_file_from_earlier(tmp_path, monkeypatch):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"before")

    def broken_off(_source, log, *_progress):
        feed(NO_LASER, log)
        raise KeyboardInterrupt

    monkeypatch.setattr("sidelong.app.commands.export.feed", broken_off)
    with pytest.raises(KeyboardInterrupt):
        write_export(NO_LASER, Format.MCAP, out)
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("out.mcap", b"before")]


@pytest.mark.parametrize("wanted", list(Format))
@pytest.mark.parametrize(("east_m", "radius_m"), [(math.nan, 80.0), (0.0, 1e308)])
def test_a_journal_with_values_that_no_flight_has_ends_in_a_sentence(tmp_path, wanted, east_m, radius_m):
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 28, tzinfo=UTC))
    with closing(Recording(folder, Config(), print)) as recording:
        recording.begin(LocalPlane(47.4, 8.5), (47.4, 8.5), "ArduPlane", 400.0)
        for second in range(20):
            recording.write(PositionReading(10.0 + second, 10.0 * second, 0.0, 100.0, 10.0, 0.0, 0.0))
            if second == 3:
                circle = Circle(east_m, 0.0, radius_m, clockwise=True)
                recording.write(ControlAcquired(13.0, circle, "AUTO"))
    folder.tlog.unlink()
    ended = CliRunner().invoke(app, ["export", str(folder.path), "--format", wanted])
    assert ended.exception is None or isinstance(ended.exception, InputError)
