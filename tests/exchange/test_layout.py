"""A mission layout in which no upload, cut anywhere, changes what is flown."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.mission.upload.items import MissionLayout
from sidelong.mission.upload.mission_item import MissionItem

WAYPOINT, LOITER, HOME = 16, 17, 99


def item(command: int, tag: int) -> MissionItem:
    return MissionItem(command, 3, 0.0, 0.0, 60.0, 0.0, tag, tag, 100.0)


def line(tag: int, waypoints: int) -> tuple[MissionItem, ...]:
    return (*(item(WAYPOINT, 1000 * tag + k) for k in range(waypoints)), item(LOITER, 1000 * tag + 500))


def flown_from(stored: list[MissionItem], index: int) -> list[MissionItem]:
    """What a vehicle flies that starts at an index: on through the list until a circle that never completes."""
    flown = []
    for one in stored[index:]:
        flown.append(one)
        if one.command == LOITER:
            return flown
    raise AssertionError("the mission ends in a waypoint: the vehicle would go home")


def start(waypoints: int = 0) -> MissionLayout:
    first = line(1, waypoints)
    return MissionLayout((item(HOME, 0), *first), 1, 1, 1 + len(first))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 6), min_size=1, max_size=12), st.data())
def test_every_prefix_of_every_upload_leaves_the_present_line_whole(lengths, data):
    slots = start()
    stored = list(slots.items)
    for tag, waypoints in enumerate(lengths, 2):
        slots = slots.since(data.draw(st.integers(slots.first, slots.end - 1)))
        present = slots.items[slots.first : slots.end]
        following = slots.with_line(line(tag, waypoints))
        cut = data.draw(st.integers(0, len(following.items)))
        # ArduPlane: items are overwritten as they arrive; what lies beyond a shorter new list is cut off first.
        mixture = stored[: len(following.items)]
        mixture[:cut] = following.items[:cut]
        for step in range(len(present)):
            assert flown_from(mixture, slots.first + step) == list(present[step:])
        stored = list(following.items)
        assert flown_from(stored, following.first) == list(line(tag, waypoints))
        slots = following


@given(st.lists(st.integers(0, 6), min_size=1, max_size=60))
def test_the_mission_does_not_grow_with_the_number_of_moves(lengths):
    slots = start()
    for tag, waypoints in enumerate(lengths, 2):
        slots = slots.with_line(line(tag, waypoints))
        assert len(slots.items) <= 1 + 3 * 7
        assert slots.items[0].command == HOME


def test_a_line_flown_to_its_circle_leaves_room_for_the_next():
    slots = start(5)
    following = slots.since(slots.end - 1).with_line(line(2, 4))
    assert len(following.items) == len(slots.items)
    assert (following.first, following.end) == (1, 6)
