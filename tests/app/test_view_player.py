"""A replay on the page: frames of a flight, and a player whose clock the test moves."""

from __future__ import annotations

from unittest.mock import Mock

import pytest

from sidelong.app.analysis.replay import Proposals, Replayed
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.view.frames import Frames, Player
from sidelong.app.view.server import replay_button_of
from sidelong.app.view.state import StateEncoder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import ControlAcquired

PLANE = LocalPlane(47.4, 8.5)


@pytest.fixture(scope="module")
def steps(flight):
    return [
        Replayed(event, commands, controller.estimate, Mock(return_value=controller.snapshot()))
        for event, commands, controller in flight(150.0)
    ]


@pytest.fixture(scope="module")
def frames(steps):
    found = Frames(plane=PLANE)
    assert len(list(found.noted(steps, StateEncoder(15.0, 100.0)))) == len(steps)
    return found


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def test_frames_are_a_fifth_of_a_second_apart_and_decisions_are_known(frames):
    begin_s, end_s = frames.times_s[0], frames.times_s[-1]
    assert len(frames.times_s) == pytest.approx((end_s - begin_s) * 5.0, abs=2)
    assert len(frames.decided_s) >= 1
    assert all(begin_s <= time_s <= end_s for time_s in frames.decided_s)


def test_times_count_from_when_watching_began(steps, frames):
    (acquired_s,) = [step.event.time_s for step in steps if isinstance(step.event, ControlAcquired)]
    assert frames.start_s == acquired_s
    log = Frames(plane=PLANE)
    list(
        log.noted((step for step in steps if not isinstance(step.event, ControlAcquired)), StateEncoder(15.0, 100.0))
    )
    assert log.start_s == next(step.snapshot().time_s for step in steps if step.snapshot().estimate is not None)


def test_it_plays_at_its_speed_and_reports_only_what_came(frames, clock):
    player = Player(frames, 10.0, clock)
    first = player.update()
    assert first["restart"]
    clock.now_s += 1.0
    second = player.update()
    assert second["replay"]["at_s"] == pytest.approx(first["replay"]["at_s"] + 10.0)
    assert "restart" not in second
    assert len(second["trail"]) == pytest.approx(50, abs=1)


def test_paused_it_stands_and_a_seek_begins_again(frames, clock):
    player = Player(frames, 10.0, clock)
    player.update()
    player.pressed({"action": "pause", "value": None})
    clock.now_s += 5.0
    player.pressed({"action": "seek", "value": 200.0})
    update = player.update()
    assert (update["replay"]["playing"], update["replay"]["at_s"], update["restart"]) == (False, 200.0, True)
    assert update["state"]["time_s"] == pytest.approx(200.0, abs=0.2)
    assert max(time_s for time_s, *_ in update["trail"]) <= 200.0
    assert all(time_s is None or time_s <= 200.0 for time_s, *_ in update["announcements"])


def test_it_steps_from_decision_to_decision(frames, clock):
    player = Player(frames, 10.0, clock)
    player.pressed({"action": "step", "value": 1})
    update = player.update()
    assert update["replay"] == {"playing": False, "speed": 10.0, "at_s": pytest.approx(frames.decided_s[0], abs=0.01)}
    player.pressed({"action": "step", "value": -1})  # there is none before
    assert player.update()["replay"]["at_s"] == pytest.approx(frames.decided_s[0], abs=0.01)


def test_at_the_end_it_stops_and_play_begins_again(frames, clock):
    player = Player(frames, 1000.0, clock)
    clock.now_s += 10.0
    assert player.update()["replay"]["playing"] is False
    player.pressed({"action": "play", "value": None})
    assert player.update()["replay"]["at_s"] == frames.times_s[0]


def test_what_would_have_been_decided_otherwise_is_reported_next_to_it(frames, steps, clock, config):
    other = Config.model_validate({"planner": {"name": "paper"}, "requirement": {"side": "right"}})
    controller = prepared(other).controller(PLANE, (47.4, 8.5))
    what_if = Frames(plane=PLANE)
    events = (step.event for step in steps)
    assert list(what_if.noted(Proposals(controller).follow(events), StateEncoder(15.0, 100.0), proposals=True))
    assert controller.snapshot().side == "right"
    player = Player(frames, 10.0, clock, what_if)
    player.pressed({"action": "seek", "value": 249.0})
    update = player.update()
    assert update["state"]["side"] == "left"
    assert update["state"]["what_if"]["side"] == "right"
    texts = [text for _, kind, text in update["announcements"] if kind == "what-if"]
    assert texts
    assert all(text.startswith("what if: ") for text in texts)


@pytest.mark.parametrize(
    "press",
    [
        {"action": "hold"},
        {"action": "end"},
        {"action": "change", "values": {"radius_m": 80}},
        {"action": "seek"},
        {"action": "seek", "value": "12"},
        {"action": "seek", "value": float("nan")},
        {"action": "speed", "value": True},
        {"action": "play", "value": 1},
    ],
)
def test_no_button_of_a_flight_is_known_there(press):
    with pytest.raises(ValueError):
        replay_button_of(press)
