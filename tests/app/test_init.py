"""The configuration file to begin with loads back as what it reports."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import pytest

from sidelong.app.commands.init import PAYLOAD_PRESETS, PRESETS, config_text, init
from sidelong.app.config import Config, check_flyable, load_config
from sidelong.app.errors import InputError
from sidelong.app.flight.shell import SimulatedVehicles
from sidelong.mission.core.requirement import GRAVITY_M_S2


def test_the_file_holds_exactly_the_defaults(tmp_path):
    init(tmp_path / "mission.toml")
    assert load_config(tmp_path / "mission.toml") == Config()


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_loads_back_and_is_flyable_by_both_planners(name, tmp_path):
    file = tmp_path / "mission.toml"
    init(file, preset=name)
    config, preset = load_config(file), PRESETS[name]
    for section, values in preset.values.items():
        assert {key: getattr(getattr(config, section), key) for key in values} == values
    assert preset.about in file.read_text(encoding="utf-8")
    for planner in ("predictive", "paper"):
        check_flyable(load_config(file, {"planner": {"name": planner}}))
    assert config.aircraft.aircraft().min_radius_m <= config.aircraft.radius_m


def test_an_airframe_and_a_payload_with_pan_limits_share_a_section(tmp_path):
    file = tmp_path / "one.toml"
    init(file, preset="px4-sih,siyi-a8-mini")
    aircraft = load_config(file).aircraft
    assert (aircraft.airspeed_m_s, aircraft.pan_limit_deg) == (15.5, 135.0)


@pytest.mark.parametrize("preset", PRESETS.values(), ids=str)
def test_a_preset_leaves_bank_for_corrections(preset):
    """Its circle is flown at least five degrees below the airframe's bank limit."""

    own = preset.values["aircraft"]
    bank_deg = math.degrees(math.atan(own["airspeed_m_s"] ** 2 / (GRAVITY_M_S2 * own["radius_m"])))
    assert bank_deg <= own["bank_max_deg"] - 5.0


def test_every_key_is_there_with_its_comment():
    text = config_text()
    for section, about in Config.model_fields.items():
        assert f"[{section}]" in text
        for key in about.annotation.model_fields:
            assert re.search(rf"^(?:# .*\n)+(?:# )?{key} = .+$", text, re.M), key


def test_keys_that_are_not_set_become_valid_by_taking_the_mark_off(tmp_path):
    file = tmp_path / "mission.toml"
    uncommented = re.sub(r"^# (\w+ = )", r"\1", config_text(), flags=re.M)
    file.write_text(uncommented, encoding="utf-8")
    config = load_config(file)
    assert config.link.url == "udpin://0.0.0.0:14540"
    assert len(config.fences.keep_in[0]) == 4
    assert config.sensors.range_component == 154


def test_limits_and_choices_are_written():
    text = config_text()
    radius = "# Radius of the circle next to the target, m;"
    assert "At least 10, at most 2000. radius_m = 50.0" in " ".join(
        text[text.index(radius) :].replace("# ", "").split()
    )
    assert 'One of "predictive", "paper".' in " ".join(text.replace("# ", "").split())


def test_a_file_that_is_there_is_kept(tmp_path):
    file = tmp_path / "mission.toml"
    file.write_text("[aircraft]\n", encoding="utf-8")
    with pytest.raises(InputError, match="--force"):
        init(file)
    assert file.read_text(encoding="utf-8") == "[aircraft]\n"
    init(file, force=True)
    assert tomllib.loads(file.read_text(encoding="utf-8"))["aircraft"]["radius_m"] == 50.0


@pytest.mark.parametrize("name", PAYLOAD_PRESETS)
def test_a_payload_preset_loads_back_alone_and_with_an_airframe(name, tmp_path):
    for number, names in enumerate((name, f"skywalker-x8,{name}")):
        file = tmp_path / f"{number}.toml"
        init(file, preset=names)
        config, preset = load_config(file), PAYLOAD_PRESETS[name]
        payload = preset.values["payload"]
        assert (config.payload.kind, config.payload.url) == (payload["kind"], payload["url"])
        assert (config.aircraft.airspeed_m_s == 16.0) == (number == 1)
        assert config.terrain.flat is ("terrain" in preset.values)  # a range has to come from somewhere


@pytest.mark.parametrize(
    ("preset", "fleet", "reason"),
    [
        ("siyi-zt30,gremsy-vio", None, "more than one payload"),
        ("skywalker-x8,3dr-aero", None, "more than one airframe"),
        ("siyi-zt30", 2, "fleet"),
    ],
)
def test_presets_that_do_not_go_together_are_refused(preset, fleet, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        init(tmp_path / "mission.toml", preset=preset, fleet=fleet)


def test_an_unknown_preset_names_those_there_are(tmp_path):
    with pytest.raises(InputError, match="skywalker-x8"):
        init(tmp_path / "mission.toml", preset="concorde")
    assert not (tmp_path / "mission.toml").exists()


def test_a_folder_in_place_of_the_file_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"is a folder; give a file to init\.$"):
        init(tmp_path)


def test_a_folder_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"there is no folder .*no; create it or give another file to init\.$"):
        init(Path(tmp_path / "no" / "mission.toml"))


@pytest.mark.parametrize("name", PAYLOAD_PRESETS)
def test_the_simulated_payload_has_a_laser_as_the_preset_has(name, tmp_path):
    file = tmp_path / "mission.toml"
    file.write_text(config_text(name))
    simulated = SimulatedVehicles([load_config(file)], [], pytest.fail)
    (vehicle,) = simulated.settings.vehicles
    assert (vehicle.payload.dropout_fraction == 1.0) is ("terrain" in PAYLOAD_PRESETS[name].values)
