"""Handing over and back: the pilot takes over by a flight mode, a request to resume brings the watch back.

HANDOVERS=50 python -m pytest tests/exchange/test_resume.py hands over more often.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import Announce, ControlAcquired, OperatorRequest, UploadPlan, Yield
from sidelong.mission.exchange.outbox import SendMessage
from sidelong.sitl.arduplane import ArduPlaneMode
from sidelong.sitl.px4 import Px4Mode
from sidelong.sitl.settings import LinkFaults

CYCLES = int(os.environ.get("HANDOVERS", "12"))  # at least three to each mode
CIRCLING_WITHIN_S = 10.0
ON_CIRCLE_M = 20.0
_MODES = {
    "arduplane": (ArduPlaneMode.FBWA, ArduPlaneMode.LOITER, ArduPlaneMode.RTL, ArduPlaneMode.CRUISE),
    "px4": (Px4Mode.POSCTL, Px4Mode.HOLD, Px4Mode.RTL, Px4Mode.ALTCTL),
}


def phase(flight):
    return flight.core.controller.phase


def resume(flight):
    flight.put(OperatorRequest(flight.telemetry.now_s, "resume"))
    flight.take_over(flight.core.controller.snapshot().mode)


def is_circling(flight):
    """Return whether sidelong has the aircraft, and it is on the circle that it was taken over on."""
    aircraft, circle = flight.core.controller.aircraft, flight.found(ControlAcquired)[-1].circle
    off_m = math.hypot(aircraft.east_m - circle.east_m, aircraft.north_m - circle.north_m) - circle.radius_m
    return phase(flight) is Phase.WATCHING and abs(off_m) < ON_CIRCLE_M


@pytest.mark.parametrize(
    ("flavour", "guidance"), [("arduplane", "mission"), ("px4", "mission"), ("arduplane", "command")]
)
def test_the_watch_is_handed_over_and_back_again_and_again(in_the_air, flavour, guidance):
    flight, rng = in_the_air(flavour, guidance=guidance), np.random.default_rng(7)
    own = flight.autopilot.mode
    modes = [mode for mode in _MODES[flavour] if mode != own]
    for cycle in range(CYCLES):
        flight.run(rng.uniform(1.0, 8.0))
        assert phase(flight) is Phase.WATCHING, flight.found(Yield)[-1]
        flight.autopilot.set_mode(modes[cycle % len(modes)])
        assert flight.run(3.0, lambda: phase(flight) is Phase.YIELDED)
        sent = len(flight.found(SendMessage))
        flight.run(rng.uniform(0.5, 4.0))
        assert phase(flight) is Phase.YIELDED
        assert len(flight.found(SendMessage)) == sent
        resume(flight)
        assert flight.run(CIRCLING_WITHIN_S, lambda: is_circling(flight)), flight.found(Announce)[-3:]
    assert len(flight.found(Yield)) == CYCLES
    assert len(flight.found(ControlAcquired)) == CYCLES + 1
    planned = len(flight.found(UploadPlan))
    assert flight.run(40.0, lambda: len(flight.found(UploadPlan)) > planned)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_mode_alone_never_resumes(in_the_air, flavour):
    flight = in_the_air(flavour)
    flight.run(10.0)
    own = flight.autopilot.mode
    flight.autopilot.set_mode(_MODES[flavour][0])
    assert flight.run(3.0, lambda: phase(flight) is Phase.YIELDED)
    sent = len(flight.found(SendMessage))
    flight.autopilot.set_mode(own)
    flight.run(30.0)
    assert phase(flight) is Phase.YIELDED
    assert len(flight.found(SendMessage)) == sent
    resume(flight)  # the circle that is flown is taken over as it is
    assert flight.run(3.0, lambda: is_circling(flight))
    names = {one.name for one in flight.found(SendMessage)[sent:]}
    assert "MISSION_COUNT" not in names


@pytest.mark.parametrize("delay_s", [0.05, 0.3])
@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_pilot_who_changes_the_mode_during_a_resume_keeps_the_aircraft(in_the_air, flavour, delay_s):
    flight = in_the_air(flavour, faults=LinkFaults(delay_s=delay_s))
    flight.run(10.0)
    first, second = _MODES[flavour][0], _MODES[flavour][3]
    flight.autopilot.set_mode(first)
    assert flight.run(5.0, lambda: phase(flight) is Phase.YIELDED)
    flight.run(2.0)
    resume(flight)
    assert phase(flight) is Phase.WAITING
    assert flight.run(5.0, lambda: flight.autopilot.mode not in (first, second))
    flight.run(2.5 * delay_s)  # what is on its way may arrive
    flight.autopilot.set_mode(second)
    assert flight.run(10.0, lambda: phase(flight) is Phase.YIELDED)
    flight.run(20.0)
    assert (phase(flight), flight.autopilot.mode) == (Phase.YIELDED, second)


def test_a_resume_is_refused_while_the_autopilot_is_silent(in_the_air):
    flight = in_the_air("arduplane")
    flight.run(5.0)
    resume(flight)
    assert "the mission is watching" not in flight.found(Announce)[-1].text  # nothing was yielded: it goes on
    flight.autopilot.set_mode(ArduPlaneMode.FBWA)
    assert flight.run(3.0, lambda: phase(flight) is Phase.YIELDED)
    flight.lost.add("HEARTBEAT")
    flight.run(20.0)
    sent = len(flight.found(SendMessage))
    resume(flight)
    asked, refused = (one.text for one in flight.found(Announce)[-2:])
    assert asked.endswith("checked again, once this has passed: no message from the autopilot")
    assert refused == "resume refused: no message from the autopilot"
    flight.run(5.0)
    assert phase(flight) is Phase.YIELDED
    assert len(flight.found(SendMessage)) == sent
    flight.lost.clear()
    flight.run(3.0)
    resume(flight)
    assert flight.run(CIRCLING_WITHIN_S, lambda: is_circling(flight))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_replay_repeats_yields_and_resumes_to_the_last_bit(in_the_air, tmp_path, flavour):
    flight = in_the_air(flavour, faults=LinkFaults(loss=0.05, duplicate=0.05, delay_s=0.1))
    for _ in range(3):
        flight.run(20.0)
        flight.autopilot.set_mode(_MODES[flavour][0])
        assert flight.run(5.0, lambda: phase(flight) is Phase.YIELDED)
        resume(flight)
        assert flight.run(CIRCLING_WITHIN_S, lambda: phase(flight) is Phase.WATCHING)
    replay = flight.replayed(tmp_path / "journal.jsonl")
    assert replay.difference is None
    assert replay.compared > len(flight.found(Yield)) == 3
