"""The fleet file: what it gives each aircraft, and what it refuses in which words."""

from __future__ import annotations

import pytest

from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import load_fleet, names_a_fleet

TWO = """
[requirement]
side = "right"
[sensors]
range_sigma_m = 1.5
[[aircraft]]
name = "north"
autopilot = "arduplane"
radius_m = 60
[[aircraft]]
name = "south"
autopilot = "px4"
height_m = 200
[aircraft.sensors]
range_component = 9
"""


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "fleet.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_each_aircraft_has_a_configuration_as_if_it_flew_alone(written):
    north, south = load_fleet(written(TWO)).members
    assert (north.name, south.name) == ("north", "south")
    assert (north.config.aircraft.radius_m, south.config.aircraft.radius_m) == (60.0, 50.0)
    assert (north.config.aircraft.height_m, south.config.aircraft.height_m) == (100.0, 200.0)
    assert (north.config.simulation.autopilot, south.config.simulation.autopilot) == ("arduplane", "px4")
    assert north.config.requirement.side == south.config.requirement.side == "right"
    assert (north.config.sensors.range_component, south.config.sensors.range_component) == (None, 9)
    assert south.config.sensors.range_sigma_m == 1.5


def test_each_knows_how_many_watch_together(written):
    fleet = load_fleet(written(TWO))
    assert [one.config.requirement.fleet_size for one in fleet.members] == [2, 2]
    assert load_config(None).requirement.fleet_size == 1


def test_a_fleet_plans_for_no_pan_limits(written):
    with pytest.raises(InputError, match="'north': pan_limit_deg: a fleet plans for no pan limits; leave it out"):
        load_fleet(written(TWO.replace('name = "north"', 'name = "north"\npan_limit_deg = 120')))


def test_a_fleet_has_no_payload_with_a_driver(written):
    with pytest.raises(InputError, match=r"payload\.kind = 'siyi': a fleet reads its payloads by MAVLink"):
        load_fleet(written(TWO), {"payload": {"kind": "siyi"}})


def test_others_are_shown_of_one_target_and_of_every_aircraft_by_its_name(written):
    north, south = load_fleet(
        written(TWO + '[sharing]\ncot = "udp://127.0.0.1:8087"\nnmea = "udp://127.0.0.1:8088"\n')
    ).members
    assert north.config.sharing.cot == south.config.sharing.cot == "udp://127.0.0.1:8087"
    assert (north.config.sharing.cot_own_callsign, south.config.sharing.cot_own_callsign) == ("north", "south")
    assert (north.config.sharing.nmea, south.config.sharing.nmea) == ("udp://127.0.0.1:8088", None)
    with pytest.raises(InputError, match="a beacon is used by one aircraft"):
        load_fleet(written(TWO + '[sharing]\nbeacon = "udp://127.0.0.1:6969"\n'))


def test_aircraft_without_heights_get_layers(written):
    members = load_fleet(written(TWO.replace("height_m = 200", ""))).members
    assert [member.config.aircraft.height_m for member in members] == [100.0, 160.0]


def test_a_configuration_of_one_becomes_a_fleet_by_number(written):
    path = written("[aircraft]\nradius_m = 70\nheight_m = 80\n[simulation]\nautopilot = 'px4'\n")
    assert not names_a_fleet(path)
    fleet = load_fleet(path, {"simulation": {"autopilot": "arduplane,px4"}}, 3)
    assert [member.config.aircraft.height_m for member in fleet.members] == [80.0, 140.0, 200.0]
    assert [member.config.simulation.autopilot for member in fleet.members] == ["arduplane", "px4", "arduplane"]
    assert {member.config.aircraft.radius_m for member in fleet.members} == {70.0}
    assert len({member.config.simulation.seed for member in fleet.members}) == 3


def test_a_file_with_one_aircraft_is_todays(written):
    path = written('[[aircraft]]\nname = "one"\nradius_m = 70\n')
    assert names_a_fleet(path)
    (only,) = load_fleet(path).members
    assert only.config == load_config(None, {"aircraft": {"radius_m": 70.0}})


def test_links_are_each_aircrafts_own_or_shared(written):
    own = TWO.replace('name = "north"', 'name = "north"\nurl = "udpin://0.0.0.0:14540"')
    own = own.replace('name = "south"', 'name = "south"\nurl = "udpin://0.0.0.0:14541"')
    assert [member.config.link.connections for member in load_fleet(written(own)).members] == [
        ("udpin://0.0.0.0:14540",),
        ("udpin://0.0.0.0:14541",),
    ]
    shared = TWO.replace('name = "north"', 'name = "north"\nsystem_id = 1')
    shared = shared.replace('name = "south"', 'name = "south"\nsystem_id = 2')
    members = load_fleet(written(shared + '[link]\nurl = "udpin://0.0.0.0:14550"\n')).members
    assert [member.config.link.system_id for member in members] == [1, 2]
    assert {member.config.link.connections for member in members} == {("udpin://0.0.0.0:14550",)}


MISTAKES = {
    'side = "right"': [('side = "either"', "share the sides")],
    "radius_m = 60": [
        ("radius = 60", "unknown key aircraft.0.radius; known there: "),
        ("radius_m = 6000", "less than or equal to 2000"),
        ("radius_m = 15", "'north': infeasible"),
    ],
    'name = "south"': [
        ('name = "north"', "given twice"),
        ('name = "so/uth"', "aircraft.1.name"),
        ("", "aircraft.1.name is missing; give it."),
        ('name = "south"\nurl = "udpin://0.0.0.0:1"', "has no link"),
        ('name = "south"\ntarget = "bike"', "there are target"),
    ],
    "height_m = 200": [
        ("height_m = 120", "20 m apart"),
        ('height_above = "ground"', "all the same"),
    ],
    "range_component": [("range_kompo", "aircraft.1.sensors.range_kompo")],
    "[requirement]": [
        ("[fences]\nceiling_m = 150\n[requirement]", "above fences.ceiling_m"),
        ('[link]\nurl = "udpin://0.0.0.0:1"\n[requirement]', "give its system_id"),
        ("[[target]]\n[[target]]\n[requirement]", "give each target its own"),
        ('[[target]]\nside = "either"\n[requirement]', "target.0.side"),
        ("".join(f"[[target]]\nname = '{c}'\n" for c in "abc") + "[requirement]", "no aircraft"),
        ("target = 3\n[requirement]", "target"),
    ],
}


@pytest.mark.parametrize(
    ("changed", "to", "announced"), [(changed, *mistake) for changed, made in MISTAKES.items() for mistake in made]
)
def test_a_mistake_is_one_sentence_naming_file_and_field(written, changed, to, announced):
    assert changed in TWO
    path = written(TWO.replace(changed, to))
    with pytest.raises(InputError, match=r"^.*fleet\.toml: ") as refused:
        load_fleet(path)
    assert announced in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "announced"),
    [
        ('[aircraft]\nheight_m = "high"', "aircraft.height_m = 'high': give a number of metres"),
        ("aircraft = 5", "aircraft = 5: a table belongs there"),
    ],
)
def test_a_mistake_of_one_aircraft_that_is_to_be_two_is_one_sentence(written, text, announced):
    with pytest.raises(InputError, match=r"^.*fleet\.toml: ") as refused:
        load_fleet(written(text), {"simulation": {"autopilot": "px4"}}, 2)
    assert announced in str(refused.value)


def test_urls_are_unique(written):
    text = TWO.replace('name = "north"', 'name = "north"\nurl = "udpin://0.0.0.0:1"')
    text = text.replace('name = "south"', 'name = "south"\nurls = ["udpin://0.0.0.0:2", "udpin://0.0.0.0:1"]')
    with pytest.raises(InputError, match="given twice"):
        load_fleet(written(text))


def test_another_number_than_the_files_is_refused(written):
    with pytest.raises(InputError, match="leave out --fleet"):
        load_fleet(written(TWO), None, 3)


def test_each_aircraft_has_a_target_and_its_side(written):
    targets = '[[target]]\nname = "boat"\nside = "left"\n[[target]]\nname = "bike"\nmotion = "circle"\n'
    fleet = load_fleet(written(TWO + targets))
    north, south = fleet.members
    assert (north.target, south.target) == ("boat", "bike")
    assert (north.config.requirement.side, south.config.requirement.side) == ("left", "right")
    assert (north.config.simulation.target, south.config.simulation.target) == ("walk", "circle")
    assert [asked.side for asked in fleet.asked.values()] == ["left", "right"]
    both = TWO.replace('name = "north"', 'name = "north"\ntarget = "bike"')
    with pytest.raises(InputError, match="target 'boat' has no aircraft"):
        load_fleet(written(both + targets))


def test_each_target_has_its_own_route_or_that_of_all(written):
    targets = TWO + '[[target]]\nname = "boat"\n[target.route]\nfile = "boat.gpx"\n[[target]]\nname = "bike"\n'
    routes = load_fleet(written(targets + "[route]\nsystem_id = 7\n")).routes
    assert (str(routes["boat"].file), routes["boat"].system_id) == ("boat.gpx", None)
    assert (routes["bike"].file, routes["bike"].system_id) == (None, 7)
    assert not any(one.is_known for one in load_fleet(written(TWO)).routes.values())
