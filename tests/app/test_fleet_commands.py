"""The commands around a flight, given a fleet file."""

from __future__ import annotations

import json
import tomllib

import pytest

from sidelong.app.cli import load_command
from sidelong.app.commands.init import config_text
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import LAYER_M, FleetFile, load_fleet
from sidelong.app.study.prediction import Prediction, Share

TWO = '[[aircraft]]\nname = "north"\n[[aircraft]]\nname = "south"\n'


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return what runs a command next to ``fleet.toml`` and returns what it prints; what it raises comes through."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet.toml").write_text(TWO, encoding="utf-8")
    (tmp_path / "alone.toml").write_text("requirement.fleet_size = 2\n", encoding="utf-8")

    def invoked(name, *arguments):
        load_command(name).main([str(one) for one in arguments], standalone_mode=False)
        return capsys.readouterr().out

    return invoked


@pytest.mark.parametrize("preset", [None, "skywalker-x8"])
def test_init_writes_a_fleet_file_that_explains_every_key(run, tmp_path, preset):
    run("init", "new.toml", "--fleet", 3, *(("--preset", preset) if preset else ()))
    fleet = load_fleet(tmp_path / "new.toml")
    heights_m = [member.config.aircraft.height_m for member in fleet.members]
    assert heights_m == [100.0, 100.0 + LAYER_M, 100.0 + 2.0 * LAYER_M]
    assert len({member.config.aircraft.airspeed_m_s for member in fleet.members}) == 1
    uncommented = "\n".join(line.removeprefix("# ") for line in config_text(preset, 3).splitlines())
    for key in ("url", "urls", "system_id", "autopilot", "motion", "side"):
        assert f"\n{key} = " in uncommented


def test_init_without_a_fleet_is_as_it_was():
    assert "aircraft" in tomllib.loads(config_text())
    assert isinstance(tomllib.loads(config_text())["aircraft"], dict)
    FleetFile.model_validate(tomllib.loads(config_text(None, 2)))


def test_check_looks_at_every_aircraft(run, tmp_path, monkeypatch):
    found = Prediction(2, Share.of([1.0, 1.0]), None)
    monkeypatch.setattr("sidelong.app.commands.check.predict", lambda *_: found)  # tests/app/test_prediction.py flies
    announced = run("check", "fleet.toml", "--json", "found.json")
    assert "north, at 100 m:" in announced
    assert "south, at 160 m:" in announced
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["feasible"]
    assert [one["name"] for one in found["aircraft"]] == ["north", "south"]


def test_check_names_the_aircraft_that_cannot(run, tmp_path, monkeypatch):
    (tmp_path / "fleet.toml").write_text(TWO + "airspeed_m_s = 30\nradius_m = 120\nroll_rate_max_deg_s = 60\n")

    def predicted(config, _progress):
        share = 0.3 if config.aircraft.airspeed_m_s == 30.0 else 1.0
        return Prediction(2, Share.of([share, share]), None)

    monkeypatch.setattr("sidelong.app.commands.check.predict", predicted)
    with pytest.raises(InputError, match=r"^infeasible: south: ") as refused:
        run("check", "fleet.toml")
    assert "north: " not in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "announced"),
    [
        (("connect", "--config", "fleet.toml"), "no vehicle is named"),
        (("connect", "udpin://127.0.0.1:1", "--config", "fleet.toml"), "leave out the URL"),
        (("connect",), "no vehicle is named"),
        (("launch", "fleet.toml", "--set", "link.system_id=1"), "link.system_id names one vehicle"),
        (("launch", "fleet.toml", "--fleet", 3), "leave out --fleet 3"),
        (("launch", "fleet.toml", "--connect", "udpin://127.0.0.1:1"), "give its system_id"),
        (("launch", "--fleet", 2, "--side", "either"), "share the sides"),
        (("launch", "alone.toml"), "leave it out, or give a fleet file"),
        (("check", "alone.toml"), "leave it out, or give a fleet file"),
        (("connect", "udpin://127.0.0.1:1", "--config", "alone.toml"), "leave it out, or give a fleet file"),
        (("prepare", "alone.toml"), "leave it out, or give a fleet file"),
        (("launch", "--fleet", 2, "--autopilot", "px4,betaflight"), "aircraft.1.autopilot"),
    ],
    ids=lambda part: " ".join(map(str, part)) if isinstance(part, tuple) else "",
)
def test_what_does_not_go_with_a_fleet_is_refused_before_anything_is_begun(run, tmp_path, arguments, announced):
    with pytest.raises(InputError, match=announced):
        run(*arguments)
    assert not (tmp_path / "runs").exists()
