"""Which reports of a mission are of one of ours."""

from mission.exchange.ownership import MissionIdentity


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
