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
        ("--target-start", "here"),
        ("--target-speed", "-1"),
        ("--home", "91,0"),
        ("--home", "47"),
        ("--loss", "1.5"),
        ("--delay-ms", "-1"),
        ("--dropouts", "2"),
        ("--truth", "/nowhere/truth.csv"),
        ("--payload-for", "somewhere"),
        ("--payload-for", "udpin://127.0.0.1:99999"),
        ("--binary", "/nowhere/px4"),
        ("--logs", "somewhere"),
        ("--autopilot", "betaflight"),
        ("--system-id", "0"),
        ("--vehicles", "0"),
        ("--vehicles", "1", "--autopilot", "px4,arduplane"),
        ("--vehicles", "2", "--payload-for", "udpin://127.0.0.1:1"),
        ("--airspeed", "15,1"),
        ("--endurance", "0"),
        ("--to", "2@127.0.0.1:14540"),
        ("--lose", "2@10"),
        ("--lose", "1"),
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
