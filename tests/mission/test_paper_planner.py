"""The paper's planner in a kinematic simulation: the aircraft is exactly on its plan unless a test disturbs it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.geometry.progress import STILL_AIR
from sidelong.mission.paper.planner import PaperPlanner
from sidelong.mission.paper.scope import largest_psi_c_rad
from sidelong.mission.viewpoint.watch_course import watching_from
from tests.plan_track import PlanTrack

Motion = Callable[[float], tuple[float, float, float, float]]  # east, north and their rates at a time

PAPER_AIRCRAFT = Aircraft(airspeed_m_s=10.0, radius_m=50.0)


@dataclass
class Flight:
    ranges_m: list[float] = field(default_factory=list)
    places_m: list[tuple[float, float]] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)

    @property
    def moves(self) -> list[Decision]:
        return [decision for decision in self.decisions if decision.plan is not None]

    @property
    def time_in_band(self) -> float:
        return float(np.mean([100.0 <= range_m <= 500.0 for range_m in self.ranges_m]))


def drive(course_rad: float, speed_m_s: float, start_m: tuple[float, float] = (0.0, 0.0)) -> Motion:
    east_m_s, north_m_s = speed_m_s * math.sin(course_rad), speed_m_s * math.cos(course_rad)
    return lambda time_s: (start_m[0] + east_m_s * time_s, start_m[1] + north_m_s * time_s, east_m_s, north_m_s)


def walk(seed: int, speed_max_m_s: float, duration_s: float) -> Motion:
    """Legs of 40 to 200 s, a third of them standing, with turns up to 180 degrees between them."""
    rng = np.random.default_rng(seed)
    begins_s, legs = [], []
    time_s, east_m, north_m, course_rad = 0.0, 0.0, 0.0, float(rng.uniform(-math.pi, math.pi))
    while time_s <= duration_s:
        leg_s = float(rng.uniform(40.0, 200.0))
        speed_m_s = float(rng.choice([0.0, rng.uniform(1.0, speed_max_m_s), speed_max_m_s]))
        motion = drive(course_rad, speed_m_s, (east_m, north_m))
        begins_s.append(time_s)
        legs.append(motion)
        east_m, north_m, *_ = motion(leg_s)
        time_s += leg_s
        turns_deg, chances = (-90, -45, -20, 0, 20, 45, 90, 180), (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)
        course_rad += math.radians(float(rng.choice(turns_deg, p=chances)))

    def motion_at(time_s: float) -> tuple[float, float, float, float]:
        leg = int(np.searchsorted(begins_s, time_s, side="right")) - 1
        return legs[leg](time_s - begins_s[leg])

    return motion_at


def fly(
    planner: PaperPlanner,
    motion: Motion,
    circle: Circle,
    start_course_rad: float,
    aircraft: Aircraft,
    duration_s: float,
    *,
    wind: Wind = STILL_AIR,
    latency_s: float = 0.0,
    radius_error: float = 0.0,
    noise_seed: int | None = None,
    uploads: Callable[[int], bool] = lambda number: True,
) -> Flight:
    """Decide once a second, look twice a second. ``uploads`` reports which proposed plans the autopilot takes."""
    rng = np.random.default_rng(noise_seed)
    plan, flight = Plan(circle), Flight()
    east_m, north_m = circle.position_at_course(start_course_rad)
    start = AircraftState(0.0, east_m, north_m, start_course_rad, aircraft.airspeed_m_s, circle.curvature_per_m)
    track = PlanTrack(plan, start, aircraft.airspeed_m_s, wind)
    for step in range(int(2 * duration_s) + 1):
        time_s = step / 2.0
        state = track.state_at(time_s)
        state = replace(
            state,
            east_m=state.east_m + radius_error * (state.east_m - plan.circle.east_m),
            north_m=state.north_m + radius_error * (state.north_m - plan.circle.north_m),
        )
        target = motion(time_s)
        flight.ranges_m.append(math.hypot(state.east_m - target[0], state.north_m - target[1]))
        flight.places_m.append((state.east_m, state.north_m))
        if step % 2 or time_s < plan.departure_s:
            continue
        sigma = np.full(4, 1e-9) if noise_seed is None else np.array([3.0, 3.0, 0.2, 0.2])
        noise = np.zeros(4) if noise_seed is None else rng.normal(0.0, sigma)
        east_m, north_m, east_m_s, north_m_s = (float(value) for value in np.asarray(target) + noise)
        estimate = TargetEstimate(
            time_s, east_m, north_m, east_m_s, north_m_s, np.diag(sigma**2), TrackQuality.GOOD, time_s
        )
        decision = planner.decide(state, estimate, plan, wind, latency_s)
        flight.decisions.append(decision)
        if decision.plan is not None and uploads(len(flight.moves)):
            plan = decision.plan
            track = PlanTrack(plan, track.state_at(plan.departure_s), aircraft.airspeed_m_s, wind, before=track)
    return flight


def fly_the_papers_example(threshold: float) -> Flight:
    """A target that drives straight east at 3 m/s from the origin; the aircraft starts at (0, 100) m."""
    planner = PaperPlanner(PAPER_AIRCRAFT, Requirement(100.0, 500.0, Side.LEFT, 3.0, threshold))
    circle = Circle(0.0, 150.0, 50.0, True)
    return fly(planner, drive(math.pi / 2, 3.0), circle, -math.pi / 2, PAPER_AIRCRAFT, 1500.0)


@pytest.mark.parametrize(("one", "other"), [(0.8, 0.9), (1.0, 1.1)])
def test_thresholds_whose_paths_coincide(one: float, other: float) -> None:
    assert fly_the_papers_example(one).places_m == fly_the_papers_example(other).places_m


@pytest.mark.parametrize(("one", "other"), [(0.9, 1.0), (1.1, 1.2)])
def test_thresholds_whose_paths_differ(one: float, other: float) -> None:
    places_m = np.array([fly_the_papers_example(threshold).places_m for threshold in (one, other)])
    assert np.max(np.abs(places_m[0] - places_m[1])) > 100.0


@pytest.mark.parametrize(("threshold", "max_m"), [(0.8, 467.0), (1.0, 504.0), (1.2, 601.0)])
def test_the_range_in_the_papers_example(threshold: float, max_m: float) -> None:
    """The printed figures carry the step of the simulation they came from, half a second of target travel."""
    flight = fly_the_papers_example(threshold)
    assert min(flight.ranges_m) == pytest.approx(100.0, abs=0.01)
    assert max(flight.ranges_m) == pytest.approx(max_m, abs=2.5)


def test_a_small_threshold_is_refused_for_want_of_room() -> None:
    """283.8 m of the 284.3 m needed where time goes in steps of 0.2 s; without steps 1 cm is short at first."""
    refused = [d for d in fly_the_papers_example(0.8).decisions if "shorter" in d.reason]
    assert refused[0].values["move_east_m"] == pytest.approx(283.8, abs=0.6)
    assert refused[0].values["move_east_m"] < refused[0].values["min_move_m"] == pytest.approx(284.306, abs=1e-3)
    assert "another lap" in refused[0].reason


def test_the_example_on_the_right_is_the_mirror_image() -> None:
    planner = PaperPlanner(PAPER_AIRCRAFT, Requirement(100.0, 500.0, Side.RIGHT, 3.0, 1.0))
    circle = Circle(0.0, -150.0, 50.0, False)
    right = fly(planner, drive(math.pi / 2, 3.0), circle, -math.pi / 2, PAPER_AIRCRAFT, 600.0)
    left = fly_the_papers_example(1.0)
    mirrored = [(east_m, -north_m) for east_m, north_m in right.places_m]
    assert np.allclose(mirrored, left.places_m[: len(mirrored)], atol=1e-6)


def test_it_reports_why_it_moves() -> None:
    assert fly_the_papers_example(1.0).moves[0].reason == (
        "moving 401 m east: in 32 s the target would be 565 m away"
    )


# -- the demonstration: 15 m/s next to a walker --------------------------------------------------------------

AIRCRAFT = Aircraft(airspeed_m_s=15.0, radius_m=65.0)


def demonstration(side: Side = Side.LEFT) -> tuple[PaperPlanner, Circle]:
    requirement = Requirement(100.0, 500.0, side, 3.0, 0.9)
    planner = PaperPlanner(AIRCRAFT, requirement, largest_psi_c_rad(AIRCRAFT, requirement))
    return planner, Circle(0.0, 200.0, 65.0, side.clockwise)


@pytest.mark.parametrize("side", Side)
def test_a_walker_stays_in_the_band(side: Side) -> None:
    flights = []
    for seed in range(6):
        planner, circle = demonstration(side)
        flights.append(fly(planner, walk(seed, 3.0, 1200.0), circle, 0.0, AIRCRAFT, 1200.0, latency_s=0.7))
    assert np.mean([flight.time_in_band for flight in flights]) >= 0.97
    assert min(flight.time_in_band for flight in flights) >= 0.93
    assert all(len(flight.moves) >= 2 for flight in flights)


def test_it_bears_wind_noise_latency_and_a_circle_flown_too_wide() -> None:
    bands = []
    for seed in range(4):
        planner, circle = demonstration()
        flight = fly(
            planner,
            walk(seed, 3.0, 1200.0),
            circle,
            0.0,
            AIRCRAFT,
            1200.0,
            wind=Wind(3.0, -2.0),
            latency_s=1.2,
            radius_error=0.08,
            noise_seed=seed,
        )
        bands.append(flight.time_in_band)
    assert np.mean(bands) >= 0.95


def test_a_plan_departs_from_the_circle_and_never_before_it_can_be_there() -> None:
    planner, circle = demonstration()
    flight = fly(planner, walk(3, 3.0, 1200.0), circle, 0.0, AIRCRAFT, 1200.0, latency_s=2.5)
    before = circle
    assert flight.moves
    for move in flight.moves:
        assert move.plan is not None and move.plan.transition is not None
        assert 2.5 <= move.plan.departure_s - move.time_s <= 2.5 + 3.0
        path = move.plan.transition
        for on, end in ((before, 0), (move.plan.circle, -1)):
            at_m = on.position_at_course(float(path.course_rad[end]))
            assert math.dist(at_m, (path.east_m[end], path.north_m[end])) < 1e-6
        before = move.plan.circle


def test_a_standing_target_is_left_alone() -> None:
    planner, circle = demonstration()
    flight = fly(planner, drive(0.0, 0.0), circle, 0.0, AIRCRAFT, 600.0, noise_seed=1)
    assert not flight.moves


def test_a_target_that_turned_back_is_watched_from_its_other_side_again() -> None:
    """It walks east with the circle to its north, then west: the circle must come to its south."""

    def there_and_back(time_s: float) -> tuple[float, float, float, float]:
        out_s = min(time_s, 60.0)
        return 3.0 * out_s - 3.0 * (time_s - out_s), 0.0, 3.0 if time_s < 60.0 else -3.0, 0.0

    planner, circle = demonstration()
    flight = fly(planner, there_and_back, circle, 0.0, AIRCRAFT, 160.0, latency_s=0.5)
    restarted = flight.moves[0]
    assert restarted.reason.endswith("the circle is no longer on the target's left")
    assert restarted.plan is not None and restarted.plan.circle.north_m == pytest.approx(-165.0, abs=1e-6)


def test_a_move_the_autopilot_did_not_take_is_proposed_again() -> None:
    planner, circle = demonstration()
    flight = fly(planner, drive(math.pi / 2, 3.0), circle, 0.0, AIRCRAFT, 400.0, uploads=lambda number: number != 1)
    first, second = flight.moves[:2]
    lap_s = AIRCRAFT.lap_s
    assert second.time_s - first.time_s == pytest.approx(lap_s, abs=2.0)
    assert first.plan is not None and second.plan is not None
    assert second.plan.circle.east_m - first.plan.circle.east_m == pytest.approx(
        3.0 * (second.plan.departure_s - first.plan.departure_s), abs=0.1
    )


def test_a_circle_flown_the_other_way_round_is_left_at_once() -> None:
    planner, _ = demonstration()
    flight = fly(
        planner, drive(math.pi / 2, 3.0), Circle(0.0, 300.0, 65.0, False), 0.0, AIRCRAFT, 120.0, latency_s=1.0
    )
    move = flight.moves[0]
    assert "other way round" in move.reason
    assert move.time_s == 0.0
    assert move.plan is not None and move.plan.circle.clockwise and move.plan.transition is not None
    at_m = Circle(0.0, 300.0, 65.0, False).position_at_course(-15.0 / 65.0)
    assert math.dist(at_m, (move.plan.transition.east_m[0], move.plan.transition.north_m[0])) < 0.01
    assert flight.time_in_band == 1.0


def test_a_sector_keeps_the_compass_side_whichever_way_the_target_goes() -> None:
    requirement = watching_from(Requirement(100.0, 500.0, Side.LEFT, 3.0, 0.9), "135-225")
    for seed in range(3):
        planner = PaperPlanner(AIRCRAFT, requirement, largest_psi_c_rad(AIRCRAFT, requirement))
        flight = fly(planner, walk(seed, 3.0, 600.0), Circle(0.0, -165.0, 65.0, True), 0.0, AIRCRAFT, 600.0)
        target_m = np.array([walk(seed, 3.0, 600.0)(time_s)[:2] for time_s in np.arange(0.0, 600.5, 0.5)])
        seen_from = np.array(flight.places_m) - target_m
        assert np.mean(seen_from[:, 1] < 0.0) > 0.85


def test_either_side_takes_the_nearer_one_after_the_target_turned_back() -> None:
    """It turns back below a circle to its north, so that the aircraft is then on its right, and stays there."""
    requirement = watching_from(Requirement(100.0, 500.0, Side.LEFT, 3.0, 0.9), "either")
    planner = PaperPlanner(AIRCRAFT, requirement, largest_psi_c_rad(AIRCRAFT, requirement))

    def there_and_back(time_s: float) -> tuple[float, float, float, float]:
        out_s = min(time_s, 60.0)
        return 3.0 * out_s - 3.0 * (time_s - out_s), 0.0, 3.0 if time_s < 60.0 else -3.0, 0.0

    flight = fly(planner, there_and_back, Circle(0.0, 200.0, 65.0, True), 0.0, AIRCRAFT, 300.0)
    assert all(north_m > 50.0 for _, north_m in flight.places_m)
    assert flight.moves[0].plan is not None and not flight.moves[0].plan.circle.clockwise
    assert flight.time_in_band > 0.95


@pytest.mark.parametrize(
    ("quality", "wind", "word"),
    [(TrackQuality.LOST, Wind(), "lost"), (TrackQuality.GOOD, Wind(16.0, 0.0), "wind")],
)
def test_it_circles_on_where_it_cannot_plan(quality: TrackQuality, wind: Wind, word: str) -> None:
    planner, circle = demonstration()
    state = AircraftState(0.0, -65.0, 200.0, 0.0, 15.0, 1.0 / 65.0)
    estimate = TargetEstimate(0.0, 800.0, 0.0, 3.0, 0.0, np.eye(4), quality, 0.0)
    decision = planner.decide(state, estimate, Plan(circle), wind, 0.5)
    assert decision.plan is None
    assert decision.reason.startswith("circling on") and word in decision.reason
