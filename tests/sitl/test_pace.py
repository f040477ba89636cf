"""A simulation waits for the program that flies its vehicle."""

import math
import signal
import threading
from types import SimpleNamespace

import pytest

from sidelong.sitl.cli import run
from sidelong.sitl.server import Pace


def test_it_waits_for_whoever_is_behind_but_not_for_whoever_is_silent():
    pace = Pace(speed=20.0)
    assert pace.limit_s(0.0) == math.inf
    pace.follow(100.0, now_s=5.0)
    assert pace.limit_s(6.0) == pytest.approx(100.7)
    pace.follow(101.0, now_s=6.5)
    assert pace.limit_s(8.0) == pytest.approx(101.7)
    assert pace.limit_s(9.0) == math.inf
    fast = Pace(speed=1000.0)  # what the machine cannot hold makes no answer later
    fast.follow(100.0, now_s=5.0)
    assert fast.limit_s(5.0) == 100.75


def test_a_simulation_goes_no_further_than_its_program_has_come(tmp_path, monkeypatch):
    now_s, truth = 0.0, tmp_path / "truth.csv"
    followed, ended = threading.Event(), threading.Event()
    reads = iter((lambda: b"0.5\n1.0\n", lambda: followed.set() or (ended.wait(60.0) and b"")))

    def wait(_read, _write, _exceptional, wake_s):
        nonlocal now_s
        assert followed.wait(60.0)
        if now_s > 1.5:  # at 50 times the speed that is 75 s of the vehicle, of which its program has seen one
            ended.set()
        else:
            now_s += wake_s
        return [], [], []

    monkeypatch.setattr("sidelong.sitl.cli.os.read", lambda *_: next(reads)())
    for module in ("cli", "server"):
        clock = SimpleNamespace(monotonic=lambda: now_s, time=lambda: 1.7e9)
        monkeypatch.setattr(f"sidelong.sitl.{module}.time", clock)
    monkeypatch.setattr("sidelong.sitl.server.select", SimpleNamespace(select=wait))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        run(to=["127.0.0.1:9"], speed=50.0, while_input=True, truth=[truth])
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    reached_s = float(truth.read_text().splitlines()[-1].split(",")[0])
    assert 1.0 < reached_s < 2.0
