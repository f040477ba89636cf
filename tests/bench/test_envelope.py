"""Aircraft that do not fly as planned, of both autopilots and in fleets; their alarms, and how near they come.

    python -m pytest tests/bench/test_envelope.py -s

The cases of tests/faults/test_envelope.py with drawn numbers. FLIGHTS is how many are flown of each table; FIRST=8:
not the first eight.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink
from shapely import Point, Polygon

from sidelong.app.assembly import with_vehicle_fences
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config, LinkSection
from sidelong.app.flight.session import connected
from sidelong.app.link.stored import fences_of, read_fences
from sidelong.app.simulation.kinematic import Body
from sidelong.app.study.recorded import recorded_targets
from sidelong.mission.core.events import UploadPlan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import nearest_arc_m
from sidelong.mission.geometry.separation import circles_apart_m
from sidelong.sitl.protocol.transfer import Item
from tests.autopilot.conftest import vehicle_of  # noqa: F401  # a fixture
from tests.bench.size import numbers
from tests.faults import undisturbed
from tests.faults.test_envelope import BEGIN_S, HOME, PLANE, Flight, set_home_lower, sinks

TRACKS = Path(__file__).parents[2] / "app" / "study" / "tracks"
LEAST_M, ALARM_S, UPLOADS_ALARM_S, REGAINED_S = 80.0, 5.0, 30.0, 30.0
OFF_M, OFF_PATH_M, FLOOR_M, CEILING_M, FENCE_M = 15.0, 60.0, 60.0, 140.0, 900.0
SEPARATED_M = 45.0  # of the least separation of 50 m
ENVELOPE_KEYS = {"height", "fence", "home", "orders", "aircraft", "path"}
CIRCLE, VERTEX = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
LOST = {  # what an autopilot does not receive
    "all": None,
    "items": {"MISSION_ITEM_INT"},
    "activation": {"MISSION_SET_CURRENT", "COMMAND_LONG", "COMMAND_INT"},
}


def drawn_wind(rng, most_m_s):
    speed_m_s, from_rad = rng.uniform(0.0, most_m_s), rng.uniform(-math.pi, math.pi)
    return Wind(speed_m_s * math.sin(from_rad), speed_m_s * math.cos(from_rad))


def test_limits_that_are_not_reached_keep_the_range():
    least_m = []
    for number in numbers(40, 2, "FLIGHTS"):
        rng, autopilot = np.random.default_rng((631, number)), AUTOPILOTS[number % 2]
        bank_deg, roll_deg_s = rng.uniform(15.0, 30.0), (5.0, 5.0, 60.0, 60.0)[number % 4]
        body = Body(15.0, math.radians(bank_deg), math.radians(roll_deg_s))
        wind = drawn_wind(rng, 4.0)
        flight = Flight(autopilot, seed=number, body=body, wind=wind).fly(600.0)
        least_m.append(min(flight.range_m))
        alarm_s = flight.alarm_s("aircraft")
        print(f"\n{number} {autopilot.name}: {bank_deg:.0f} degrees at {roll_deg_s:.0f} degrees/s, wind", end=" ")
        print(f"{wind.speed_m_s:.1f} m/s: {least_m[-1]:.0f} m at the nearest, alarm after {alarm_s:.0f} s", end="")
    print(f"\n{sum(one >= LEAST_M for one in least_m)} of {len(least_m)} keep {LEAST_M:.0f} m")
    assert min(least_m) >= LEAST_M


def without(flight, kind):
    """Let the autopilot receive nothing of a kind."""
    simulated, names = flight.simulated, LOST[kind]
    if names is None:
        simulated.receive = lambda _frame: None
        return
    handle = simulated.simulated.handle
    simulated.simulated.handle = lambda station, message: (
        None if message.get_type() in names else handle(station, message)
    )


def on_its_circle(flight):
    now = flight.controller.snapshot()
    return now.coming is None and nearest_arc_m(now.plan, now.aircraft) >= now.plan.transition_m


def test_uploads_that_all_fail_raise_an_alarm_and_keep_the_circle():
    tracks, late, near = recorded_targets([TRACKS], 6.0).flown, [], []
    for number in numbers(40, 2, "FLIGHTS"):
        autopilot, track, kind = AUTOPILOTS[number % 2], tracks[number // 2 % len(tracks)], list(LOST)[number % 3]
        flight = Flight(autopilot, {"requirement": {"target_speed_max_m_s": 6.0}}, seed=number, target=track)
        flight.fly(BEGIN_S + 15.0 * (number // (2 * len(tracks))))
        while not on_its_circle(flight):
            flight.fly(1.0)
        begin_s, circle = flight.time_s, flight.controller.present.circle
        without(flight, kind)
        flight.fly(240.0)
        places_m = [track.at(second) for second in range(round(begin_s), round(flight.time_s))]
        from_m = [math.hypot(one.east_m - circle.east_m, one.north_m - circle.north_m) for one in places_m]
        held_m = min(abs(one - circle.radius_m) for one in from_m)
        least_m = min(flight.range_m[round(begin_s) :])
        orders_s = [at_s for at_s, *_ in flight.found(UploadPlan, begin_s)]
        # A single order that fails, without a wish to move after it, is no reason for an alarm.
        asked_s = min((one for one, then in pairwise(orders_s) if then - one < UPLOADS_ALARM_S), default=math.inf)
        after_s = flight.alarm_s("orders") - asked_s if asked_s < math.inf else -math.inf
        print(
            f"\n{number} {autopilot.name} {track.name}, {kind}: alarm {after_s:.0f} s after the first order,", end=" "
        )
        print(f"{least_m:.0f} m at the nearest, the circle held {held_m:.0f} m", end="")
        late += [number] * (after_s > UPLOADS_ALARM_S)
        near += [number] * (least_m < min(held_m, 100.0) - OFF_M)
    print(f"\nno alarm in {UPLOADS_ALARM_S:.0f} s: {late}; nearer than the circle held: {near}")
    assert not late
    assert not near


def sinking(flight, rng):
    sinks(flight)
    flight.craft.build = replace(flight.craft.build, climb_max_m_s=-rng.uniform(0.4, 2.5))


def climbing(flight, rng):
    flight.craft.build = replace(flight.craft.build, sink_max_m_s=-rng.uniform(0.4, 2.5))


def leaving_the_fence(flight, _rng):
    flight.craft.build = replace(flight.craft.build, turn_efficiency=0.0)


def home_moved(flight, rng):
    by_m = rng.choice((-1.0, 1.0)) * rng.uniform(12.0, 60.0)
    set_home_lower(flight.simulated.simulated, by_m)
    start = flight.simulated._start
    flight.simulated._start = replace(start, home=replace(start.home, altitude_m=start.home.altitude_m - by_m))


def stored_height_wrong(flight, rng):
    mission, by_m = flight.simulated.simulated.mission, rng.uniform(-70.0, 70.0)
    put = mission.put
    mission.put = lambda index, item, *more: put(index, replace(item, altitude_m=item.altitude_m + by_m), *more)


def bank_not_reached(flight, rng):
    limit = "FW_R_LIM" if flight.simulated._autopilot.key == "px4" else "ROLL_LIMIT_DEG"
    flight.simulated.simulated.parameters.set(limit, rng.uniform(12.0, 20.0))


BREACHES = {
    sinking: ("height",),
    climbing: ("height",),
    leaving_the_fence: ("fence",),
    home_moved: ("home",),
    stored_height_wrong: ("height", "orders"),
    bank_not_reached: ("aircraft", "path"),
}


def above_first_home_m(flight):
    return flight.craft.height_m + flight.simulated.simulated.home.altitude_m - HOME.altitude_m


def breached(flight, breach):
    """Return whether the aircraft breaches what it is to keep, by the truth."""
    craft = flight.craft
    if breach is leaving_the_fence:
        return max(abs(craft.east_m), abs(craft.north_m)) > FENCE_M + OFF_M
    if breach is bank_not_reached:
        return flight.controller.envelope.off_m > OFF_PATH_M
    return breach is home_moved or abs(above_first_home_m(flight) - 100.0) > OFF_M


def note_orders(flight, orders, _event, outputs):
    """Note at which height each plan is ordered, and whether it is to another circle than the present one."""
    sent = [one for one in outputs if isinstance(one, UploadPlan)]
    orders += [(above_first_home_m(flight), one.plan.circle != flight.controller.present.circle) for one in sent]


def test_each_breach_raises_an_alarm_and_nothing_is_commanded_below_the_floor():
    corners = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    square = [list(PLANE.latitude_longitude_deg(FENCE_M * east, FENCE_M * north)) for east, north in corners]
    configured = {"fences": {"keep_in": [square], "floor_m": FLOOR_M, "ceiling_m": CEILING_M}}
    late, low, claimed = [], [], []
    for number in numbers(48, 2, "FLIGHTS"):
        rng, autopilot = np.random.default_rng((633, number)), AUTOPILOTS[number % 2]
        breach = list(BREACHES)[number // 2 % len(BREACHES)]
        flight = Flight(autopilot, configured, seed=number, wind=drawn_wind(rng, 3.0)).fly(BEGIN_S)
        assert not {one.key for _, one in flight.raised} & ENVELOPE_KEYS
        breach(flight, rng)
        since_s, claims_s, orders = math.inf, 0.0, []
        flight.listeners.append(partial(note_orders, flight, orders))
        for _ in range(180):
            flight.fly(1.0)
            is_off = breached(flight, breach)
            since_s = min(since_s, flight.time_s) if is_off else since_s
            is_late = is_off and flight.time_s > since_s + ALARM_S and breach is not home_moved
            is_judged = is_late and flight.controller.phase.in_control  # not after a yield
            claims_s += is_judged and flight.claims[-1][1] is True
        after_s = min(map(flight.alarm_s, BREACHES[breach])) - since_s if since_s < math.inf else -math.inf
        below = [is_away for height_m, is_away in orders if height_m < FLOOR_M - 1.0]
        print(
            f"\n{number} {autopilot.name}, {breach.__name__}: breach at {since_s:.0f} s, alarm {after_s:.0f} s",
            end=" ",
        )
        print(f"later, {sum(below)} of {len(below)} orders below the floor, claimed for {claims_s:.0f} s", end="")
        late += [number] * (after_s > ALARM_S)
        low += [number] * any(below)
        claimed += [number] * (claims_s > 0.0)
    print(f"\nlate: {late}; commanded below the floor: {low}; claimed: {claimed}")
    assert not (late or low or claimed)


def drawn_fences(rng):
    """Return fence items around the first circle and near it, and their areas in the plane."""
    items, inside, outside = [], [], []
    for is_inclusion in (True, *(rng.random(rng.integers(1, 4)) < 0.3)):
        reach_m = rng.uniform(700.0, 1200.0) if is_inclusion else rng.uniform(60.0, 250.0)
        middle_m = rng.uniform(-150.0, 150.0, 2) if is_inclusion else rng.uniform(-700.0, 700.0, 2)
        if not is_inclusion and math.dist(middle_m, (-300.0, 0.0)) < reach_m + 120.0:
            continue
        is_circle = rng.random() < 0.5
        angles_rad = np.sort(rng.uniform(0.0, 0.4, 6)) + np.arange(6) * math.pi / 3.0
        corners_m = [middle_m + reach_m * np.array((math.sin(one), math.cos(one))) for one in angles_rad]
        area = Point(middle_m).buffer(reach_m) if is_circle else Polygon(corners_m)
        (inside if is_inclusion else outside).append(area)
        for corner_m in [middle_m] if is_circle else corners_m:
            x, y = (round(1e7 * degrees) for degrees in PLANE.latitude_longitude_deg(*corner_m))
            command = (CIRCLE if is_circle else VERTEX) + (not is_inclusion)
            items.append({"command": command, "param1": reach_m if is_circle else 6.0, "x": x, "y": y})
    return items, inside, outside


@pytest.mark.udp
@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_fences_of_the_vehicle_are_read(vehicle_of, flavour):  # noqa: F811
    """Over a socket and MAVSDK; what they say is compared below, by never being crossed."""
    vehicle, wrong, flown = vehicle_of(flavour, speed=1.0), [], numbers(100, 2, "FLIGHTS")[flavour == "px4" :: 2]

    def stored(items):
        store = vehicle.autopilot.transfers[mavlink.MAV_MISSION_TYPE_FENCE].store
        store.begin(len(items))
        for index, item in enumerate(items):
            size = (item["param1"], 0.0, 0.0, 0.0)
            store.put(index, Item(item["command"], mavlink.MAV_FRAME_GLOBAL, size, item["x"], item["y"], 0.0), False)
        store.finish()

    async def read():
        async with connected(LinkSection(url=vehicle.url, role="companion"), lambda _text: None) as session:
            for number in flown:
                items, *_ = drawn_fences(np.random.default_rng((635, number)))
                await asyncio.to_thread(vehicle.do, lambda items=items: stored(items))
                found, right = await read_fences(session.vehicle), fences_of(items)
                agrees = [np.allclose(*pair, atol=1e-6) for pair in zip(flat(found), flat(right), strict=True)]
                wrong.extend([number] * (not agrees or not all(agrees)))

    def flat(fences):
        return (*fences.inclusion, *fences.exclusion)

    asyncio.run(read())
    print(f"\n{flavour}: read wrongly: {wrong} of {len(flown)}")
    assert not wrong


def test_fences_of_the_vehicle_are_never_crossed():
    crossed, moved = [], 0
    for number in numbers(100, 2, "FLIGHTS"):
        rng = np.random.default_rng((635, number))
        items, inside, outside = drawn_fences(rng)
        fences = with_vehicle_fences(Config(), fences_of(items), every=True).fences
        flight = Flight(AUTOPILOTS[number % 2], {"fences": fences.model_dump()}, seed=number)
        for _ in range(300):
            flight.fly(1.0)
            here = Point(flight.craft.east_m, flight.craft.north_m)
            if not all(map(here.within, inside)) or any(map(here.within, outside)):
                crossed.append(number)
                break
        moved += flight.controller.snapshot().moves
    print(f"\ncrossed in {crossed}, {moved} moves")
    assert not crossed


def apart(crafts):
    """Return whether each pair is separated, by height or by the circles that they fly."""
    vehicles = [one.simulation.vehicle for one in crafts]
    above_m = [one.craft.height_m + one.home.altitude_m for one in vehicles]
    circles = [one.core.controller.present.circle for one in crafts]
    return all(
        abs(above_m[a] - above_m[b]) >= SEPARATED_M or circles_apart_m(circles[a], circles[b]) >= SEPARATED_M
        for a in range(len(crafts))
        for b in range(a)
    )


def test_fleets_regain_their_separation():
    longest = {}
    for number in numbers(12, 1, "FLIGHTS"):
        rng = np.random.default_rng((634, number))
        described = undisturbed.Flown(number, "fleet")
        crafts, advance = undisturbed._fleet(undisturbed._settings(number, np.random.default_rng(number)), described)
        for _ in undisturbed._until(crafts, advance, 400.0):
            if all(one.has_control for one in crafts) and apart(crafts):
                break
        for _ in undisturbed._until(crafts, advance, 40.0):
            pass
        upper = max(crafts, key=lambda one: one.simulation.vehicle.craft.height_m).simulation.vehicle
        breach = ("home lower", "home higher", "sinks")[number % 3]
        if breach == "sinks":
            build = upper.craft.build
            upper.craft.build = replace(build, climb_max_m_s=-rng.uniform(0.5, 1.5))
        else:
            set_home_lower(upper, (1.0 if breach == "home lower" else -1.0) * rng.uniform(20.0, 60.0))
        spells, steps = [0.0], 0
        for step, _ in enumerate(undisturbed._until(crafts, advance, 120.0)):
            if breach == "sinks" and upper.craft.build is not build and upper.craft.height_m < 70.0:
                upper.craft.build = build
            if step % 20 == 0:
                steps += 1
                spells.append(0.0 if apart(crafts) else spells[-1] + 1.0)
        longest[number] = max(spells) * 120.0 / steps
        print(
            f"\n{number} {len(crafts)} aircraft, {breach}: not separated for {longest[number]:.0f} s at most", end=""
        )
    print()
    assert max(longest.values()) <= REGAINED_S
