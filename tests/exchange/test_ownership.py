"""Which reports of a mission are of one of ours."""

from dataclasses import replace

from sidelong.mission.exchange.ownership import MissionIdentity
from sidelong.mission.upload.mission_item import MissionItem, same_item


def test_a_list_that_is_being_written_item_by_item_is_ours_at_each_length():
    identity = MissionIdentity({(2, 0)}, writing=23)
    assert all(identity.is_ours(total, 0) for total in range(2, 24))
    assert not identity.is_ours(24, 0)
    assert not identity.is_ours(1, 0)
    identity.written(23, 0)
    assert not identity.is_ours(5, 0)
    assert identity.is_ours(23, 0)


def test_a_list_that_is_taken_over_whole_has_no_lengths_between():
    identity = MissionIdentity({(3, 77)}, writing=9)
    assert identity.is_ours(9, 78)
    assert not identity.is_ours(5, 78)


def test_an_id_proves_nothing_of_a_mission_that_may_or_may_not_have_been_written():
    identity = MissionIdentity({(3, 77)}, writing=9)
    identity.written(9, 0, accepted=False)
    assert identity.is_open(9, 78)
    assert not identity.is_open(3, 77)
    assert not identity.is_open(9, 0)  # without ids there is nothing to distinguish them by
    identity.written(9, 78)
    assert not identity.is_open(9, 79)
    assert identity.is_ours(9, 78)


def test_a_take_off_that_px4_has_stored_is_still_ours():
    sent = MissionItem(22, 3, 15.0, 0.0, 0.0, float("nan"), 473977419, 85455938, 50.0)
    assert same_item(sent, replace(sent, frame=6, param1=0.0))
    assert not same_item(sent, replace(sent, x=sent.x + 1000))
    assert not same_item(replace(sent, command=17), replace(sent, command=17, param1=0.0))
