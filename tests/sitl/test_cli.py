"""The command line: what it refuses, and in which words."""

import os

import pytest
import typer
from typer.testing import CliRunner

from sidelong.sitl.cli import run


@pytest.fixture
def invoke():
    command = typer.Typer()
    command.command()(run)
    runner = CliRunner()
    return lambda *arguments: runner.invoke(command, list(arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("--to", "nowhere"),
        ("--to", "127.0.0.1:99999"),
        ("--speed", "0"),
        ("--speed", "nan"),
        ("--duration", "-1"),
        ("--airspeed", "1"),
        ("--wind-speed", "20"),
        ("--target", "teleport"),
        ("--target", "/nowhere/track.gpx"),
        ("--set", "targets.start_m=here"),
        ("--target-speed", "-1"),
        ("--home", "91,0"),
        ("--home", "47"),
        ("--set", "link.loss=1.5"),
        ("--set", "link.delay_s=-1"),
        ("--set", "payload.dropout_fraction=2"),
        ("--truth", "/nowhere/truth.csv"),
        ("--payload-for", "somewhere"),
        ("--payload-for", "udpin://127.0.0.1:99999"),
        ("--binary", "/nowhere/px4"),
        ("--set", "nothing=1"),
        ("--set", "speed"),
        ("--set", "3.seed=1"),
        ("--set", "targets.2.name=boat"),
        ("--set", "targets=boat.csv"),
        ("--set", "seed.more=1"),
        ("--set", "looks_at=1"),
        ("--set", "device=laser@127.0.0.1:5"),
        ("--set", "signing_key_file=/nowhere/key"),
        ("--set", "release=3.9"),
        ("--set", "release=4.x"),
        ("--settings", "/nowhere/settings.json"),
        ("--autopilot", "betaflight"),
        ("--set", "system_id=0"),
        ("--vehicles", "0"),
        ("--vehicles", "1", "--autopilot", "px4,arduplane"),
        ("--vehicles", "2", "--payload-for", "udpin://127.0.0.1:1"),
        ("--airspeed", "15,1"),
        ("--set", "2.airspeed_m_s=1"),
        ("--set", "endurance_s=0"),
        ("--set", "2.stations=[]"),
        ("--set", "lost_s=soon"),
        ("--truth", "a.csv", "--truth", "b.csv"),
    ],
)
def test_a_wrong_option_is_named_in_one_sentence(invoke, arguments):
    result = invoke(*arguments)
    assert result.exit_code == 2
    own, of_typer = f"sidelong: {arguments[0]} ", f"Invalid value for '{arguments[0]}'"
    assert own in result.output or of_typer in result.output
    assert "Traceback" not in result.output
    assert "ready" not in result.output


def test_a_pipe_that_no_program_reads_is_refused(invoke, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    result = invoke("--truth", str(tmp_path / "pipe"), "--duration", "1")
    assert result.exit_code == 2
    assert "pipe cannot be written: No such device or address" in " ".join(result.output.split())


def test_help_has_an_example(invoke):
    result = invoke("--help")
    assert result.exit_code == 0
    assert "sidelong sitl --autopilot px4" in " ".join(result.output.replace("│", " ").split())
