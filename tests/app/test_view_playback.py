"""A replay shown at a chosen speed."""

from __future__ import annotations

import pytest

from app.analysis.replay import Replayed
from app.view.playback import Playback
from estimators.frames import LocalPlane
from mission.control.controller import Phase
from mission.core.events import OperatorRequest

PLANE = LocalPlane(47.4, 8.5)


class Listener:
    """A display that notes what it is told."""

    def __init__(self) -> None:
        self.shown, self.said, self.began, self.engaged = [], [], [], []

    def begin(self, plane, request):
        self.began.append((plane, request))

    def engage(self, start_s, duration_s):
        self.engaged.append(start_s)

    def note(self, text):
        self.said.append(text)

    def say(self, announcement):
        self.said.append(announcement.text)

    def show(self, snapshot):
        self.shown.append(snapshot)


class Clock:
    """A wall clock that moves only by sleeping."""

    now_s = 1000.0
    idled = 0

    def __call__(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s

    def idle(self):
        self.idled += 1


@pytest.fixture
def steps(flight):
    return [Replayed(event, commands, controller.snapshot()) for event, commands, controller in flight(20.0)]


def played(steps, speed, controller=None):
    display, clock = Listener(), Clock()
    playback = Playback(display, controller, lambda: PLANE, speed, clock.idle, clock, clock.sleep)
    assert list(playback.shown(steps)) == steps
    return display, clock


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_a_replay_takes_its_time(steps, speed):
    display, clock = played(steps, speed)
    assert clock.now_s - 1000.0 == pytest.approx(19.9 / speed, abs=0.01)
    assert clock.idled > 19.9 / speed / 0.06
    assert len(display.shown) == len(steps)


def test_as_fast_as_it_goes_never_waits(steps):
    assert played(steps, 0.0)[1].now_s == 1000.0


def test_a_gap_in_the_recording_is_not_waited_for(steps):
    half = len(steps) // 2
    later = steps[: half // 4] + steps[-half // 4 :]
    assert played(later, 1.0)[1].now_s - 1000.0 < 6.0


def test_the_display_is_begun_and_engaged_once(steps):
    display, _ = played(steps, 0.0)
    assert [plane for plane, _ in display.began] == [PLANE]
    first = next(step.snapshot.time_s for step in steps if step.snapshot.estimate is not None)
    assert display.engaged == [first]


def test_words_are_passed_on_and_buttons_reach_the_step(flight):
    *_, (_, _, controller) = flight(20.0)
    display, _ = played([], 0.0, controller)
    steps = [Replayed(None, (), controller.snapshot())]
    display, _ = played(steps, 0.0, controller)
    ((_, press),) = display.began
    press(OperatorRequest(controller.time_s, "hold"))
    assert controller.phase is Phase.HOLDING
    assert display.said == ["operator: hold"]
