"""The mission protocol between a vehicle and stations that lose packets, compete or give up."""

import random

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour

ACCEPTED = mavlink.MAV_MISSION_ACCEPTED
REQUESTS = {Flavour.ARDUPLANE: "MISSION_REQUEST", Flavour.PX4: "MISSION_REQUEST_INT"}


@pytest.fixture(params=list(Flavour))
def ground(request, simulate, station):
    ground = station(simulate(flavour=request.param, payload=None))
    ground.run(25.0)
    return ground


def plan(ground, count=4):
    return ground.mission(*(ground.loiter(100.0 * i, 50.0, 60.0 + i) for i in range(count)))


def count_message(count, mission_type=0):
    return mavlink.MAVLink_mission_count_message(1, 1, count, mission_type)


def test_what_was_uploaded_is_downloaded(ground):
    items = plan(ground)
    assert ground.upload(items) == ACCEPTED
    kept = ground.download()
    assert [item.seq for item in kept] == list(range(len(items)))
    assert [(i.command, i.x, i.y) for i in kept[1:]] == [(i.command, i.x, i.y) for i in items[1:]]


@pytest.mark.parametrize(("flavour", "expected"), [(Flavour.ARDUPLANE, 4), (Flavour.PX4, 16)])
def test_a_lost_answer_is_asked_for_again(simulate, station, flavour, expected):
    """ArduPlane asks once a second, PX4 every 250 ms."""
    ground = station(simulate(flavour=flavour, payload=None))
    ground.run(25.0)
    ground.send(count_message(3))
    ground.run(4.1)
    requests = ground.all(REQUESTS[flavour])
    assert {m.seq for m in requests} == {0}
    assert len(requests) - 1 == pytest.approx(expected, abs=1)


def test_timers_run_on_the_stations_clock(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None, link_rate=10.0))
    ground.run(25.0)
    ground.send(count_message(3))
    ground.run(4.1)
    assert len(ground.all("MISSION_REQUEST_INT")) == 2


def test_a_silent_upload_is_given_up_and_another_can_begin(ground, station):
    ground.send(count_message(3))
    ground.run(10.0)
    assert ground.upload(plan(ground)) == ACCEPTED


def test_a_second_uploader_is_turned_away(ground, station):
    other = station(ground.simulation, alongside=ground, address="other", system_id=250)
    ground.send(count_message(3))
    ground.run(0.1)
    other.send(count_message(2))
    ground.run(0.1)
    px4 = ground.simulation.settings.flavour == Flavour.PX4
    assert other.last("MISSION_ACK").type == (mavlink.MAV_MISSION_ERROR if px4 else mavlink.MAV_MISSION_DENIED)
    assert not other.all(REQUESTS[ground.simulation.settings.flavour])


def test_a_doubled_item_is_reported_by_arduplane_and_ignored_by_px4(ground):
    items = plan(ground)
    ground.send(count_message(len(items)))
    ground.run(0.04)
    ground.send(items[0])
    ground.run(0.04)
    ground.send(items[0])
    ground.run(0.04)
    px4 = ground.simulation.settings.flavour == Flavour.PX4
    assert [m.type for m in ground.all("MISSION_ACK")] == ([] if px4 else [mavlink.MAV_MISSION_INVALID_SEQUENCE])


def test_px4_acknowledges_a_repeated_last_item_again(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    ground.run(10.0)
    items = plan(ground)
    ground.upload(items)
    ground.send(items[-1])
    ground.run(0.1)
    assert [m.type for m in ground.all("MISSION_ACK")] == [ACCEPTED, ACCEPTED]


def test_a_download_is_refused_while_an_upload_runs(ground):
    ground.send(count_message(3))
    ground.run(0.1)
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    ground.run(0.1)
    assert not ground.all("MISSION_COUNT")
    if ground.simulation.settings.flavour == Flavour.PX4:
        assert not ground.all("MISSION_ACK")
        assert "ignored, already active" in ground.last("STATUSTEXT").text
    else:
        assert ground.last("MISSION_ACK").type != ACCEPTED


@pytest.mark.parametrize(("asked", "answered"), [([0, 0, 1, 2, 2], [0, 0, 1, 2, 2]), ([0, 2, 1], [0]), ([1], [])])
def test_px4_is_read_in_order_and_any_item_out_of_its_turn_ends_it(simulate, station, asked, answered):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    ground.run(10.0)
    ground.upload(plan(ground))
    before = len(ground.all("MISSION_ACK"))
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    for sequence in asked:
        ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, sequence, 0))
    ground.run(0.1)
    assert [m.seq for m in ground.all("MISSION_ITEM_INT")] == answered
    acknowledgements = [m.type for m in ground.all("MISSION_ACK")][before:]
    assert acknowledgements == ([] if asked == answered else [mavlink.MAV_MISSION_ERROR])


def test_px4_follows_nothing_else_while_it_is_read(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    ground.run(10.0)
    ground.upload(plan(ground))
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 2))
    ground.run(0.1)
    assert ground.simulation.vehicle.mission.index == 0
    assert ground.upload(plan(ground)) == mavlink.MAV_MISSION_ERROR
    ground.run(5.1)  # it gives that up
    ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 2))
    ground.run(0.1)
    assert ground.simulation.vehicle.mission.index == 2
    assert ground.upload(plan(ground)) == ACCEPTED


def test_px4_reports_in_words_only_that_it_clears_nothing_while_any_list_is_read(simulate, station):
    ground = station(simulate(flavour=Flavour.PX4, payload=None))
    ground.run(10.0)
    ground.upload(plan(ground))
    before = len(ground.all("MISSION_ACK"))
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, mavlink.MAV_MISSION_TYPE_FENCE))
    ground.run(0.1)
    assert [m.mission_type for m in ground.all("MISSION_COUNT")] == [0]
    ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1, mavlink.MAV_MISSION_TYPE_RALLY))
    ground.run(0.1)
    assert len(ground.all("MISSION_ACK")) == before
    assert "IGN CLEAR CMD: Busy" in ground.last("STATUSTEXT").text
    for sequence in range(len(plan(ground))):
        ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, sequence, 0))
    ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, mavlink.MAV_MISSION_TYPE_FENCE))
    ground.run(0.1)
    assert ground.last("MISSION_COUNT").mission_type == mavlink.MAV_MISSION_TYPE_FENCE


def test_the_sender_may_break_off(ground):
    ground.upload(plan(ground, 2))
    ground.send(count_message(3))
    ground.run(0.1)
    ground.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_OPERATION_CANCELLED, 0))
    ground.run(0.1)
    assert len(ground.download()) == len(plan(ground, 2))


@pytest.mark.parametrize("mission_type", [mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY])
def test_fences_and_rally_points_are_kept(ground, mission_type):
    items = [
        ground.item(
            i,
            mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            10.0 * i,
            0.0,
            0.0,
            (3, 0, 0, 0),
            False,
            mission_type,
        )
        for i in range(3)
    ]
    assert ground.upload(items) == ACCEPTED
    assert [m.x for m in ground.download(mission_type)] == [m.x for m in items]
    assert ground.download() == []


def test_clearing_empties_the_list(ground):
    ground.upload(plan(ground))
    ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    ground.run(0.1)
    assert ground.download() == []


def test_an_empty_upload_clears(ground):
    ground.upload(plan(ground))
    assert ground.upload([]) == ACCEPTED
    assert ground.download() == []


@pytest.mark.parametrize("seed", range(5))
def test_an_upload_completes_over_a_link_that_loses_every_fifth_packet(ground, seed):
    rng = random.Random(seed)
    items = plan(ground)
    seen = len(ground.received)
    ground.send(count_message(len(items)))
    for _ in range(3000):
        fresh, seen = ground.received[seen:], len(ground.received)
        for message in fresh:
            if rng.random() < 0.2:
                continue
            if message.get_type() == "MISSION_ACK":
                assert message.type == ACCEPTED
            elif message.get_type() in REQUESTS.values() and rng.random() >= 0.2:
                ground.send(items[message.seq])
        ground.run(0.02)
        if len(ground.simulation.vehicle.mission.items()) == len(items):
            break
    assert [i.latitude_e7 for i in ground.simulation.vehicle.mission.items()[1:]] == [i.x for i in items[1:]]
