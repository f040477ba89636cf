"""Reading telemetry logs, whole and damaged, next to pymavlink's own reader."""

from __future__ import annotations

import random
from itertools import accumulate
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.records.tlog import is_tlog, read_tlog, tlog_contents

WANTED = ("ATTITUDE", "DISTANCE_SENSOR", "STATUSTEXT")


@pytest.fixture(autouse=True)
def _mavlink_2(monkeypatch):
    """Have pymavlink read MAVLink 1 by the definitions of MAVLink 2 as well, with the extensions zero."""
    monkeypatch.setenv("MAVLINK20", "1")
    mavutil.set_dialect("all")


def messages(path: Path, wanted=WANTED) -> list[tuple]:
    return [
        (m.name, m.system_id, m.component_id, dict(sorted(m.fields.items())), m.received_s)
        for m in read_tlog(path, wanted)
    ]


def pymavlink_messages(path: Path, wanted=WANTED) -> list[tuple]:
    log = mavutil.mavlink_connection(str(path))
    found = []
    while (m := log.recv_match(type=list(wanted))) is not None:
        fields = {name: getattr(m, name) for name in sorted(m.get_fieldnames())}
        found.append((m.get_type(), m.get_srcSystem(), m.get_srcComponent(), fields, m._timestamp))
    log.close()
    return found


def write(path: Path, pieces: list[bytes]) -> Path:
    path.write_bytes(b"".join(pieces))
    return path


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_messages_are_those_of_pymavlink(tmp_path, sender, stamped, version, signed):
    path = write(tmp_path / "a.tlog", stamped(sender(version=version, signed=signed).mixture(498)))
    found = messages(path)
    assert len(found) == 332  # two attitudes, one range and one text of every six
    assert repr(found) == repr(pymavlink_messages(path))


def test_every_message_pymavlink_can_pack_is_read_alike(tmp_path, sender, stamped):
    rng = random.Random(1)
    frames = []
    for definition in dialect.mavlink_map.values():
        values = definition.unpacker.unpack(rng.randbytes(definition.unpacker.size))
        by_name, at = {}, 0
        for name, length in zip(definition.ordered_fieldnames, definition.lengths, strict=True):
            by_name[name] = values[at] if length == 1 else list(values[at : at + length])
            at += length
        frames.append(sender().frame(definition(*(by_name[name] for name in definition.fieldnames))))
    path = write(tmp_path / "a.tlog", stamped(frames))
    names = [definition.msgname for definition in dialect.mavlink_map.values()]
    found = messages(path, names)
    assert [m[0] for m in found] == names
    assert repr(found) == repr(pymavlink_messages(path, names))


def test_without_names_every_message_is_read(tmp_path, sender, stamped):
    path = write(tmp_path / "a.tlog", stamped(sender().mixture(60)))
    assert len(list(read_tlog(path))) == 60


def test_versions_and_components_may_mix(tmp_path, sender, stamped):
    frames = [
        frame
        for i in range(100)
        for frame in (
            sender(version=1).attitude(i),
            sender(signed=True, component=154).range(i),
            sender(component=2).attitude(i),
        )
    ]
    path = write(tmp_path / "a.tlog", stamped(frames))
    assert [m[2] for m in messages(path)] == [1, 154, 2] * 100
    assert tlog_contents(path) == {"ATTITUDE": 200, "DISTANCE_SENSOR": 100}


def test_garbage_between_frames_costs_no_frame(tmp_path, sender, stamped):
    rng = random.Random(2)
    frames = stamped(sender().mixture(300))
    clean = messages(write(tmp_path / "clean.tlog", frames))
    dirty = [piece for frame in frames for piece in (rng.randbytes(rng.randrange(60)), frame)]
    assert messages(write(tmp_path / "dirty.tlog", dirty)) == clean


def test_cut_at_any_byte_all_whole_frames_are_read(tmp_path, sender, stamped):
    rng = random.Random(3)
    frames = stamped(sender(version=2).mixture(100) + sender(version=1).mixture(100))
    whole, path = b"".join(frames), tmp_path / "cut.tlog"
    ends = list(accumulate(map(len, frames)))
    every = messages(write(path, frames), None)
    assert len(every) == 200
    for cut in rng.sample(range(len(whole)), 200):
        path.write_bytes(whole[:cut])
        assert messages(path, None) == every[: sum(end <= cut for end in ends)]


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_damage_costs_only_the_frames_it_hits(tmp_path, sender, stamped, version, signed):
    rng = random.Random(4)
    frames = stamped(sender(version=version, signed=signed).mixture(200))
    path = write(tmp_path / "damaged.tlog", frames)
    every = messages(path, None)
    whole = b"".join(frames)
    ends = list(accumulate(map(len, frames)))
    for _ in range(200):
        begin, length = rng.randrange(len(whole)), rng.choice([1, 1, 2, 8, 100])
        path.write_bytes(whole[:begin] + rng.randbytes(length) + whole[begin + length :])
        untouched = [
            message
            for message, frame, end in zip(every, frames, ends, strict=True)
            if end <= begin or begin + length <= end - len(frame)
        ]
        found = messages(path, None)
        assert [message for message in found if message in untouched] == untouched
        # A frame of which only the stamp was hit is still read; nothing is invented.
        assert {repr(message[:4]) for message in found} <= {repr(message[:4]) for message in every}


def test_a_length_byte_that_lands_on_a_later_frame_hides_none(tmp_path, sender, stamped):
    # The heartbeat's length is changed so that it ends exactly where the range between the two attitudes does.
    frames = stamped([sender().attitude(1), sender().heartbeat(), sender().range(2), sender().attitude(3)])
    swallowing = bytearray(frames[1])
    swallowing[9] += len(frames[2])
    frames[1] = bytes(swallowing)
    path = write(tmp_path / "a.tlog", frames)
    assert [m[0] for m in messages(path)] == ["ATTITUDE", "DISTANCE_SENSOR", "ATTITUDE"]


def test_a_frame_inside_another_is_its_content(tmp_path, sender, stamped):
    inner = sender().range(7)
    path = write(tmp_path / "a.tlog", stamped([sender().attitude(1), sender().tunnel(inner), sender().attitude(2)]))
    assert [m[0] for m in messages(path)] == ["ATTITUDE", "ATTITUDE"]
    assert [m[0] for m in messages(path, None)] == ["ATTITUDE", "TUNNEL", "ATTITUDE"]


def test_a_stamp_that_is_none_takes_the_time_of_the_frame_before(tmp_path, sender, stamped):
    frames = stamped([sender().attitude(i) for i in range(3)])
    frames[1] = bytes(8) + frames[1][8:]
    received = [m[4] for m in messages(write(tmp_path / "a.tlog", frames))]
    assert received == [1.7e9, 1.7e9, pytest.approx(1.7e9 + 0.02)]


def test_the_end_of_a_frame_is_no_stamp_of_the_next(tmp_path, sender):
    mav = sender()
    like_a_stamp = bytes(122) + bytes([0, 5, 1, 1, 1, 1])
    path = write(tmp_path / "raw", [mav.tunnel(like_a_stamp), mav.attitude(1), mav.attitude(2)])
    assert [one[-1] for one in messages(path)] == [0.0, 0.0]


def test_progress_ends_at_one(tmp_path, sender, stamped):
    path = write(tmp_path / "a.tlog", stamped(sender().mixture(10)))
    announced: list[float] = []
    list(read_tlog(path, WANTED, announced.append))
    assert announced[-1] == 1.0


def test_only_a_file_with_a_whole_frame_is_a_tlog(tmp_path, sender, stamped):
    assert is_tlog(write(tmp_path / "a", stamped([sender().heartbeat()])))
    assert not is_tlog(write(tmp_path / "b", [stamped([sender().heartbeat()])[0][:-1]]))
    assert not is_tlog(write(tmp_path / "c", [random.Random(5).randbytes(100_000)]))
    assert not is_tlog(write(tmp_path / "d", []))
