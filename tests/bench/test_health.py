"""What the health model costs per event: python -m pytest -s tests/bench/test_health.py.

A flight at the message rates of a fast link records the calls of the model; they are repeated alone and timed.
"""

import time

from sidelong.app.simulation.kinematic import LIVE_RATES
from sidelong.estimators.tracking.payload_fit import PayloadFit
from sidelong.mission.health.health import Health, SightingsCheck
from tests.bench.size import size
from tests.faults import flight
from tests.faults.flight import FaultedFlight, Scenario

ROUNDS, DURATION_S = size(5, 1), float(size(600, 60))
MOST_US = 2.0
CALLS = {
    Health: ("received", "changes"),
    PayloadFit: ("attitude", "position", "range", "gimbal", "is_suspect"),
    SightingsCheck: ("note",),
}


def recorded(monkeypatch):
    """Return the calls of a flight's health model in their order, and the number of events."""
    calls = []

    def record(owner, name):
        method = getattr(owner, name)

        def called(self, *arguments):
            calls.append((owner, name, arguments))
            return method(self, *arguments)

        monkeypatch.setattr(owner, name, called)

    for owner, names in CALLS.items():
        for name in names:
            record(owner, name)
    monkeypatch.setattr(flight, "_RATES", LIVE_RATES)
    flown = FaultedFlight(Scenario(3, "px4", DURATION_S))
    calls.clear()
    flown.fly()
    monkeypatch.undo()
    return calls, sum(name == "received" for _, name, _ in calls)


def repeated_s(calls):
    health = Health(PayloadFit())
    owners = {Health: health, PayloadFit: health.payload, SightingsCheck: health.sightings}
    bound = [(getattr(owners[owner], name), arguments) for owner, name, arguments in calls]
    begun_s = time.thread_time()
    for call, arguments in bound:
        call(*arguments)
    taken_s = time.thread_time() - begun_s
    begun_s = time.thread_time()
    for _, _ in bound:
        pass
    return taken_s - (time.thread_time() - begun_s)


def test_the_health_model_takes_two_microseconds_per_event(monkeypatch):
    calls, events = recorded(monkeypatch)
    taken_us = min(1e6 * repeated_s(calls) for _ in range(ROUNDS)) / events
    print(f"\n{taken_us:.2f} us per event of {events}")
    assert taken_us <= MOST_US
