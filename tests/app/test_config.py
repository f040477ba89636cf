"""The configuration file: what is accepted, and that a complaint names the field and the way out."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sidelong.app.config import check_flyable, load_config, reach_warning, room_warning, setting_notes
from sidelong.app.errors import InputError
from sidelong.app.flight.recording import journalled_config
from sidelong.mission.core.requirement import Side


def write(tmp_path, content: str | bytes):
    path = tmp_path / "mission.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_the_defaults_are_flyable():
    check_flyable(load_config(None))


def test_the_command_line_wins_over_the_file_and_none_reports_nothing(tmp_path):
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
        ("aircraft = 3\n", ["aircraft = 3", "write [aircraft]"]),
        ("[aircraft\n", ["TOML"]),
        ("[sensors]\nfilter = 'ukf'\n", ["sensors.filter", "imm", "ekf"]),
        ("[sensors]\nlever_arm_m = [nan, 0, 0]\n", ["sensors.lever_arm_m.0", "nan", "finite"]),
        ("[sensors]\nmount_deg = [0, inf, 0]\n", ["sensors.mount_deg.1", "inf", "finite"]),
        ("[fences]\nfloor_m = 200\nceiling_m = 100\n", ["fences", "floor_m", "ceiling_m", "change"]),
        ("[simulation]\nwind_speed_m_s = 20\n", ["simulation.wind_speed_m_s", "20", "aircraft.airspeed_m_s = 15"]),
        ("[planner]\nwinds_m_s = [5, 15]\n", ["planner.winds_m_s", "15", "aircraft.airspeed_m_s"]),
        ("[requirement]\nrange_min_m = 300\nrange_max_m = 300\n", ["requirement", "range_min_m", "range_max_m"]),
        (
            "[fences]\nkeep_in = [[47.4, 8.5], [47.4, 8.6], [47.5, 8.6]]\n",
            ["fences.keep_in.0.0 = 47.4: input should be"],
        ),
        (f"[fences]\nkeep_in = [{'[[1, 2], [3, 4]], ' * 9000}]\n", ["fences.keep_in", "at most 100"]),
        ("a = " + "[" * 20_000, ["nested"]),
        ("a = " + "1" * 5000, ["TOML", "4300 digits"]),
        ("# long\n" * 50_000, ["longer than 256 KiB"]),
        (bytes(range(256)), ["UTF-8", "sidelong init"]),
        (f"[aircraft]\nradius_m = '{'b' * 9000}'\n", ["aircraft.radius_m", "bbb..."]),
        (f"[requirement]\nside = '{'9' * 9000}-1'\n", ["requirement.side", "999..."]),
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


def test_a_journal_of_a_removed_filter_is_one_sentence_with_the_way_out():
    header = SimpleNamespace(config={"sensors": {"filter": "ukf"}})
    with pytest.raises(InputError, match=r"a\.jsonl: .*--config: sensors\.filter = 'ukf': .*'imm' or 'ekf'\.$"):
        journalled_config(SimpleNamespace(header=header, path="a.jsonl"))


@pytest.mark.parametrize("name", [".", "no\0name"])
def test_what_is_no_file_is_named(tmp_path, name):
    with pytest.raises(InputError, match="sidelong init"):
        load_config(tmp_path / name)


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


@pytest.mark.parametrize(
    ("aircraft", "requirement", "radius_m"),
    [
        ({"airspeed_m_s": 12}, {}, 42),
        ({"airspeed_m_s": 30}, {}, 105),
        ({"airspeed_m_s": 25, "bank_max_deg": 30}, {}, 122),
        ({"airspeed_m_s": 40}, {"range_max_m": 900}, 180),  # the bank limit leaves no less
        ({"airspeed_m_s": 15}, {"range_max_m": 250}, 39),  # the room in the band
    ],
)
def test_a_radius_that_fits_is_found(tmp_path, aircraft, requirement, radius_m):
    lines = ["[aircraft]", 'radius_m = "auto"', *(f"{k} = {v}" for k, v in aircraft.items()), "[requirement]"]
    config = load_config(write(tmp_path, "\n".join(lines + [f"{k} = {v}" for k, v in requirement.items()])))
    assert config.aircraft.radius_m == pytest.approx(radius_m, abs=1)
    check_flyable(config)
    assert config.model_dump()["aircraft"]["radius_m"] == config.aircraft.radius_m


def test_a_band_beyond_the_laser_s_message_is_warned_of():
    far = {"requirement": {"range_max_m": 750.0}}
    assert reach_warning(load_config(None)) is None
    assert "make requirement.range_max_m 647 m at most" in reach_warning(load_config(None, far))
    assert reach_warning(load_config(None, {**far, "payload": {"kind": "siyi"}})) is None


@pytest.mark.parametrize(
    ("height_m", "far_m", "advice"),
    [
        (450.0, 500.0, "make requirement.range_max_m 476 m at most"),
        (640.0, 500.0, "make aircraft.height_m 423 m at most"),  # the circle does not fit into the reach of 141 m
        (1000.0, 500.0, "make aircraft.height_m 423 m at most"),
        (1000.0, 700.0, "lower both"),
    ],
)
def test_a_height_beyond_the_reach_of_the_laser_is_named_with_one_that_works(height_m, far_m, advice):
    values = {"aircraft": {"height_m": height_m}, "requirement": {"range_max_m": far_m}}
    assert f"; {advice}, unless the laser sends RANGEFINDER" in reach_warning(load_config(None, values))


def test_the_advised_height_and_range_are_not_warned_of():
    assert reach_warning(load_config(None, {"aircraft": {"height_m": 423.0}})) is None
    assert reach_warning(load_config(None, {"requirement": {"range_max_m": 647.0}})) is None


@pytest.mark.parametrize(
    ("height_m", "sentence"),
    [
        (100.0, r"aircraft\.height_m = 100 is above fences\.ceiling_m = 50; change one\.$"),
        (20.0, r"aircraft\.height_m = 20 is below fences\.floor_m = 30; change one\.$"),
    ],
)
def test_a_height_outside_its_own_fences_is_refused(height_m, sentence):
    values = {"aircraft": {"height_m": height_m}, "fences": {"floor_m": 30.0, "ceiling_m": 50.0}}
    with pytest.raises(InputError, match=sentence):
        check_flyable(load_config(None, values))
    above_ground = {"aircraft": {"height_m": height_m, "height_above": "ground"}, "terrain": {"folder": "dem"}}
    check_flyable(load_config(None, values | above_ground))


@pytest.mark.parametrize(
    ("values", "notes"),
    [
        ({}, []),
        ({"payload": {"kind": "siyi", "flip_yaw": True}}, []),
        (
            {"payload": {"url": "udp://127.0.0.1:1", "range_unit_m": 0.1}},
            [f'payload.{key} has no effect while payload.kind is "mavlink"' for key in ("url", "range_unit_m")],
        ),
        (
            {"route": {"lap": True, "speed_m_s": 2.0}},
            [f"route.{key} has no effect without route.file or route.system_id" for key in ("lap", "speed_m_s")],
        ),
        (
            {"route": {"system_id": 3, "speed_m_s": 5.0}},
            ["route.speed_m_s = 5 is above requirement.target_speed_max_m_s = 3; change one"],
        ),
        (
            {"planner": {"lost_after_s": 400.0}},
            ["planner.lost_after_s = 400 has no effect above planner.give_up_after_s = 300, when the mission ends"],
        ),
    ],
)
def test_a_key_without_effect_is_noted(values, notes):
    assert list(setting_notes(load_config(None, values))) == notes


def test_a_circle_without_room_is_warned_of():
    assert room_warning(load_config(None, {"aircraft": {"radius_m": 105.0}})) is None
    warning = room_warning(load_config(None, {"aircraft": {"radius_m": 180.0}}))
    assert warning.startswith("aircraft.radius_m = 180 leaves little room to move the circle between 100 and 500 m")
    assert warning.endswith("make it 105 m at most, or requirement.range_max_m 784 m at least")


def test_a_radius_that_the_bank_forbids_is_not_advised():
    warning = room_warning(load_config(None, {"aircraft": {"radius_m": 180.0, "bank_max_deg": 10.0}}))
    assert warning.endswith(
        "make requirement.range_max_m 784 m at least; "
        "a smaller circle needs a lower aircraft.airspeed_m_s or a higher bank_max_deg"
    )


@pytest.mark.parametrize(
    "values",
    [
        {"requirement": {"range_max_m": 150.0}},
        {"aircraft": {"radius_m": "auto", "bank_max_deg": 10.0, "airspeed_m_s": 40.0}},
    ],
)
def test_room_is_not_warned_of_where_the_circle_cannot_be_flown(values):
    assert room_warning(load_config(None, values)) is None
