"""The alarms of a flight: what reaches the journal, the displays and the ground station."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.flight import AlarmWatch
from sidelong.mission.control.present import Phase, Present, VehicleStatus
from sidelong.mission.core.events import AlarmReported, BatteryReported, ControlAcquired, End

GOOD = VehicleStatus(80, 12.0, "3D, 11 satellites", True, 99, 0.05)


class Rig:
    """A watch with a wall clock that is set by hand."""

    def __init__(self, config: Config | None = None) -> None:
        self.status, self.wall_s = GOOD, 0.0
        self.events: list = []
        self.texts: list[str] = []
        self.watch = AlarmWatch(
            config or Config(),
            (0.0, 0.0),
            lambda: self.status,
            self.events.append,
            self.texts.append,
            lambda: self.wall_s,
        )

    def show(self, snapshot) -> Present:
        self.wall_s += 1.0
        return self.watch.completed(snapshot)

    def alarms(self, stage):
        return [one.key for one in self.events if isinstance(one, AlarmReported) and one.stage == stage]


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture(scope="module")
def last(flight):
    for _, _, controller in flight(60.0):
        end = controller
    return end.snapshot()


def test_a_flight_without_faults_has_no_alarm(flight, rig):
    for _, _, controller in flight(250.0):
        rig.show(controller.snapshot())
    assert rig.events == []
    assert rig.texts == []


def test_a_lost_target_is_raised_sent_and_cleared(rig, last):
    rig.show(last)
    for second in range(1, 60):
        rig.show(replace(last, time_s=last.time_s + second))
    assert rig.alarms("raised") == ["target"]
    raised = next(one for one in rig.events if one.key == "target")
    assert 9.0 <= raised.time_s - last.time_s <= 15.0
    assert "point the camera at the target" in raised.text
    assert rig.texts
    assert all(text.startswith("sidelong: ") for text in rig.texts)
    back_s = last.time_s + 61.0
    seen = replace(last.estimate, time_s=back_s, last_sighting_s=back_s)
    for second in range(6):
        estimate = replace(seen, last_sighting_s=back_s + second)
        rig.show(replace(last, time_s=back_s + second, estimate=estimate))
    assert set(rig.alarms("cleared")) == set(rig.alarms("raised"))


def test_texts_to_the_ground_station_are_rate_limited(rig, last):
    rig.show(last)
    for tick in range(1, 200):
        rig.show(replace(last, time_s=last.time_s + 0.1 * tick))
    assert len(rig.texts) <= 1 + 20.0 / 5.0


def test_after_a_yield_nothing_is_sent(rig, last):
    rig.show(last)
    yielded = replace(last, time_s=last.time_s + 1.0, phase=Phase.YIELDED, over="the flight mode was changed to RTL")
    rig.show(yielded)
    assert rig.alarms("raised") == ["yield"]
    assert "resume to let sidelong watch on" in rig.events[-1].text
    assert rig.texts == []


def test_an_acknowledgement_is_recorded_once(rig, last):
    rig.show(last)
    rig.show(replace(last, time_s=last.time_s + 1.0, phase=Phase.YIELDED, over="RTL"))
    wish = AlarmReported(last.time_s, "yield", "acknowledged", who="operator")
    rig.watch.acknowledge(wish)
    rig.watch.acknowledge(wish)
    assert rig.events.count(wish) == 1
    assert rig.watch.status.alarms[0].acknowledged


def test_a_silent_link_is_an_alarm_although_the_vehicle_s_clock_stands(rig, last):
    rig.show(last)
    rig.wall_s += 3.0
    rig.show(replace(last, connected=False))
    assert rig.alarms("raised") == ["link"]
    assert "nothing received from the aircraft for 4 s" in rig.events[-1].text
    rig.show(replace(last, time_s=last.time_s + 9.0))
    assert "link" in rig.alarms("cleared")


def test_the_battery_is_reported_and_shown_with_the_flight_home(rig, last):
    for second in range(400):
        rig.status = replace(GOOD, battery_percent=80 - second // 60)
        estimate = replace(last.estimate, last_sighting_s=last.time_s + second)
        rig.show(replace(last, time_s=last.time_s + second, estimate=estimate))
    reported = [one for one in rig.events if isinstance(one, BatteryReported)]
    assert reported[-1].left_s == pytest.approx((74.0 - 20.0) * 60.0, rel=0.05)
    assert reported[-1].home_s == pytest.approx(250.0 / 15.0, rel=0.5)
    shown = rig.watch.status
    assert (shown.endurance_s, shown.home_s) == (rig.watch.left_s, rig.watch.home_s)


def test_a_low_battery_is_reported_at_once_and_again(rig, last):
    low_s = []
    for second in range(400):
        rig.status = replace(GOOD, battery_percent=40 - second // 20)
        time_s = last.time_s + second
        rig.show(replace(last, time_s=time_s, estimate=replace(last.estimate, last_sighting_s=time_s)))
        if rig.watch.left_s is not None and rig.watch.left_s <= 1.2 * rig.watch.home_s:
            low_s.append(time_s)
    reported_s = [one.time_s for one in rig.events if isinstance(one, BatteryReported)]
    assert len(low_s) > 3
    assert [one for one in reported_s if one >= low_s[0]] == low_s


@pytest.mark.parametrize(("action", "ends"), [("return", True), ("warn", False)])
def test_a_low_battery_ends_the_watch_as_configured(action, ends, snapshot):
    config = Config.model_validate({"planner": {"name": "paper", "at_low_battery": action}})
    controller = prepared(config).controller()
    controller.step(ControlAcquired(100.0, snapshot.plan.circle, "AUTO"))
    announced = [controller.step(BatteryReported(101.0 + k, 22.0, 70.0, 60.0)) for k in range(11)]
    assert announced[:10] == [()] * 10  # reports of less than ten seconds are not enough
    ended = [one for step in announced for one in step if isinstance(one, End)]
    assert [one.action for one in ended] == (["return"] if ends else [])
    assert controller.phase is (Phase.ENDED if ends else Phase.WATCHING)


def test_a_battery_with_enough_left_ends_nothing(snapshot):
    controller = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()
    controller.step(ControlAcquired(100.0, snapshot.plan.circle, "AUTO"))
    for k in range(50):
        left_s = 70.0 if k % 9 else 73.0  # 120 % of the flight home, now and then
        assert controller.step(BatteryReported(101.0 + k, 22.0, left_s, 60.0)) == ()


def test_a_rejected_charge_ends_nothing(snapshot):
    controller = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()
    controller.step(ControlAcquired(100.0, snapshot.plan.circle, "AUTO"))
    for k in range(50):
        assert controller.step(BatteryReported(101.0 + k, 3.0, 0.0, 60.0, rejected=True)) == ()


@pytest.mark.parametrize("lasts_s", [3, 20])
def test_a_battery_that_dips_is_an_alarm_and_ends_no_watch(rig, last, lasts_s):
    controller = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()
    controller.step(ControlAcquired(last.time_s, last.plan.circle, "AUTO"))
    for second in range(600):
        dips = 400 <= second < 400 + lasts_s
        rig.status = replace(GOOD, battery_percent=3 if dips else 80 - second // 60)
        time_s = last.time_s + second
        rig.show(replace(last, time_s=time_s, estimate=replace(last.estimate, last_sighting_s=time_s)))
    assert set(rig.alarms("raised")) - {"band"} == {"charge"}
    assert "charge" in rig.alarms("cleared")
    for event in rig.events:
        assert not any(isinstance(one, End) for one in controller.step(event))


def test_the_end_of_a_battery_states_all_that_is_known(rig, last):
    for second in range(400):
        time_s, percent = last.time_s + second, 100.0 - second * 0.2
        rig.status = replace(
            GOOD, battery_percent=int(percent), battery_v=12.6 * (0.8 + 0.002 * percent), battery_a=20.0
        )
        rig.show(replace(last, time_s=time_s, estimate=replace(last.estimate, last_sighting_s=time_s)))
    text = next(one.text for one in rig.events if isinstance(one, BatteryReported) and one.text)
    assert re.fullmatch(
        r"the battery is ending: \d+ % left, \d+ % above the reserve of 20 %; "
        r"about \d+ s at 20 A; home is \d+ s away",
        text,
    )


def test_an_alarm_of_the_journal_is_announced_in_the_replay(snapshot):
    controller = prepared(Config.model_validate({"planner": {"name": "paper"}})).controller()
    (announced,) = controller.step(AlarmReported(1.0, "laser", "raised", "no range from the laser for 5 s: check it"))
    assert (announced.kind, announced.text) == ("alarm", "alarm: no range from the laser for 5 s: check it")
    (announced,) = controller.step(AlarmReported(2.0, "laser", "cleared", "no range from the laser for 6 s"))
    assert announced.kind == "clear"
