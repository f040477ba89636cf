"""The configuration file: what is accepted, and that a complaint names the field and the way out."""

from __future__ import annotations

import pytest

from app.config import check_flyable, load_config
from app.errors import InputError
from mission.core.requirement import Side


def write(tmp_path, text: str):
    path = tmp_path / "mission.toml"
    path.write_text(text)
    return path


def test_the_defaults_are_flyable():
    check_flyable(load_config(None))


def test_the_command_line_wins_over_the_file_and_none_says_nothing(tmp_path):
    path = write(tmp_path, '[requirement]\nside = "left"\nrange_min_m = 120\n[aircraft]\nradius_m = 70\n')
    config = load_config(path, {"requirement": {"side": "right", "range_min_m": None}, "simulation": {"seed": 4}})
    assert config.requirement.requirement().side is Side.RIGHT
    assert config.requirement.range_min_m == 120
    assert config.aircraft.radius_m == 70
    assert config.simulation.seed == 4


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[aircraft]\nradius = 60\n", ["aircraft.radius", "radius_m"]),
        ("[plane]\nx = 1\n", ["plane", "aircraft"]),
        ("[aircraft]\nradius_m = 'wide'\n", ["aircraft.radius_m", "wide"]),
        ("[aircraft]\nradius_m = -5\n", ["aircraft.radius_m", "10"]),
        ("[requirement]\nside = 'above'\n", ["requirement.side", "left", "right"]),
        ("aircraft = 3\n", ["aircraft"]),
        ("[aircraft\n", ["TOML"]),
    ],
)
def test_a_wrong_file_is_one_sentence_that_names_the_field(tmp_path, text, named):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    for part in ["mission.toml", *named]:
        assert part in message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        load_config(tmp_path / "none.toml")


def test_a_circle_tighter_than_the_aircraft_flies_is_refused():
    config = load_config(None, {"aircraft": {"radius_m": 15.0, "airspeed_m_s": 22.0}})
    with pytest.raises(InputError, match="radius"):
        check_flyable(config)


def test_a_band_too_narrow_for_the_circle_is_refused():
    config = load_config(None, {"requirement": {"range_max_m": 150.0}})
    with pytest.raises(InputError, match="infeasible"):
        check_flyable(config)
