"""A recorded flight is flown on with other values and compared with what was flown."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.assembly import prepared
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.cli import run
from sidelong.app.study.closed_loop import FlownOn
from sidelong.app.study.recorded import RecordedTarget
from sidelong.mission.core.events import HealthChanged
from sidelong.mission.core.inputs import Input
from sidelong.mission.core.requirement import Wind
from tests.app.conftest import PLANE

DURATION_S = 240.0


@pytest.fixture(scope="module")
def flown(run_of_autopilot):
    return run_of_autopilot


def what_if(flown, tmp_path, *options):
    out = tmp_path / "summary.json"
    assert run(["replay", str(flown), "--quiet", "--json", str(out), *options]) == 0
    return json.loads(out.read_text())


def test_with_the_same_values_the_flight_comes_to_the_same(flown, tmp_path, capsys):
    both = what_if(flown, tmp_path, "--what-if", "requirement.side=left")
    assert both["what_if"]["time_on_side"] == pytest.approx(both["flown"]["time_on_side"], abs=0.03)
    assert both["what_if"]["time_in_band"] == pytest.approx(both["flown"]["time_in_band"], abs=0.03)
    assert both["what_if"]["duration_s"] == pytest.approx(both["flown"]["duration_s"], abs=5.0)
    assert "as flown" in capsys.readouterr().out


def test_another_value_is_flown_from_a_moment_on(flown, tmp_path):
    both = what_if(flown, tmp_path, "--what-if", "requirement.side=right", "--from", "60")
    assert both["what_if"]["duration_s"] == pytest.approx(DURATION_S - 60.0, abs=15.0)
    assert both["what_if"]["moves"] >= 1  # it goes to the other side, and does not stay on the flown path
    assert both["what_if"]["max_range_m"] < 700.0


def test_an_aircraft_that_still_climbs_is_flown_on_to_the_height_of_its_circle(config, flight):
    *_, (_, _, controller) = flight(60.0)
    begin, still = replace(controller.snapshot(), height_m=75.0), np.zeros(120)
    core, (autopilot, *_) = prepared(config).controller(), AUTOPILOTS
    flown_on = FlownOn(config, core, autopilot, PLANE, 0.0, begin, Wind(), RecordedTarget("still", still, still), 0.0)
    changes = [one for step in flown_on.steps() for one in step.commands if isinstance(one, HealthChanged)]
    assert [one for one in changes if one.input is Input.HEIGHT] == []
    assert core.snapshot().height_m == pytest.approx(config.aircraft.height_m, abs=3.0)


def test_a_replay_that_decides_otherwise_judges_the_path_as_it_was_flown(flown, tmp_path):
    shares = []
    for side in ("left", "right"):
        out = tmp_path / f"{side}.json"
        assert run(["replay", str(flown), "--quiet", "--json", str(out), "--set", f"requirement.side={side}"]) == 0
        shares.append(json.loads(out.read_text())["time_in_band"])
    assert shares[0] == pytest.approx(shares[1])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--what-if", "requirement.side=right", "--from", "900"], "--from 900: the recorded watch is shorter"),
        (["--what-if", "requirement.side=right", "--verify"], "give it without --view and --what-if"),
        (["--what-if", "requirement.colour=red"], "requirement.colour"),
    ],
)
def test_what_cannot_be_flown_is_a_sentence(flown, capsys, options, sentence):
    assert run(["replay", str(flown), "--quiet", *options]) == 2
    assert sentence in capsys.readouterr().err
