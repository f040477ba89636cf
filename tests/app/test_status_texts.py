"""Texts of the autopilot: put together from chunks, and the reason that is given for a refused arming."""

import pytest

from sidelong.app.link.vehicle import StatusTexts
from tests.messages import message

LONG = "Arming denied: Resolve system health failures first"  # one character more than a chunk holds


def text(text, number=0, chunk=0, severity=2, at_s=0.0):
    fields = {"text": text, "severity": severity, "id": number, "chunk_seq": chunk}
    return message("STATUSTEXT", received_s=at_s, **fields)


def taken(*messages):
    texts, received = StatusTexts(), []
    texts.listeners.append(lambda one: received.append(one.text))
    for one in messages:
        texts.take(one)
    return texts, received


def test_a_short_text_is_complete_at_once():
    assert taken(text("Throttle armed"))[1] == ["Throttle armed"]


def test_chunks_become_one_text():
    assert taken(text(LONG[:50], 7, 0), text(LONG[50:] + "\t", 7, 1))[1] == [LONG]


def test_a_space_at_the_end_of_a_chunk_stays():
    words = "word " * 10  # fifty characters
    assert taken(text(words, 7, 0), text("and more", 7, 1))[1] == [words + "and more"]


def test_a_lost_chunk_leaves_a_mark_and_does_not_hold_back_the_next_text():
    _, received = taken(text("a" * 50, 7, 0), text("c", 7, 2))
    assert received == ["a" * 50 + "...c"]
    _, received = taken(text("a" * 50, 7, 0), text("another", 8, 0))
    assert received == ["a" * 50, "another"]


def test_control_characters_never_come_through():
    assert taken(text("red \x1b[31m alert\t"))[1] == ["red ?[31m alert"]


def test_only_warnings_of_the_time_that_is_asked_for_and_each_once():
    texts, _ = taken(
        text("long ago", at_s=1.0),
        text("Preflight Fail: compass", at_s=5.0),
        text("Throttle armed", severity=6, at_s=6.0),
        text("Arming denied", at_s=6.0),
        text("Preflight Fail: compass", at_s=7.0),
        text("b" * 50, 9, 0, at_s=8.0),
    )
    assert texts.warnings(2.0) == ("Arming denied", "Preflight Fail: compass", "b" * 50)


@pytest.mark.parametrize("missing", ["id", "chunk_seq"])
def test_a_text_of_an_old_autopilot_has_no_chunks(missing):
    message = text("Throttle armed")
    fields = {name: value for name, value in message.fields.items() if name != missing}
    assert taken(message._replace(fields=fields))[1] == ["Throttle armed"]
