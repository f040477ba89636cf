"""Signatures against pymavlink's own, and what is let in."""

from __future__ import annotations

import os
import pickle
import traceback

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.errors import InputError
from sidelong.app.link.frames import Frame, FrameSplitter
from sidelong.app.link.signing import (
    LinkSigning,
    Refusal,
    SigningKey,
    SigningTimes,
    key_in_use,
    make_key,
    read_key,
    signing_time,
)

SECRET, OTHER_SECRET = bytes(range(32)), bytes(range(1, 33))
NOW = signing_time(1.78e9)
OURS, VEHICLE = (245, 190), (1, 1)


def signer(secret=SECRET, link_id=0, source=VEHICLE, now=NOW):
    """Return pymavlink's implementation, signing."""
    mav = mavlink.MAVLink(None, *source)
    mav.signing.secret_key, mav.signing.link_id, mav.signing.timestamp = secret, link_id, now
    mav.signing.sign_outgoing = secret is not None
    mav.signing.allow_unsigned_callback = lambda _mav, _message_id: False
    return mav


def heartbeat(mav, **options) -> Frame:
    return Frame(bytes(mavlink.MAVLink_heartbeat_message(1, 3, 81, 10, 4, 3).pack(mav, **options)))


def checking(times=None, link_id=0) -> LinkSigning:
    return LinkSigning(SigningKey(SECRET), times or SigningTimes(), link_id, OURS)


@pytest.mark.parametrize("message_id", [0, 30, 33, 76, 105])
def test_a_signed_frame_is_to_the_byte_the_one_of_pymavlink(message_id):
    definition = mavlink.mavlink_map[message_id]
    message = definition(*range(1, len(definition.fieldnames) + 1))
    theirs = signer(link_id=5, source=OURS)
    theirs.seq = 17
    expected = bytes(message.pack(theirs))
    unsigned = Frame(bytes(message.pack(mavlink.MAVLink(None, *OURS)))).renumbered(17, signed=True)
    assert checking(link_id=5).signed(unsigned, NOW) == expected


def test_pymavlink_lets_in_what_is_signed_here_and_nothing_else():
    theirs, ours = signer(), checking()
    for number in range(50):
        unsigned = heartbeat(mavlink.MAVLink(None, *OURS)).renumbered(number, signed=True)
        signed = ours.signed(unsigned, NOW + 3 * number)
        assert theirs.parse_char(signed).get_type() == "HEARTBEAT"
        with pytest.raises(mavlink.MAVError, match="signature"):
            theirs.parse_char(signed)


def test_what_pymavlink_signs_is_let_in_once():
    theirs, ours = signer(), checking()
    for _ in range(50):
        frame = heartbeat(theirs)
        assert ours.refusal(frame, NOW) is None
        assert ours.refusal(frame, NOW) is Refusal.OLD


def test_each_kind_of_wrong_frame_is_refused_by_its_name():
    ours = checking()
    assert ours.refusal(heartbeat(signer()), NOW) is None
    wrong = {
        Refusal.FUTURE: heartbeat(signer(now=2**48 - 2)),
        Refusal.UNSIGNED: heartbeat(mavlink.MAVLink(None, *VEHICLE)),
        Refusal.WRONG_KEY: heartbeat(signer(OTHER_SECRET, now=NOW + 9)),
        Refusal.OTHER_LINK: heartbeat(signer(link_id=1, now=NOW + 9)),
        Refusal.OWN: heartbeat(signer(source=OURS, now=NOW + 9)),
        Refusal.OLD: heartbeat(signer(source=(1, 154), now=NOW - 60 * 100_000 - 1)),
    }
    assert {ours.refusal(frame, NOW): frame for frame in wrong.values()} == wrong
    assert ours.refusal(heartbeat(mavlink.MAVLink(None, *VEHICLE), force_mavlink1=True), NOW) is Refusal.UNSIGNED
    assert ours.refusal(heartbeat(signer(now=NOW + 10)), NOW) is None


def test_no_bit_of_a_signed_frame_can_be_changed():
    genuine = heartbeat(signer()).data
    for bit in range(8 * len(genuine)):
        changed = bytearray(genuine)
        changed[bit // 8] ^= 1 << bit % 8
        assert all(checking().refusal(frame, NOW) for frame in FrameSplitter().split(bytes(changed)))


def test_a_source_comes_back_under_another_link_id_after_ten_silent_seconds():
    ours = checking()
    assert ours.refusal(heartbeat(signer()), NOW) is None
    assert ours.refusal(heartbeat(signer(link_id=1, now=NOW + 999_000)), NOW) is Refusal.OTHER_LINK
    assert ours.refusal(heartbeat(signer(link_id=1, now=NOW + 1_000_000)), NOW) is None
    assert ours.refusal(heartbeat(signer(now=NOW + 1_000_100)), NOW) is Refusal.OTHER_LINK


def test_the_time_only_rises_and_follows_a_clock_that_is_ahead():
    times = SigningTimes()
    ours = checking(times)
    assert [times.next(NOW), times.next(NOW), times.next(NOW - 500)] == [NOW, NOW + 1, NOW + 2]
    assert ours.refusal(heartbeat(signer(now=NOW + 10**9)), NOW) is None
    assert times.next(NOW) == NOW + 10**9 + 1


def test_frame_stamped_decades_ahead_is_refused_and_ends_no_sending():
    times = SigningTimes()
    ours = checking(times)
    assert ours.refusal(heartbeat(signer(now=2**48 - 2)), NOW) is Refusal.FUTURE
    assert times.next(NOW) == NOW
    assert ours.signed(heartbeat(signer()).data[:-13], NOW)


# -- files --------------------------------------------------------------------------------------------------------


def test_a_made_key_is_its_owner_s_alone_and_reads_back(tmp_path):
    path = tmp_path / "plane.key"
    made = make_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(path).for_setup() == made.for_setup()
    with pytest.raises(InputError, match=r"plane\.key exists already"):
        make_key(path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644])
def test_a_key_that_others_can_read_is_refused_with_the_way_out(tmp_path, mode):
    path = tmp_path / "plane.key"
    make_key(path)
    path.chmod(mode)
    with pytest.raises(InputError, match=r"can be read by others.*chmod 600"):
        read_key(path)


@pytest.mark.parametrize("content", [b"", b"00" * 31, b"zz" * 32, b"\xff" * 64, b"ab" * 3000])
def test_a_file_that_holds_no_key_is_refused_without_printing_its_content(tmp_path, content):
    path = tmp_path / "secret.key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(InputError, match="holds no signing key") as announced:
        read_key(path)
    shown = "".join(traceback.format_exception(announced.value))
    assert not content or content.decode("latin1")[:8] not in shown


def test_a_key_shows_itself_nowhere():
    key = SigningKey(SECRET)
    shown = f"{key!r} {key} {LinkSigning(key, SigningTimes(), 0, OURS)!r}"
    assert SECRET.hex()[:8] not in shown
    assert "\\x03\\x04" not in shown
    with pytest.raises(TypeError):
        pickle.dumps(key)


def test_neither_time_nor_replay_survives_a_restart(tmp_path):
    path = tmp_path / "plane.key"
    make_key(path)
    theirs = signer()
    recorded = []
    with key_in_use(path, NOW, pytest.fail) as kept:
        ours = checking(kept.times)
        for _ in range(20):
            recorded.append(heartbeat(theirs))
            assert ours.refusal(recorded[-1], NOW) is None
        sent = kept.times.next(NOW + 400)
    with key_in_use(path, NOW - 10**9, pytest.fail) as kept:  # the clock has gone back by hours
        ours = checking(kept.times)
        assert kept.times.next(NOW - 10**9) > sent
        assert [ours.refusal(frame, NOW - 10**9) for frame in recorded] == [Refusal.OLD] * 20
        assert ours.refusal(heartbeat(signer(now=NOW + 300_000)), NOW) is None


def test_file_of_times_from_the_far_future_is_usable_again(tmp_path):
    path = tmp_path / "plane.key"
    make_key(path)
    (tmp_path / "plane.key.times").write_text(f'{{"sent": {2**48 + 5}, "streams": [[0, 1, 1, {2**48 - 2}]]}}')
    with key_in_use(path, NOW, pytest.fail) as kept:
        assert kept.times.next(NOW).to_bytes(6, "little")
        assert max(kept.times.streams.values()) < 2**47


def test_symbolic_link_to_a_key_uses_the_times_of_the_key(tmp_path):
    path, other = tmp_path / "plane.key", tmp_path / "other.key"
    make_key(path)
    other.symlink_to(path)
    with (
        key_in_use(path, NOW, pytest.fail),
        pytest.raises(InputError, match="in use by another sidelong"),
        key_in_use(other, NOW, pytest.fail),
    ):
        pass
    assert not (tmp_path / "other.key.times").exists()


def test_fifo_as_a_key_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "plane.key", 0o600)
    with pytest.raises(InputError, match="not a regular file"):
        read_key(tmp_path / "plane.key")


def test_a_process_that_dies_has_lost_no_time(tmp_path):
    path = tmp_path / "plane.key"
    make_key(path)
    with key_in_use(path, NOW, pytest.fail) as kept:
        kept.save()
        written = (tmp_path / "plane.key.times").read_bytes()
        used = [kept.times.next(NOW + 100_000) for _ in range(5)]  # a second later, before the next save
    (tmp_path / "plane.key.times").write_bytes(written)
    with key_in_use(path, NOW, pytest.fail) as kept:
        assert kept.times.next(NOW) > max(used)


def test_a_key_is_used_by_one_process_at_a_time(tmp_path):
    path = tmp_path / "plane.key"
    make_key(path)
    with (
        key_in_use(path, NOW, pytest.fail),
        pytest.raises(InputError, match="in use by another"),
        key_in_use(path, NOW, pytest.fail),
    ):
        pytest.fail("twice")


@pytest.mark.parametrize("content", [b"{}", b"[]", b'{"sent": "x", "streams": []}', b"\xff", b"[" * 5000])
def test_damaged_times_are_reported_with_the_way_out(tmp_path, content):
    path = tmp_path / "plane.key"
    make_key(path)
    (tmp_path / "plane.key.times").write_bytes(content)
    with pytest.raises(InputError, match=r"plane\.key\.times.*delete it"), key_in_use(path, NOW, pytest.fail):
        pytest.fail("accepted")
