"""Swaps over links with faults: how long they take, and whether the vehicle ever holds anything but one of two plans.

python -m pytest tests/bench/test_swaps.py -s -n 6; SWAPS=50 sets how many, at most 10 minutes each.
"""

from __future__ import annotations

import asyncio
import math
import os
import random
import statistics
import subprocess
import sys
import time

import pytest

from app.autopilots.autopilot import same_items
from app.autopilots.queries import home_of
from app.delivery.guidance import SwapError
from app.delivery.mission_guidance import MissionItemBackend
from app.flight.flight import connected
from app.flight.preflight import ask_for_streams
from app.flight.simulated import free_udp_port
from app.link.link import RawItem, UploadResult
from mission.core.circle import Circle
from mission.core.events import UploadPlan
from mission.core.plan import AircraftState, Plan
from mission.core.requirement import Wind
from mission.geometry.approach import turn_straight_turn
from mission.upload.items import NAV_LOITER_UNLIM

SWAPS = int(os.environ.get("SWAPS", "10"))
BOUND_S = 600.0
RADIUS_M, SPEED_M_S, TAKE_OFF = 50.0, 15.0, 22


async def swapped(url):
    """Make swaps; return (durations of the good ones, failures, mixtures)."""
    rng = random.Random(1)
    async with connected([url], 30.0) as session:
        vehicle, telemetry = session.vehicle, session.telemetry
        vehicle.listeners.append(telemetry.event)
        await ask_for_streams(vehicle)
        while (home := await home_of(vehicle)) is None or telemetry.plane is None:
            await asyncio.sleep(0.5)
        guidance = MissionItemBackend(
            *(vehicle, session.autopilot, telemetry.plane, home),
            **{"airspeed_m_s": SPEED_M_S, "height_m": 100.0, "tolerance_m": 15.0, "now_s": lambda: telemetry.now_s},
        )
        here = Circle(0.0, 0.0, RADIUS_M, True)
        place = round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7)
        lead_in = (RawItem(TAKE_OFF, 3, 15.0, 0.0, 0.0, math.nan, *place, 50.0),)
        while await guidance.load(guidance.line(Plan(here)), lead_in) is not UploadResult.ACCEPTED:
            pass
        while not (await session.autopilot.arm(vehicle)).accepted:
            await asyncio.sleep(1.0)
        while not (await session.autopilot.start_mission(vehicle)).accepted:
            await asyncio.sleep(0.5)
        while vehicle.latest["GLOBAL_POSITION_INT"].fields["relative_alt"] < 70_000:
            await asyncio.sleep(0.2)
        durations_s, failures, mixtures = [], [], 0
        deadline_s = time.monotonic() + BOUND_S
        for number in range(1, SWAPS + 1):
            if time.monotonic() > deadline_s:
                break
            there = Circle(rng.uniform(-300.0, 300.0), rng.uniform(-300.0, 300.0), RADIUS_M, True)
            fields = vehicle.latest["GLOBAL_POSITION_INT"].fields
            east_m, north_m = telemetry.plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
            course_rad = math.atan2(fields["vy"], fields["vx"])
            state = AircraftState(telemetry.now_s, east_m, north_m, course_rad, SPEED_M_S, 1.0 / RADIUS_M)
            plan = Plan(there, turn_straight_turn(state, there, RADIUS_M), telemetry.now_s + 3.0)
            begin_s = time.monotonic()
            try:
                await guidance.prepare(UploadPlan(telemetry.now_s, number, plan, there, Plan(here), Wind(), ""))
                ready_s = time.monotonic()
                await guidance.depart(number)
            except SwapError as error:
                failures.append(str(error))
            else:
                durations_s.append((ready_s - begin_s, time.monotonic() - ready_s))
                here = there
            while (held := await session.autopilot.stored(vehicle)) is None:
                pass
            await asyncio.sleep(0.3)
            while (told := await vehicle.wait_for(lambda message: message.name == "MISSION_CURRENT", 3.0)) is None:
                pass
            mixtures += not flies_one_of(held, told.fields["seq"], guidance)
        return durations_s, failures, mixtures


def flies_one_of(held, index, guidance):
    """Tell whether the rest of the present line is flown, or that of one which was set current unheard."""
    circle = next((i for i in range(index, len(held)) if held[i].command == NAV_LOITER_UNLIM), len(held))
    flown = held[index : circle + 1]
    slots = [guidance._slots, *([guidance._next.slots] if guidance._next is not None else [])]
    return bool(flown) and any(same_items(one.line()[-len(flown) :], flown) for one in slots)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize(("loss", "round_trip_ms", "goal_s"), [(0.0, 0.0, 0.5), (0.05, 50.0, 2.0), (0.2, 50.0, None)])
def test_swaps(flavour, loss, round_trip_ms, goal_s):
    port = free_udp_port()
    options = ["--autopilot", flavour, "--to", f"127.0.0.1:{port}", "--loss", loss, "--delay-ms", round_trip_ms / 2.0]
    vehicle = subprocess.Popen([sys.executable, "-m", "sitl", *map(str, options)], stdout=subprocess.DEVNULL)
    try:
        durations_s, failures, mixtures = asyncio.run(swapped(f"udpin://127.0.0.1:{port}"))
    finally:
        vehicle.terminate()
        vehicle.wait(10.0)
    uploads_s, switches_s = ([pair[i] for pair in durations_s] for i in (0, 1))
    whole_s = statistics.median(map(sum, durations_s))
    print(
        f"\n{flavour:9} loss {loss:4.0%} round trip {round_trip_ms:3.0f} ms: "
        f"{len(durations_s)} swaps of {len(durations_s) + len(failures)}, {mixtures} mixed; "
        f"median {whole_s:.2f} s (upload {statistics.median(uploads_s):.2f}, "
        f"at most {max(uploads_s):.2f}; switch {statistics.median(switches_s):.2f}, at most {max(switches_s):.2f})"
        f" {sorted(set(failures))}"
    )
    assert mixtures == 0
    if goal_s is not None:
        assert not failures
        assert whole_s <= goal_s
