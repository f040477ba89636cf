"""Files that once broke a reader, each by its name."""

from __future__ import annotations

import json
import struct
import tracemalloc
import zlib

import pytest

from sidelong.app.errors import InputError
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.journal import Header, JournalReader, encode
from sidelong.app.records.log import open_log
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.report.history import read_summary
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Announce
from sidelong.sitl.world.track import read_track
from sidelong.sitl.world.track_file import TrackError


def ulog(*definitions: str, topic: str = "wind", data: bytes = b"") -> bytes:
    def message(letter: bytes, body: bytes) -> bytes:
        return struct.pack("<H", len(body)) + letter + body

    parts = [b"ULog\x01\x12\x35\x01" + bytes(8), *(message(b"F", text.encode()) for text in definitions)]
    return b"".join([*parts, message(b"A", b"\0\0\0" + topic.encode()), message(b"D", b"\0\0" + data)])


NESTED = [f"{'abcdefgh'[i]}:{'abcdefgh'[i + 1]}[99] x;" for i in range(7)]


@pytest.mark.parametrize(
    "content",
    [
        ulog("wind:float windspeed_north;float windspeed_east;", data=bytes(8)),
        ulog("wind:uint64_t timestamp;wind again;", data=bytes(8)),
        ulog("wind:uint64_t timestamp;a many;", *NESTED, "h:float[99] x;", data=bytes(64)),
        ulog("wind:uint64_t timestamp;float timestamp;", data=bytes(12)),
        ulog("wind:uint64_t timestamp;float[65535] x;", data=bytes(60_000)),
        ulog("wind:uint64_t timestamp;nowhere x;", data=bytes(60)),
    ],
    ids=["no time", "recursive", "arrays of arrays", "one name twice", "longer than a message", "undefined type"],
)
def test_a_ulog_that_defines_nonsense(tmp_path, capfd, content):
    path = tmp_path / "flight.ulg"
    path.write_bytes(content)
    log = open_log(path)
    assert list(log.messages(Telemetry().wanted)) == []
    assert "the ULog has nothing" in log.looked_for()
    assert capfd.readouterr() == ("", "")


def test_a_dataflash_log_whose_times_are_texts(tmp_path):
    path = tmp_path / "flight.bin"
    definition = struct.pack("<BB4s16s64s", 131, 3 + 64 + 6, b"ATT", b"Zccc", b"TimeUS,Roll,Pitch,Yaw")
    entry = b"\xa3\x95\x83" + b"x" * 64 + bytes(6)
    path.write_bytes(b"\xa3\x95\x80" + definition + 50 * entry)
    assert list(open_log(path).messages(Telemetry().wanted)) == []


def test_a_dataflash_log_whose_angles_are_texts(tmp_path):
    path = tmp_path / "flight.bin"
    definition = struct.pack("<BB4s16s64s", 131, 3 + 8 + 48, b"ATT", b"QNNN", b"TimeUS,Roll,Pitch,Yaw")
    entries = [b"\xa3\x95\x83" + struct.pack("<Q", 1_000_000 * i) + b"x" * 48 for i in range(50)]
    path.write_bytes(b"\xa3\x95\x80" + definition + b"".join(entries))
    assert list(open_log(path).messages(Telemetry().wanted)) == []


HEADER = encode(Header("sidelong", {}, LocalPlane(47.4, 8.5), {}))


def sealed(body: str) -> bytes:
    return body.encode() + b',"crc32":"%08x"}\n' % zlib.crc32(body.encode())


@pytest.mark.parametrize(
    "line",
    [
        sealed('{"event":"Announce","fields":{"time_s":' + "[" * 60_000 + "]" * 60_000 + "}"),
        sealed('{"event":"Announce"'),
        sealed('{"event":"Announce","fields":[]'),
        sealed('{"event":["Announce"],"fields":{}'),
        b'{"event":"' * 200_000 + b"\n",
        b"x" * (9 << 20) + b"\n",
    ],
    ids=["nested without end", "no fields", "fields are a list", "no name", "openings without end", "9 MB"],
)
def test_a_journal_line_that_is_none_is_passed_over(tmp_path, line):
    path, announced = tmp_path / "journal.jsonl", Announce(1.0, "track", "good")
    path.write_bytes(HEADER + line + encode(announced))
    reader = JournalReader(path, JOURNAL_TYPES)
    assert list(reader) == [announced]
    assert reader.damaged_lines


def test_a_journal_line_without_end_takes_no_more_memory(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(HEADER + b"x" * (40 << 20) + b"\n")
    tracemalloc.start()
    try:
        assert list(JournalReader(path, JOURNAL_TYPES)) == []
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 16 << 20


@pytest.mark.parametrize(
    "fields", ['{"time_s":1.0}', '{"time_s":"soon","kind":"track","text":"x"}', f'{{"time_s":1{"0" * 400}}}']
)
def test_a_journal_line_of_another_kind_is_one_sentence(tmp_path, fields):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(HEADER + sealed(f'{{"event":"Announce","fields":{fields}'))
    with pytest.raises(InputError, match=r"journal\.jsonl has an event Announce"):
        list(JournalReader(path, JOURNAL_TYPES))


@pytest.mark.parametrize(
    "text", ["[]", "3", "[" * 60_000, '{"duration_s": "long"}', "\0", "x" * (2 << 20)], ids=lambda text: text[:12]
)
def test_a_summary_that_is_none_is_one_sentence(tmp_path, text):
    folder = RunFolder(tmp_path)
    folder.summary.write_text(text)
    with pytest.raises(InputError, match=r"summary\.json"):
        read_summary(folder.read_summary(), str(folder.summary))


@pytest.mark.parametrize("text", ["[]", "3"])
def test_a_summary_that_is_no_object_is_refused_as_it_is_read(tmp_path, text):
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(InputError, match="is no summary of a run"):
        RunFolder(tmp_path).read_summary()


def test_a_summary_may_have_more_than_this_program_knows(tmp_path):
    values = dict.fromkeys(("moves", "uploads", "upload_failures", "sightings", "rejected"), 3)
    values |= dict.fromkeys(("duration_s", "time_in_band", "time_on_side", "min_range_m", "max_range_m"), 0.5)
    values |= {"source": "truth", "estimate_rmse_m": None, "outcome": "completed", "later": [1]}
    (tmp_path / "summary.json").write_text(json.dumps(values))
    assert read_summary(RunFolder(tmp_path).read_summary(), "summary.json").moves == 3


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("track.csv", b"time_s,east_m,north_m\n0,1,2\n1,2\n"),
        ("track.csv", b"time_s,east_m,north_m\n0,1,2\n1,2," + b"9" * 140_000 + b"\n"),
        ("track.csv", b"time_s,east_m,north_m\n0,1,2\n" + b"x" * 200_000),
        ("track.csv", b"\xff\xfe\x00"),
        ("track.gpx", b"<?xml version='1.0' encoding='no-such'?><gpx/>"),
        ("track.gpx", b"<?xml version='1.0' encoding='utf-7'?><gpx/>"),
        ("track.gpx", b"<a>" * 100_000),
        ("track.gpx", b"<gpx>" + 2 * b"<trkpt lat='x' lon='8'><time>2020-01-01T00:00:00Z</time></trkpt>" + b"</gpx>"),
        ("track.gpx", b"<gpx>" + 2 * b"<trkpt lat='1' lon='8'><time>0001-01-01</time></trkpt>" + b"</gpx>"),
        ("track.gpx", b"<gpx>" + b" " * (17 << 20) + b"</gpx>"),
    ],
    ids=[
        "short row",
        "long number",
        "long field",
        "no text",
        "encoding",
        "utf-7",
        "deep",
        "place",
        "year 1",
        "17 MB",
    ],
)
def test_a_track_that_is_none_is_one_sentence(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TrackError, match=name) as caught:
        read_track(tmp_path / name)
    assert len(str(caught.value)) < 400


def test_a_track_that_is_too_long_is_not_read(tmp_path):
    path = tmp_path / "track.gpx"
    path.write_bytes(b"<gpx>" + b" " * (17 << 20) + b"</gpx>")
    with pytest.raises(TrackError, match="is longer than"):
        read_track(path)


def test_a_short_row_costs_that_row_only(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("time_s,east_m,north_m\n0,1,2\n1,2\n2,,4\n3,4,5\n")
    assert list(read_track(path).time_s) == [0.0, 3.0]


@pytest.mark.parametrize("read", [open_log, read_track])
def test_a_folder_is_no_file(tmp_path, read):
    with pytest.raises((InputError, TrackError), match="not a file"):
        read(tmp_path)
