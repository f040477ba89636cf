"""The time of day by the vehicle's clock, from frames that pymavlink packed, in a tlog that pymavlink reads."""

from __future__ import annotations

import pytest
from pymavlink import mavutil

from sidelong.app.records.tlog import TlogClock, TlogWriter

WALL_S = 1.7e9


def stamps_s(frames_at: list[tuple[bytes, float]], system_id: int | None = None) -> list[float]:
    time = TlogClock()
    time.system_id = system_id
    return [time.stamp_s(frame, WALL_S + wall_s) - WALL_S for frame, wall_s in frames_at]


@pytest.mark.parametrize("version", [1, 2])
def test_a_log_of_a_fast_simulation_is_as_long_as_the_flight(tmp_path, sender, version):
    pack, time = sender(version=version), TlogClock()
    with TlogWriter(tmp_path / "flight.tlog", pytest.fail) as log:
        for tick in range(2001):  # 200 s of the vehicle's in 20 s
            for frame in (pack.attitude(5000 + 100 * tick), pack.text("something")):
                log.write(frame, time.stamp_s(frame, WALL_S + 0.01 * tick))
    read = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"))
    found = [(m.get_type(), m._timestamp) for m in iter(read.recv_match, None)]
    assert len(found) == 4002
    assert found[-1][1] - found[0][1] == pytest.approx(200.0, abs=1e-3)
    assert found[2001][1] - found[0][1] == pytest.approx(100.0, abs=1e-3)  # also what carries no time


def test_the_wall_counts_until_the_vehicle_has_spoken(sender):
    pack = sender()
    frames = [(pack.heartbeat(), 0.0), (pack.heartbeat(), 1.0), (pack.attitude(900_000), 2.0), (pack.text("a"), 2.1)]
    assert stamps_s([*frames, (pack.attitude(901_000), 2.2)]) == pytest.approx([0.0, 1.0, 2.0, 2.0, 3.0])


def test_a_wrong_stamp_and_a_restart_cost_no_order(sender):
    pack = sender()
    boots_s = [100.0, 101.0, 3701.0, 102.0, 103.0, 0.5, 1.5]  # an hour ahead once; then the vehicle starts again
    announced = stamps_s([(pack.attitude(round(1000 * boot_s)), float(i)) for i, boot_s in enumerate(boots_s)])
    assert announced == sorted(announced)
    assert announced == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def test_messages_that_overtake_one_another_do_not_set_it_back(sender):
    pack = sender()
    assert stamps_s([(pack.attitude(5000), 0.0), (pack.attitude(5100), 0.1), (pack.position(5060), 0.1)]) == (
        pytest.approx([0.0, 0.1, 0.1])
    )


def test_only_the_vehicle_that_is_flown_moves_it(sender):
    pack = sender()
    assert stamps_s([(pack.attitude(5000), 0.0), (pack.attitude(9000), 0.5)], system_id=7) == pytest.approx(
        [0.0, 0.5]
    )
