"""What ``check`` predicts and refuses, and what ``launch`` warns about: the same, of the configured planner."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import stdtrit
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.commands import flying
from sidelong.app.config import Config, unflyable, with_values
from sidelong.app.study import prediction
from sidelong.app.study.prediction import Prediction, Share, predict, t_95
from sidelong.mission.paper.scope import infeasible

X8_AT_400_M = {
    "aircraft": {"airspeed_m_s": 16.0, "radius_m": 50.0},
    "requirement": {"range_max_m": 400.0, "side": "right", "target_speed_max_m_s": 3.0},
}


@pytest.fixture(autouse=True)
def short(monkeypatch, tmp_path):
    monkeypatch.setattr(prediction, "KEPT", tmp_path / "kept.sqlite")
    monkeypatch.setattr(prediction, "FLIGHTS", 3)
    monkeypatch.setattr(prediction, "FLIGHTS_MAX", 6)
    monkeypatch.setattr(prediction, "FLIGHT_S", 200.0)


def written(tmp_path, **sections):
    config = Config.model_validate({**X8_AT_400_M, **sections})
    lines = [
        f"[{name}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in keys.items())
        for name, keys in {**X8_AT_400_M, **sections}.items()
    ]
    path = tmp_path / "mission.toml"
    path.write_text("\n".join(lines))
    return path, config


def test_what_only_the_paper_cannot_fly_is_feasible_for_the_default_planner(tmp_path):
    path, config = written(tmp_path)
    ended = CliRunner().invoke(app, ["check", str(path), "--json", str(tmp_path / "found.json")])
    assert ended.exception is None, ended.exception
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["feasible"]
    assert found["planner"] == "predictive"
    band = found["prediction"]["time_in_band"]
    assert band["low"] <= band["mean"] <= band["high"] <= 1.0
    assert band["mean"] > 0.95
    assert infeasible(config.aircraft.aircraft(), config.requirement.requirement())  # the paper's
    assert not unflyable(config)


@pytest.mark.parametrize(("share", "refused"), [(0.3, True), (0.97, False)])
def test_launch_warns_of_what_check_refuses(tmp_path, monkeypatch, share, refused):
    path, config = written(tmp_path)
    found = Prediction(3, Share.of([share, share + 0.01, share + 0.02]), None)
    monkeypatch.setattr(prediction, "predict", lambda *_, **_flights: found)
    monkeypatch.setattr("sidelong.app.commands.check.predict", lambda *_: found)
    monkeypatch.setattr("sidelong.app.study.study.is_compiled", lambda *_: True)
    ended = CliRunner().invoke(app, ["check", str(path)])
    assert ("widen the band" in str(ended.exception)) is refused
    notes = []
    flying.warn_of_prediction(config, notes.append)
    assert any("sidelong check refuses this configuration" in note for note in notes) is refused


def test_check_states_that_its_flights_have_a_laser_where_the_payload_has_none(tmp_path, monkeypatch):
    share = Share.of([0.97, 0.98, 0.99])
    monkeypatch.setattr("sidelong.app.commands.check.predict", lambda *_: Prediction(3, share, share))
    path = tmp_path / "mission.toml"
    for laser, stated in (("true", False), ("false", True)):
        path.write_text(f"[simulation]\nlaser = {laser}\n[terrain]\nflat = true\n")
        output = CliRunner().invoke(app, ["check", str(path)]).output
        assert ("these flights have a laser" in output) is stated
        assert "feasible" in output


def test_with_figures_of_eight_a_launch_leaves_the_prediction_to_check():
    notes = []
    flying.warn_of_prediction(Config.model_validate({"aircraft": {"pan_limit_deg": 120.0}}), notes.append)
    assert notes == []


def test_a_wind_that_is_not_studied_ends_no_launch(monkeypatch):
    monkeypatch.setattr("sidelong.app.study.study.is_compiled", lambda *_: True)
    notes = []
    flying.warn_of_prediction(Config.model_validate({"simulation": {"wind_speed_m_s": 14.0}}), notes.append)
    assert "a wind of 14 m/s is above 0.7 of the airspeed" in notes[0]


PAPER = Config.model_validate({"planner": {"name": "paper"}})


def test_a_prediction_repeats_itself(monkeypatch, tmp_path):
    first = predict(PAPER)
    monkeypatch.setattr(prediction, "KEPT", tmp_path / "other.sqlite")
    assert predict(PAPER) == first


def flights_flown(monkeypatch, config=PAPER):
    flown, fly = [], prediction.one_flown
    with monkeypatch.context() as patch:
        patch.setattr(prediction, "one_flown", lambda *run: flown.append(run[2]) or fly(*run))
        found = predict(config, flights=2)
    return found, flown


def test_flights_are_flown_again_only_where_something_that_shapes_them_is_another(monkeypatch):
    first, flown = flights_flown(monkeypatch)
    assert flown == [0, 1]
    assert flights_flown(monkeypatch) == (first, [])
    for section, key, value in (("sensors", "range_sigma_m", 3.0), ("requirement", "side", "right")):
        assert flights_flown(monkeypatch, with_values(PAPER, {section: {key: value}}, ""))[1] == [0, 1]
    monkeypatch.setattr("sidelong.app.study.study.code_version", lambda: "other")
    assert flights_flown(monkeypatch)[1] == [0, 1]


def test_flights_of_a_planner_of_another_distribution_are_flown_each_time(monkeypatch):
    monkeypatch.setattr(prediction, "OWN_PLANNERS", ())
    assert flights_flown(monkeypatch)[1] == flights_flown(monkeypatch)[1] == [0, 1]


@pytest.mark.parametrize("damage", ["no database", "a folder", "cut"])
def test_damaged_flights_are_flown_again(monkeypatch, damage):
    first, _ = flights_flown(monkeypatch)
    whole = prediction.KEPT.read_bytes()
    if damage == "a folder":
        prediction.KEPT.unlink()
        prediction.KEPT.mkdir()
    else:
        prediction.KEPT.write_bytes(b"no database" if damage == "no database" else whole[:4096])
    assert flights_flown(monkeypatch) == (first, [0, 1])


def test_the_interval_is_that_of_student_and_stays_within_bounds():
    share = Share.of([0.90, 0.92, 0.94])
    assert share.mean == pytest.approx(0.92)
    assert share.high - share.mean == pytest.approx(4.303 * 0.02 / 3**0.5, rel=1e-3)
    assert share.worst == 0.90
    assert Share.of([0.99, 1.0, 0.91]).high == 1.0
    assert Share.of([float("nan"), 0.5]) is None


def test_the_side_alone_can_be_the_shortcoming():
    low = Prediction(2, Share.of([1.0, 1.0]), Share.of([0.3, 0.31]))
    assert "required side" in low.shortcoming(Config())
    assert Prediction(2, Share.of([1.0, 1.0]), Share.of([0.9, 0.91])).shortcoming(Config()) == ""


def test_the_t_of_student_is_scipys():
    freedoms = np.arange(1, 100)
    assert np.allclose([t_95(one) for one in freedoms], stdtrit(freedoms, 0.975), rtol=0.0, atol=3e-4)


@dataclass
class Flown:
    time_in_band: float
    time_on_side: float = 0.9
    time_within_pan_limits: float = float("nan")


@pytest.mark.parametrize(
    ("shares", "flights", "doubtful"),
    [
        ((0.97, 0.98, 0.99), 3, False),
        ((0.5, 0.51, 0.52), 3, False),
        ((0.88, 0.9, 0.92, 0.97, 0.98, 0.99, 0.97, 0.98, 0.99), 9, False),
        ((0.88, 0.9, 0.92), 12, True),
    ],
)
def test_more_flights_are_flown_while_the_verdict_is_in_doubt(monkeypatch, shares, flights, doubtful):
    monkeypatch.setattr(prediction, "FLIGHTS_MAX", 12)
    found = prediction.prediction_of(lambda number: Flown(shares[number % len(shares)]))
    assert (found.flights, found.as_json()["in_doubt"]) == (flights, doubtful)


def test_the_time_within_pan_limits_is_predicted_where_there_are_any():
    assert prediction.prediction_of(lambda _number: Flown(0.97)).as_json()["time_within_pan_limits"] is None
    limited = prediction.prediction_of(lambda _number: Flown(0.97, 0.9, 0.95))
    assert limited.as_json()["time_within_pan_limits"]["mean"] == pytest.approx(0.95)


def test_what_is_refused_by_one_share_is_not_in_doubt_by_another():
    assert Prediction(3, Share.of([0.9, 0.92, 0.88]), Share.of([0.2, 0.21, 0.22])).doubt() == ""


def test_a_doubtful_verdict_is_said_and_not_refused(tmp_path, monkeypatch):
    path, config = written(tmp_path)
    found = Prediction(3, Share.of([0.88, 0.9, 0.92]), None)
    monkeypatch.setattr(prediction, "predict", lambda *_, **_flights: found)
    monkeypatch.setattr("sidelong.app.commands.check.predict", lambda *_: found)
    monkeypatch.setattr("sidelong.app.study.study.is_compiled", lambda *_: True)
    ended = CliRunner().invoke(app, ["check", str(path)])
    assert ended.exit_code == 0
    assert "close to the limit: the time in band is near the 90 %" in ended.output
    notes = []
    flying.warn_of_prediction(config, notes.append)
    assert not notes  # four flights give no verdict
