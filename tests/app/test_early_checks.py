"""Wrong options are reported before anything is connected or computed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from sidelong.app.cli import app, run
from sidelong.app.commands import connect, flying, replay
from sidelong.app.errors import InputError
from sidelong.app.study.prediction import Prediction, Share
from tests.command_line import sidelong


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["launch", "--autopilot", "px4", "--set", "planner.guidance=command"],
            "planner.guidance: PX4 obeys an orbit in any flight",
        ),
        (["launch", "--target", "nope"], "simulation.target: 'nope' is none of still"),
        (["launch", "--target", "none.gpx"], "simulation.target: none.gpx: cannot be read"),
        (["launch", "--route", "none.gpx"], "route.file: none.gpx: cannot be read"),
        (["launch", "--set", "sharing.cot=foo"], "sharing.cot: 'foo' is no address"),
        (["launch", "--set", "sharing.beacon=udp://127.0.0.1:70000"], "sharing.beacon"),
        (
            ["launch", "--fleet", "2", "--set", "sharing.beacon=udp://127.0.0.1:6969"],
            "a beacon is used by one aircraft",
        ),
        (["launch", "--connect", "nope://x"], "'nope://x' is no address; give one like"),
        (["launch", "--connect", "udpin://0.0.0.0:99999"], "with a port from 1 to 65535"),
        (["connect", "tcpout://127.0.0.1:0"], "with a port from 1 to 65535"),
        (["sign", "tests"], "tests is a folder; name the key's file in it, such as tests/plane.key"),
        (["report", "none"], "none: there is no such run folder or log"),
        (["launch", "--connect", "serial:///dev/none:57600"], "there is no device /dev/none"),
        (["launch", "--terrain", "none"], "terrain.folder: none: there is no such folder of elevation data"),
        (["launch", "--set", "link.signing_key_file=none"], "link.signing_key_file: signing key none cannot be read"),
        (["launch", "--side", "up"], "requirement.side: 'up' is none of left, right"),
        (["launch", "--json", "tests"], "tests is a folder; give a file to --json"),
        (["replay", "pyproject.jsonl"], "pyproject.jsonl: there is no such run folder or log"),
        (["replay", "tests"], "tests is no run folder: it has no journal.jsonl; give a run folder or a log"),
        (["replay", "tests/data/arduplane-follow-bike.tlog", "--truth", "pyproject.toml"], "is no truth file"),
        (["export", "tests/data/arduplane-follow-bike.tlog", "--out", "none/x.kml"], "there is no folder none"),
        (["replay", "tests", "--planner", "foo"], "--planner: planner.name = 'foo': input should be"),
        (["replay", "tests/data/arduplane-follow-bike.tlog", "--set", "aircraft.radius_m=15"], "at least 22.95"),
        (["study", "--scheduler", "here"], "--scheduler: 'here' is no address"),
        (["study", "--store", "tests"], "tests is a folder; give a file to --store"),
        (
            ["study", "--set", "simulation.home=[47.4,8.5]"],
            "--set: simulation.home places the study on elevation data",
        ),
        (
            ["study", "--set", "study.legs_s=[20,60]", "--targets", "tests"],
            "study.legs_s: recorded targets move",
        ),
        (["study", "--fleet", "2", "--export", "x.csv"], "--export: --fleet prints a table; give --json instead"),
        (
            ["launch", "--view", "--set", "display.key_file=a.pem"],
            "certificate_file and display.key_file belong together",
        ),
        (
            ["launch", "--set", 'link.take_over_from=["RLT"]'],
            "link.take_over_from: 'RLT' needs no permission or does not exist",
        ),
    ],
)
def test_a_wrong_option_is_reported_at_once(monkeypatch, arguments, sentence):
    late = SimpleNamespace(called=False)

    def computed(*_arguments):
        late.called = True
        raise AssertionError

    monkeypatch.setattr(flying, "prepared", computed)
    monkeypatch.setattr(replay, "prepared", computed)
    ended = CliRunner().invoke(app, arguments)
    assert sentence in str(ended.exception)
    assert not late.called


@pytest.mark.parametrize(
    "option",
    [("--target", "walk"), ("--seed", "2"), ("--autopilot", "px4")],
)
@pytest.mark.parametrize(
    "text", ["[link]\nurl = 'udpin://127.0.0.1:1'", "[[aircraft]]\nname='a'\nurl='udpin://127.0.0.1:1'"]
)
def test_an_option_of_the_simulation_is_refused_where_a_vehicle_would_fly(tmp_path, text, option):
    (tmp_path / "mission.toml").write_text(text)
    ended = CliRunner().invoke(app, ["launch", str(tmp_path / "mission.toml"), *option])
    assert f"{option[0]}: for a simulated vehicle only" in str(ended.exception)


def test_check_refuses_a_link_that_cannot_be_opened(tmp_path):
    (tmp_path / "mission.toml").write_text("[link]\nurl = 'foo://1.2.3.4:5'")
    ended = CliRunner().invoke(app, ["check", str(tmp_path / "mission.toml")])
    assert "link.url: 'foo://1.2.3.4:5' is no address; give one like" in str(ended.exception)


@pytest.mark.parametrize(("is_ready", "code"), [(True, 0), (False, 1)])
def test_connect_ends_with_code_1_if_a_check_fails(monkeypatch, is_ready, code):
    async def reported(*_arguments):
        return {"ready": is_ready, "checks": [{"name": "gimbal source", "ready": is_ready}]}

    monkeypatch.setattr(connect, "_report", reported)
    ended = sidelong("connect", "udpin://127.0.0.1:1")
    assert ended.returncode == code
    assert ("not ready: gimbal source" in ended.stderr) is not is_ready


_AIRCRAFT = '[[aircraft]]\nname = "north"\n[[aircraft]]\nname = "south"\n'
_SMALL = "[[4.0, 8.0], [4.001, 8.0], [4.001, 8.001], [4.0, 8.001]]"  # 110 m
_TLS = '[sharing]\ncot = "tls://127.0.0.1:8089"\n'


@pytest.mark.parametrize("command", ["check", "launch"])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[route]\nfile = "none.gpx"', "route.file: none.gpx: cannot be read"),
        ('[route]\nfile = "."', "route.file: .: cannot be read: it is not a file"),
        ('[route]\nfile = ""', "route.file: .: cannot be read"),
        ('[route]\nfile = "one.csv"', "route.file: one.csv: contains 1 points"),
        (
            '[route]\nfile = "metres.csv"',
            "route.file: metres.csv: is in metres: studies use it, a flight needs degrees",
        ),
        (_AIRCRAFT + '[[target]]\nname = "bike"\nroute = {file = "none.kml"}', "target 'bike': route.file: none.kml"),
        (_AIRCRAFT + '[route]\nfile = "none.gpx"', "route.file: none.gpx: cannot be read"),
        ('[terrain]\nfolder = "none"', "terrain.folder: none: there is no such folder"),
        ('[link]\nsigning_key_file = "none"', "link.signing_key_file: signing key none cannot be read"),
        (_TLS + 'cot_authority_file = "none.pem"', "sharing.cot: none.pem holds no certificates"),
        ('[link]\nsigning_key_file = "\\u0000"', "cannot be read (embedded null byte)"),
        (_TLS + 'cot_authority_file = "\\u0000"', "holds no certificates (embedded null byte)"),
        (_TLS + 'cot_certificate_file = "\\u0000"', "its key cannot be used (embedded null byte)"),
        (_TLS + 'cot_certificate_file = "none.pem"', "sharing.cot: none.pem and its key cannot be used"),
        ('[simulation]\ntarget = "none.gpx"', "simulation.target: none.gpx: cannot be read"),
        (
            "[fences]\nkeep_out = [[[4.0, 8.0], [4.1, 8.1], [4.1, 8.0], [4.0, 8.1]]]",
            "keep_out polygon 1 has sides that",
        ),
        ("[fences]\nkeep_out = [[[4.0, 8.0], [4.0, 8.001], [4.0, 8.002]]]", "keep_out polygon 1 has no area"),
        (
            f"[fences]\nkeep_in = [{_SMALL}]",
            "no circle of aircraft.radius_m = 50 fits into keep_in with margin_m = 20",
        ),
        (_AIRCRAFT + f"[fences]\nkeep_in = [{_SMALL}]", "no circle of aircraft.radius_m = 50 fits into keep_in"),
        (_AIRCRAFT + '[[target]]\nname = "bike"\nmotion = "none.csv"', "target 'bike': motion: none.csv: cannot be"),
    ],
)
def test_a_file_or_fence_that_cannot_be_used_is_reported_by_each_command(tmp_path, monkeypatch, command, text, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.csv").write_text("lat,lon\n47.4,8.5\n47.4,8.5\n")
    (tmp_path / "metres.csv").write_text("east_m,north_m\n0,0\n0,500\n")
    (tmp_path / "mission.toml").write_text(text)
    ended = CliRunner().invoke(app, [command, "mission.toml"])
    assert isinstance(ended.exception, InputError)
    assert words in str(ended.exception)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["metres.csv", "mission.toml", "one.csv"]


@pytest.mark.parametrize("words", [("serve", "--connect", "udpin://127.0.0.1:1"), ("connect", "--config")])
def test_a_named_file_is_opened_before_the_vehicle_is_waited_for(tmp_path, words):
    (tmp_path / "mission.toml").write_text('[route]\nfile = "none.gpx"\n[link]\nurl = "udpin://127.0.0.1:1"')
    ended = CliRunner().invoke(app, [*words, str(tmp_path / "mission.toml")])
    assert isinstance(ended.exception, InputError)
    assert "route.file: none.gpx: cannot be read" in str(ended.exception)


@pytest.mark.parametrize("command", ["check", "launch", "prepare", "connect"])
def test_a_height_above_the_ceiling_is_refused_by_each_command(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mission.toml").write_text('[fences]\nceiling_m = 50\n[link]\nurl = "udpin://127.0.0.1:1"')
    ended = CliRunner().invoke(app, [command, *(["--config"] if command == "connect" else []), "mission.toml"])
    assert "aircraft.height_m = 100 is above fences.ceiling_m = 50" in str(ended.exception)


def test_keys_without_effect_are_noted(tmp_path, monkeypatch):
    found = Prediction(3, Share.of([1.0, 1.0, 1.0]), None)
    monkeypatch.setattr("sidelong.app.commands.check.predict", lambda *_: found)  # tests/app/test_prediction.py flies
    (tmp_path / "mission.toml").write_text("[route]\nlap = true\n[fences]\nceiling_m = 50\n")
    ended = CliRunner().invoke(app, ["check", str(tmp_path / "mission.toml")])
    assert "note: route.lap has no effect without route.file or route.system_id" in ended.output


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["launch", "--speed", "3"], "--speed is a key of the configuration: give --set simulation.speed=VALUE."),
        (["camera", "--stream", "udp://h:1"], "give --set camera.stream=VALUE."),
        (["study", "--home", "47.4,8.5"], "give --set simulation.home=VALUE."),
        (["study", "--target-speed-max", "5"], "give --set requirement.target_speed_max_m_s=VALUE."),
        (["study", "--fidelity", "closed-loop"], "--fidelity: every study flies the closed loop; leave it out."),
        (["launch", "--track", "B"], "--track: write the name of the track behind that of its file, FILE#NAME."),
        (["lanch"], "No such command 'lanch'. Did you mean 'launch'?"),
        (["launch", "--airspeeed", "3"], "No such option: --airspeeed (Possible options: --airspeed"),
        (["export", "run", "--format", "gpxx"], "Invalid value for '--format': 'gpxx' is not one of 'plan'"),
        (["launch", "--duration", "inf"], "Invalid value for '--duration'"),
        (["study", "--duration", "0"], "Invalid value for '--duration'"),
        (["connect", "udpin://127.0.0.1:1", "--listen", "inf"], "Invalid value for '--listen'"),
        (["check", "--radius", "wide"], "'wide' is neither a number of metres nor auto"),
    ],
)
def test_what_is_mistyped_is_named_with_what_there_is(arguments, sentence, capsys):
    assert run(arguments) == 2
    printed = capsys.readouterr().err
    assert sentence in printed
    assert "Value error" not in printed


@pytest.mark.parametrize("number", ["20min", "4,5"])
def test_a_wrong_number_is_one_sentence_with_the_way_out(number, capsys):
    assert run(["launch", "--duration", number]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'--duration': this is not a number; give one without a unit and with a decimal point" in line
    assert line.endswith("see sidelong launch --help.")


def test_help_is_a_command_too(capsys):
    assert run(["help"]) == 0
    assert "Begin with: sidelong launch" in capsys.readouterr().out


def test_too_little_memory_is_a_sentence(monkeypatch, capsys):
    def full(*_arguments):
        raise MemoryError

    monkeypatch.setattr("sidelong.app.cli.app", full)
    assert run(["launch"]) == 1
    assert "not enough memory" in capsys.readouterr().err


def test_a_name_that_is_too_long_is_a_sentence(tmp_path, capsys):
    assert run(["init", str(tmp_path / f"{'a' * 300}.toml")]) == 2
    assert "cannot be written (File name too long)" in capsys.readouterr().err


def test_a_file_next_to_a_journal_is_not_taken_for_it(tmp_path):
    (tmp_path / "journal.jsonl").write_text("the journal")
    (tmp_path / "other.jsonl").write_text("another file")
    ended = CliRunner().invoke(app, ["replay", str(tmp_path / "other.jsonl")])
    assert "other.jsonl is no log" in str(ended.exception)


def test_lengths_below_nothing_are_not_reported_as_lengths(tmp_path, capsys):
    (tmp_path / "mission.toml").write_text("[aircraft]\nradius_m = 300\n[requirement]\nrange_max_m = 200.0\n")
    ended = CliRunner().invoke(app, ["check", "--planner", "paper", str(tmp_path / "mission.toml")])
    assert "infeasible" in str(ended.exception)
    assert "a move of -" not in str(ended.exception)
    announced = capsys.readouterr().out + ended.output
    assert "longest move of the circle" in announced
    assert " -" not in announced
