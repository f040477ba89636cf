"""The journal gives back what was written, bit for bit, and every whole line of a damaged one."""

from __future__ import annotations

import math
import random
import struct
import zlib
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal
from unittest.mock import Mock

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.app.errors import InputError
from sidelong.app.fleet.coordination import FLEET_JOURNAL_TYPES
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records import journal
from sidelong.app.records.journal import Header, JournalReader, JournalWriter, encode
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.sighting import Fix, Sighting
from sidelong.mission.core.events import Announce, BatteryReported, PlanStatus, UploadPlan
from sidelong.mission.core.fleet import NeighbourPlanned
from sidelong.mission.fleet.events import ChargeReported, SightingReported, VehicleEvent

HEADER = Header("sidelong 0", {"aircraft": {"radius_m": 80.0}}, LocalPlane(47.4, 8.5), {"target": 3})


class Colour(StrEnum):
    RED = "red"
    GREEN = "green"


@dataclass(frozen=True, slots=True)
class Inner:
    x_m: float
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class Everything:
    time_s: float
    name: str
    flag: bool
    kind: Literal["one", "two"]
    colour: Colour
    inner: Inner
    maybe: Inner | None
    pair: tuple[float, float]
    several: tuple[Inner, ...]
    samples: npt.NDArray[np.float64]
    values: dict[str, float]
    limit_m: float | None = None


def bits(value: Any) -> Any:
    """Return the value so that equal means the same to the last bit, NaN and signs of zero included."""
    if is_dataclass(value):
        return type(value), [bits(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, np.ndarray):
        return value.shape, [bits(one) for one in value.ravel().tolist()]
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("<d", value)
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    return type(value), value


inners = st.builds(Inner, st.floats(), st.integers())
events = st.builds(
    Everything,
    time_s=st.floats(),
    name=st.text(),
    flag=st.booleans(),
    kind=st.sampled_from(["one", "two"]),
    colour=st.sampled_from(Colour),
    inner=inners,
    maybe=st.none() | inners,
    pair=st.tuples(st.floats(), st.floats()),
    several=st.lists(inners, max_size=3).map(tuple),
    samples=st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=4).map(
        lambda rows: np.array(rows, np.float64)
    ),
    values=st.dictionaries(st.text(), st.floats(), max_size=3),
    limit_m=st.none() | st.floats(),
)


def written(path: Path, several: list[Any]) -> Path:
    path.write_bytes(encode(HEADER) + b"".join(map(encode, several)))
    return path


@settings(max_examples=60, deadline=None)
@given(several=st.lists(events, max_size=3))
def test_events_come_back_bit_for_bit(tmp_path_factory, several):
    path = written(tmp_path_factory.mktemp("journal") / "j.jsonl", several)
    reader = JournalReader(path, [Everything])
    assert reader.header == HEADER
    assert list(map(bits, reader)) == list(map(bits, several))
    assert reader.damaged_lines == 0


@settings(max_examples=60, deadline=None)
@given(several=st.lists(events, max_size=3))
def test_the_quick_way_gives_what_the_other_gives(tmp_path_factory, several):
    path = written(tmp_path_factory.mktemp("journal") / "j.jsonl", several)
    quick = list(JournalReader(path, [Everything]))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(journal, "_decode", Mock(side_effect=TypeError))
        slow = list(JournalReader(path, [Everything]))
    assert list(map(bits, quick)) == list(map(bits, slow))


def test_every_type_is_read_the_quick_way():
    for kind in {*JOURNAL_TYPES, *FLEET_JOURNAL_TYPES}:
        assert callable(journal._decode(kind))


SIGHTED = Sighting(1.5, 300.0, -0.5, 0.25, 0.75, 0.01, 0.02, -50.0, 20.0, 80.0, None)


@pytest.mark.parametrize(
    "event",
    [
        SightingReported("wing", SIGHTED),
        SightingReported("wing", Fix(2.5, -10.0, 20.0, 3.0)),
        VehicleEvent("wing", NeighbourPlanned(3.5, "plane", None, None)),
    ],
    ids=["sighting", "fix", "neighbour"],
)
def test_the_quick_way_reports_types_apart_by_their_fields(event):
    line = encode(event)
    fields_of_it = line[line.index(b'"fields":') + len(b'"fields":') : line.rindex(b',"crc32"')]
    assert encode(journal._decode(type(event))(fields_of_it)) == line


@pytest.mark.parametrize(
    ("fields", "read"),
    [
        (b'{"x_m":3,"count":2.0}', Inner(3.0, 2)),  # whole numbers and others in one another's place
        (b'{"x_m":"0.5","count":1}', Inner(0.5, 1)),
        (b'{"x_m":1e999,"count":36893488147419103232}', Inner(math.inf, 2**65)),
        (b'{"count":1, "x_m": -0.0,"gone":[null]} ', Inner(-0.0, 1)),
    ],
)
def test_what_is_written_otherwise_is_read_as_ever(tmp_path, fields, read):
    line = b'{"event":"Inner","fields":' + fields
    path = written(tmp_path / "j.jsonl", [])
    path.write_bytes(path.read_bytes() + line + b',"crc32":"%08x"}\n' % zlib.crc32(line))
    assert list(map(bits, JournalReader(path, [Inner]))) == [bits(read)]


@pytest.mark.parametrize("rest", [b"[1]", b'{"x_m":1.0,"count":', b'{"x_m":1.0,"count":1}]'])
def test_a_whole_line_that_is_no_event_is_passed_over_and_counted(tmp_path, rest):
    line = b'{"event":"Inner","fields":' + rest
    path = written(tmp_path / "j.jsonl", [])
    path.write_bytes(path.read_bytes() + line + b',"crc32":"%08x"}\n' % zlib.crc32(line))
    reader = JournalReader(path, [Inner])
    assert (list(reader), reader.damaged_lines) == ([], 1)


def test_the_writer_writes_what_the_reader_reads(tmp_path):
    several = [Inner(0.1 * i, i) for i in range(1000)]
    with JournalWriter(tmp_path / "j.jsonl", HEADER, pytest.fail) as writer:
        for event in several:
            writer.write(event)
    reader = JournalReader(tmp_path / "j.jsonl", [Inner])
    assert list(reader) == several
    assert list(reader) == several  # from the first again


def test_scalars_of_numpy_are_written_as_plain_numbers(tmp_path):
    event = Inner(np.float64(0.1), np.int64(3))  # type: ignore[arg-type]  # what a careless caller passes
    (read,) = JournalReader(written(tmp_path / "j.jsonl", [event]), [Inner])
    assert read == Inner(0.1, 3)


def test_cut_at_any_byte_all_whole_lines_are_read(tmp_path):
    rng = random.Random(1)
    several = [Inner(rng.random(), i) for i in range(100)]
    path = written(tmp_path / "j.jsonl", several)
    whole = path.read_bytes()
    ends = list(accumulate(map(len, map(encode, [HEADER, *several]))))
    for cut in rng.sample(range(ends[0], len(whole)), 200):
        path.write_bytes(whole[:cut])
        reader = JournalReader(path, [Inner])
        assert list(reader) == several[: sum(end <= cut for end in ends) - 1]
        assert reader.damaged_lines == 0


def test_damage_costs_only_the_lines_it_hits_and_is_counted(tmp_path):
    rng = random.Random(2)
    several = [Inner(rng.random(), i) for i in range(100)]
    path = written(tmp_path / "j.jsonl", several)
    whole = path.read_bytes()
    ends = list(accumulate(map(len, map(encode, [HEADER, *several]))))
    for _ in range(200):
        begin, length = rng.randrange(ends[0], len(whole) - 100), rng.choice([1, 1, 2, 100])
        damage = rng.randbytes(length)
        path.write_bytes(whole[:begin] + damage + whole[begin + length :])
        changed = whole[begin : begin + length] != damage
        untouched = [
            event
            for event, first, end in zip(several, ends, ends[1:], strict=False)
            if not changed or end <= begin or begin + length <= first
        ]
        reader = JournalReader(path, [Inner])
        found = list(reader)
        assert [event for event in found if event in untouched] == untouched
        assert all(event in several for event in found)
        assert (reader.damaged_lines > 0) == (len(found) < len(several))


@pytest.mark.parametrize(
    "content", [b"", b"no journal\n", b"\x00" * 1000, encode(HEADER)[:-5], encode(Inner(1.0, 1))]
)
def test_a_file_without_a_header_is_an_input_error(tmp_path, content):
    (tmp_path / "j.jsonl").write_bytes(content)
    with pytest.raises(InputError, match="no journal header"):
        JournalReader(tmp_path / "j.jsonl", [Inner])


def test_a_journal_of_another_format_is_an_input_error(tmp_path):
    newer = Header("sidelong 9", {}, None, {}, format=9)
    (tmp_path / "j.jsonl").write_bytes(encode(newer))
    with pytest.raises(InputError, match=r"format 9; this program reads 1 to 2\."):
        JournalReader(tmp_path / "j.jsonl", [Inner])


def test_an_event_of_an_unknown_type_is_an_input_error(tmp_path):
    path = written(tmp_path / "j.jsonl", [Inner(1.0, 1)])
    with pytest.raises(InputError, match="an event Inner that this program does not know"):
        list(JournalReader(path, []))


def test_a_missing_journal_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        JournalReader(tmp_path / "j.jsonl", [])


def test_a_journal_of_the_first_format_is_read_in_todays_words(tmp_path):
    path = tmp_path / "journal.jsonl"
    header = b'{"event":"Header","fields":{"program":"sidelong 0","config":{},"plane":null,"seeds":{},"format":1}'
    swap = b'{"event":"SwapReported","fields":{"time_s":1.0,"number":2,"stage":"ready","detail":""}'
    transition = b'{"arc_m":[0.0],"east_m":[0.0],"north_m":[0.0],"course_rad":[0.0],"curvature_1_m":[0.02]}'
    prepare = (
        b'{"event":"Prepare","fields":{"time_s":1.0,"number":2,"plan":{"circle":{"east_m":0.0,"north_m":1.0,'
        b'"radius_m":50.0,"clockwise":true},"transition":' + transition + b',"departure_s":3.0},"commanded":'
        b'{"east_m":0.0,"north_m":1.0,"radius_m":50.0,"clockwise":true},"present":{"circle":{"east_m":0.0,'
        b'"north_m":1.0,"radius_m":50.0,"clockwise":true},"transition":null,"departure_s":0.0},'
        b'"wind":{"east_m_s":0.0,"north_m_s":0.0},"reason":"why"}'
    )
    announced = b'{"event":"Announce","fields":{"time_s":2.0,"kind":"swap","text":"plan 2 was not taken"}'
    lines = (header, swap, prepare, announced)
    path.write_bytes(b"".join(line + b',"crc32":"%08x"}\n' % zlib.crc32(line) for line in lines))
    read = list(JournalReader(path, (PlanStatus, UploadPlan, Announce)))
    assert read[0] == PlanStatus(1.0, 2, "ready")
    assert read[1].plan.transition.curvature_per_m == [0.02]
    assert read[2] == Announce(2.0, "plan", "plan 2 was not taken")


def test_what_format_2_reported_of_plans_at_first_is_read_in_todays_words(tmp_path):
    path = written(tmp_path / "journal.jsonl", [Announce(2.0, "swap", "plan 2 was not taken")])
    assert list(JournalReader(path, (Announce,))) == [Announce(2.0, "plan", "plan 2 was not taken")]


@pytest.mark.parametrize(
    ("event", "earlier"),
    [
        (ChargeReported("wing", 5.0, 0.4, 300.0), b"BatteryReported"),
        (VehicleEvent("wing", NeighbourPlanned(3.5, "plane", None, None)), b"Tell"),
    ],
    ids=lambda part: type(part).__name__,
)
def test_what_a_fleet_recorded_under_an_earlier_name_is_read(tmp_path, event, earlier):
    path = written(tmp_path / "journal.jsonl", [event])
    header, line = path.read_bytes().splitlines(keepends=True)
    body = line.replace(type(event).__name__.encode(), earlier).rsplit(b',"crc32"', 1)[0]
    path.write_bytes(header + body + b',"crc32":"%08x"}\n' % zlib.crc32(body))
    (read,) = JournalReader(path, FLEET_JOURNAL_TYPES)
    assert encode(read) == encode(event)


def test_a_flight_s_own_report_of_its_battery_keeps_its_name(tmp_path):
    report = BatteryReported(5.0, 40.0, 300.0, 60.0)
    assert list(JournalReader(written(tmp_path / "journal.jsonl", [report]), JOURNAL_TYPES)) == [report]
