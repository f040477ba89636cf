"""Puts the pure core together from a configuration, and runs what is compiled so that nothing loads in flight.

A test flies and fails if a kernel is called in flight with arguments that the warm-up has not run.
"""

from __future__ import annotations

import gc
import math
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import chain
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.config import Config, Polygon, SensorsSection
from sidelong.app.errors import InputError
from sidelong.app.planners.planner_kind import CompilesInParts, PlannerKind, PlannerNeeds
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.process import helper_command, helper_environment
from sidelong.app.terrain.elevation_data import elevation_data
from sidelong.estimators.compiled import FOLDER, is_cached
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.imm_kernel import update
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.tracking.payload_kernel import EARTH, SHARED, Readings, fit_readings, look
from sidelong.estimators.tracking.track import Track
from sidelong.estimators.tracking.tracker import SourceChoice, Tracker, TrackerSettings
from sidelong.mission.control.controller import StandoffController, StandoffSettings
from sidelong.mission.control.surroundings import FlightBounds, Surroundings
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path as FlownPath
from sidelong.mission.core.plan import AircraftState, CheckedPlannerFactory, Heights, OneHeight, Plan, Planner
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import ExchangeSettings, Home
from sidelong.mission.exchange.mission_controller import MissionController
from sidelong.mission.geometry.line_kernel import Trapezoid, laid_out, trapezoid
from sidelong.mission.geometry.progress import ground_speeds_m_s, nearest_arc_m, point_at
from sidelong.mission.predictive.planner import PredictivePlanner, foreseen, scene_at
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.route.route import RoutePlanner, route_of
from sidelong.mission.upload.fences import FenceError, Fences, Outline, intersection
from sidelong.mission.upload.items import lay_out
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.viewpoint.watch_course import TargetCourse, courses_made_good_rad

if TYPE_CHECKING:
    from sidelong.app.link.stored import VehicleFences
    from sidelong.estimators.terrain.ground import Ground
    from sidelong.mission.core.sight import Sight
    from sidelong.mission.terrain.heights import FlightHeights, SightField


Pair = tuple[float, float]
HomeDeg = Pair | None

# Laser dropouts of one or two seconds are normal and need no message.
_COASTING_AFTER_S = 3.0

_LIKELY_WIND = 0.25  # of the airspeed
_COMPILED = 175  # functions of a first compilation, about
_PARTS = "decisions", "tables, filter and routes"  # of the first compilation, each in a process of its own


def tracker_of(config: Config) -> Tracker:
    """Return a tracker as configured; with a gimbal that follows the estimate it does not estimate delays."""
    settings = tracker_settings(config.sensors, config.planner.lost_after_s)
    # A gimbal that follows the estimate shows where that is, whenever it was made.
    return Tracker(replace(settings, latency_sigma_s=0.0) if config.payload.point_gimbal else settings)


def stand_on_ground(tracker: Tracker, config: Config, ground: Ground | None) -> None:
    """Let the target stand on the ground, where it is known: by elevation data, or flat by configuration."""
    if ground is None and config.terrain.flat:
        from sidelong.estimators.terrain.ground import flat_ground  # noqa: PLC0415  # as in surroundings_of

        ground = flat_ground(config.terrain.sigma_m)
    if ground is not None:
        tracker.stand_on(ground, config.sensors.angles_alone)


def _track_of(config: Config) -> Track:
    """Return a track for the configured sensors, to warm up with."""
    return Track(tracker_settings(config.sensors, config.planner.lost_after_s))


def tracker_settings(sensors: SensorsSection, lost_after_s: float) -> TrackerSettings:
    """Return the sensors' section in the tracker's units, radians and metres; ``latency_s`` serves both devices."""
    mount = sensors.mount_deg

    def chosen(component_id: int | None) -> SourceChoice | None:
        return None if component_id is None else SourceChoice(component_id=component_id)

    def or_both(latency_s: float | None) -> float:
        return sensors.latency_s if latency_s is None else latency_s

    return TrackerSettings(
        filter=sensors.filter,
        target_kind=sensors.target_kind,
        range_sigma_m=sensors.range_sigma_m,
        yaw_sigma_rad=radians(sensors.angle_sigma_deg),
        pitch_sigma_rad=radians(sensors.angle_sigma_deg),
        gimbal_latency_s=or_both(sensors.gimbal_latency_s),
        range_latency_s=or_both(sensors.range_latency_s),
        latency_sigma_s=sensors.latency_sigma_s,
        lever_arm_body_m=sensors.lever_arm_m,
        mount_roll_pitch_yaw_rad=(radians(mount[0]), radians(mount[1]), radians(mount[2])),
        yaw_bias_sigma_rad=radians(sensors.yaw_bias_sigma_deg),
        pitch_bias_sigma_rad=radians(sensors.pitch_bias_sigma_deg),
        range_bias_sigma_m=sensors.range_bias_sigma_m,
        range_source=chosen(sensors.range_component),
        gimbal_source=chosen(sensors.gimbal_component),
        gimbal_frame=sensors.gimbal_frame,
        coasting_after_s=_COASTING_AFTER_S,
        lost_after_s=lost_after_s,
    )


@dataclass(frozen=True, slots=True)
class Prepared:
    """A configuration for which all that takes long is computed: its control step is made without a pause."""

    config: Config
    make_planner: CheckedPlannerFactory

    def controller(self, plane: LocalPlane | None = None, home_deg: HomeDeg = None) -> StandoffController:
        """Return the control step; without a plane, as in some logs, it has no fences and no ground.

        Raises InputError if a fence is not a valid polygon, or the elevation data is unusable.
        """
        config, make = self.config, self.make_planner
        surroundings = Surroundings() if plane is None else surroundings_of(config, plane, home_deg)
        tracker = tracker_of(config)
        if plane is not None:
            stand_on_ground(tracker, config, surroundings.ground)
        settings = StandoffSettings(
            config.requirement.requirement(),
            config.aircraft.aircraft(),
            lost_after_s=config.planner.lost_after_s,
            give_up_after_s=config.planner.give_up_after_s,
            give_up_action=config.planner.at_end,
            # The coordinator of a fleet calls for relief, and sends an aircraft home.
            at_low_battery=config.planner.at_low_battery if config.requirement.fleet_size == 1 else "warn",
            at_breach=config.planner.at_breach,
        )
        return StandoffController(
            settings, tracker, lambda aircraft, wanted: make(aircraft, wanted, surroundings), surroundings
        )


def prepared(
    config: Config,
    progress: Callable[[float], None] = lambda _share: None,
    announce: Callable[[str], None] = lambda _text: None,
    kind: PlannerKind | None = None,
) -> Prepared:
    """Compile and compute ahead what the control step of a configuration needs. kind: None: the configured one.

    progress: receives the share (0 to 1) of the value table's computation, which takes seconds. announce: receives a
    sentence before the compilation, which takes up to a minute, once for each version.
    """
    kind = kind or planner_by_name(config.planner.name)
    if not (kind.is_compiled() and is_cached(update)):
        _compile(config, kind, announce)
    make_planner = kind.factory(planner_needs(config, progress))
    _warm_up_planner(config, make_planner)
    warm_up_exchange()
    warm_up_track(_track_of(config))
    return Prepared(config, make_planner)


def _compile(config: Config, kind: PlannerKind, announce: Callable[[str], None]) -> None:
    """Compile in two processes at a time, which leave the machine code in the cache and take their memory with them.

    What one of them fails to compile is compiled in this process when it is first called.
    """
    announced = -1
    with ExitStack() as running:
        helpers = []
        for part in _PARTS:
            helper = subprocess.Popen(
                helper_command(__name__, part),
                env=helper_environment() | {"NUMBA_CACHE_DIR": str(FOLDER.parent)},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # the terminal's Ctrl-C is not for it
            )
            running.callback(helper.wait)
            running.callback(helper.kill)
            helpers.append(helper)
        given = pickle.dumps((config, kind))
        for helper in helpers:
            assert helper.stdin is not None
            with suppress(BrokenPipeError), helper.stdin:
                helper.stdin.write(given)
        while any(helper.poll() is None for helper in helpers):
            share = min(sum(1 for _ in FOLDER.rglob("*.nbi")) / _COMPILED, 0.99)
            if int(10.0 * share) > announced:
                announced = int(10.0 * share)
                announce(f"compiling planner and filter, once for this version, a minute or two: {10 * announced} %")
            with suppress(subprocess.TimeoutExpired):
                next(helper for helper in helpers if helper.returncode is None).wait(0.5)


def _warm_up_planner(config: Config, make_planner: CheckedPlannerFactory) -> None:
    requirement = config.requirement.requirement()
    planner = make_planner(config.aircraft.aircraft(), requirement, Surroundings())
    with_route = config.route.is_known or config.requirement.fleet_size > 1  # of a target that it is moved to
    warm_up_planner(planner, requirement.range_max_m - 190.0, with_route)


def winds_m_s(config: Config) -> list[float]:
    """Return the wind speeds to prepare for, in addition to 0: a likely one if none is configured.

    With the table for still air, plans change 105 times an hour in 4 m/s at 22 m/s; with the likely one 63 times,
    with that wind's own 59 times. In flight, its own table may take minutes to compute on a busy machine.
    """
    winds_m_s = {*config.planner.winds_m_s}
    if not config.link.connections:
        if config.simulation.wind_speed_m_s > 0.0:
            winds_m_s.add(config.simulation.wind_speed_m_s)
    elif not winds_m_s and config.requirement.requirement().sector is None:
        winds_m_s.add(round(_LIKELY_WIND * config.aircraft.airspeed_m_s, 2))
    return sorted(winds_m_s)


def planner_needs(config: Config, progress: Callable[[float], None]) -> PlannerNeeds:
    """Return what a planner kind makes planners from; ``progress`` is called with the share of tables done."""
    aircraft, wanted = config.aircraft.aircraft(), config.requirement.requirement()
    return PlannerNeeds(aircraft, wanted, winds_m_s(config), config.planner.lost_after_s, progress)


def mission_controller_of(
    config: Config, controller: StandoffController, autopilot: Autopilot, plane: LocalPlane, home: Home
) -> MissionController:
    """Return the whole core of a flight: the control step, and its exchange with the autopilot."""
    settings = ExchangeSettings(
        plane,
        home,
        config.aircraft.aircraft(),
        config.aircraft.height_m,
        config.planner.tolerance_m,
        clockwise=config.requirement.requirement().side.clockwise,
        by_command=config.planner.guidance == "command",
        cleared=controller.surroundings.levelled,
    )
    return MissionController(controller, autopilot, settings)


def fence_outlines(config: Config, plane: LocalPlane) -> tuple[list[Outline], list[Outline]]:
    """Return the corners of the (inclusion, exclusion) fences in the plane, m."""

    def outlines(polygons: Sequence[Polygon]) -> list[Outline]:
        return [[plane.east_north_m(*corner) for corner in polygon] for polygon in polygons]

    return outlines(config.fences.keep_in), outlines(config.fences.keep_out)


def fences_of(config: Config, plane: LocalPlane) -> Fences:
    """Return the configured fences in the plane. Raises InputError if one is not a valid polygon."""
    fences = config.fences
    try:
        return Fences(*fence_outlines(config, plane), fences.floor_m, fences.ceiling_m, fences.margin_m)
    except FenceError as error:
        raise InputError(f"fences: {error}; correct its corners.") from error


def with_vehicle_fences(config: Config, found: VehicleFences, every: bool) -> Config:
    """Return a configuration that keeps the fences of the vehicle, too, and has its rally points.

    every: whether to be inside all of its inclusion fences, or inside one. Raises InputError where they are no
    polygons, or leave no room with those of the configuration or for the circle.
    """
    corners = [corner for outline in (*found.inclusion, *found.exclusion) for corner in outline]
    fences = config.fences.model_copy(update={"rally": [*config.fences.rally, *found.rally]})
    if not corners:
        return config.model_copy(update={"fences": fences}) if found.rally else config
    plane = LocalPlane(*corners[0])
    keep_in, holes = fences.keep_in, []
    try:
        if found.inclusion:
            own, _ = fence_outlines(config, plane)
            theirs = [[plane.east_north_m(*corner) for corner in outline] for outline in found.inclusion]
            keep_in, holes = (
                [[plane.latitude_longitude_deg(*corner) for corner in outline] for outline in outlines]
                for outlines in intersection(own, theirs, every)
            )
        keep_out = [*fences.keep_out, *map(list, found.exclusion), *holes]
        both = config.model_copy(
            update={"fences": fences.model_copy(update={"keep_in": keep_in, "keep_out": keep_out})}
        )
        check_room(both)
    except (FenceError, InputError) as error:
        raise InputError(
            f"the vehicle's fences: {error}; correct them in the vehicle, or those in [fences]."
        ) from error
    return both


def check_room(config: Config) -> None:
    """Raise InputError if no circle of the aircraft fits into the fences."""
    corners = [*chain(*config.fences.keep_in, *config.fences.keep_out)]
    if not corners:
        return
    fences, aircraft = fences_of(config, LocalPlane(*corners[0])), cast(Any, config.aircraft)
    for one in aircraft if isinstance(aircraft, list) else (aircraft,):
        if not fences.has_room(one.radius_m):
            raise InputError(
                f"fences: no circle of aircraft.radius_m = {one.radius_m:g} fits into keep_in with "
                f"margin_m = {config.fences.margin_m:g}; change one of them."
            )


def surroundings_of(
    config: Config, plane: LocalPlane, home_deg: HomeDeg, ground: Ground | None = None
) -> Surroundings:
    """Return fences and ground of a configuration in the plane; see ``Prepared.controller``.

    ground: the one to use; None: that of the configured elevation data.
    """
    aircraft, outlines = config.aircraft, fences_of(config, plane)
    fences = outlines.check(aircraft.height_m)
    bounds = FlightBounds(
        aircraft.height_m if aircraft.height_above == "home" else math.nan,
        -math.inf if config.fences.floor_m is None else config.fences.floor_m,
        math.inf if config.fences.ceiling_m is None else config.fences.ceiling_m,
        config.fences.margin_m,
        aircraft.clearance_m,
        outlines.inside_m,
    )
    ground = ground or ground_of(config, plane, home_deg)
    if ground is None:
        return Surroundings(fences, OneHeight(aircraft.rates()), bounds=bounds)
    # Compiled code takes a second to load, so it is imported only if there is elevation data.
    from sidelong.mission.terrain.heights import FlightHeights, HeightRules, SightField  # noqa: PLC0415

    rules = HeightRules(
        aircraft.height_m,
        aircraft.height_above,
        aircraft.clearance_m,
        aircraft.rates(),
        config.fences.margin_m,
        math.inf if config.fences.ceiling_m is None else config.fences.ceiling_m,
    )
    over = FlightHeights(ground, rules)
    field = SightField(ground, config.requirement.range_max_m + 4.0 * aircraft.radius_m)
    warm_up_over(ground, _track_of(config), over, field)

    def hidden(heights: Heights, flown_m: float | None, target_m: Pair, velocity_m_s: Pair) -> Sight:
        assert isinstance(heights, FlightHeights)
        return field.sight(*target_m, *velocity_m_s, heights.expected_m(flown_m, target_m))

    def clear_m(east_m: float, north_m: float, height_m: float) -> float:
        return over.clearance_m(east_m, north_m, height_m) - aircraft.clearance_m

    return Surroundings(fences, over, ground, hidden, bounds=replace(bounds, clear_m=clear_m))


def ground_of(config: Config, plane: LocalPlane, home_deg: HomeDeg) -> Ground | None:
    """Return the ground about home, or the plane's origin; None where no elevation data is configured.

    Raises InputError if that is unusable.
    """
    if config.terrain.folder is None:
        return None
    home_deg = home_deg or (plane.origin_latitude_deg, plane.origin_longitude_deg)
    return elevation_data(Path(config.terrain.folder)).ground(plane, home_deg, config.terrain.sigma_m)


def _compile_part(part: str) -> None:
    """Compile one part for the configuration and the planner that come in."""
    gc.disable()  # to search for garbage takes a tenth of the time
    config, kind = pickle.loads(sys.stdin.buffer.read())
    aircraft, wanted = config.aircraft.aircraft(), config.requirement.requirement()
    if part == _PARTS[1]:
        kind.factory(planner_needs(config, lambda _share: None))
        warm_up_exchange()
        warm_up_track(_track_of(config))
        if isinstance(kind, CompilesInParts):
            warm_up_foresight(kind.without_values(aircraft, wanted))
    elif isinstance(kind, CompilesInParts):
        planner = kind.finished(kind.without_values(aircraft, wanted))
        warm_up_planner(planner, wanted.range_max_m - 190.0, with_route=False)
    else:
        _warm_up_planner(config, kind.factory(planner_needs(config, lambda _share: None)))


_CIRCLE = Circle(-250.0, 0.0, 60.0, clockwise=True)
_TARGET = TargetEstimate(1.0, 0.0, 0.0, 0.0, 0.0, np.eye(4), TrackQuality.GOOD, 1.0)
_HERE = AircraftState(1.0, *_CIRCLE.position_at_course(0.0), 0.0, 15.0, _CIRCLE.curvature_per_m)

MADE_UP_ROUTE = route_of(np.array([-300.0, 300.0]), np.zeros(2))


def warm_up_planner(planner: Planner, beyond_m: float, with_route: bool) -> None:
    """Run what decides and follows a plan. The planner must not be flown afterwards.

    beyond_m: in the last decisions the target is this much farther away, out of the band, so that the planner lays
    out a new circle as well.
    """
    shape, plan = _shape(), Plan(_CIRCLE)
    for time_s in (0.0, 0.5, 1.0):
        course_rad = 0.1 * time_s
        east_m, north_m = _CIRCLE.position_at_course(course_rad)
        aircraft = replace(_HERE, time_s=time_s, east_m=east_m, north_m=north_m, course_rad=course_rad)
        planner.decide(aircraft, replace(_TARGET, time_s=time_s, last_sighting_s=time_s), plan, Wind(), 0.5)
        point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
        plan = Plan(_CIRCLE, FlownPath(*laid_out(shape, east_m, north_m, course_rad)), time_s)
    far = replace(_TARGET, east_m=_TARGET.east_m + beyond_m)
    for course_rad in (1.6, 3.1, 4.7, 0.0):
        east_m, north_m = _CIRCLE.position_at_course(course_rad)
        aircraft = replace(_HERE, east_m=east_m, north_m=north_m, course_rad=course_rad)
        if planner.decide(aircraft, far, Plan(_CIRCLE), Wind(), 0.5).plan is not None:
            break
    if with_route and isinstance(planner, RoutePlanner):
        planner.follow(MADE_UP_ROUTE, fresh_progress(MADE_UP_ROUTE.east_m.size))
        planner.decide(_HERE, _TARGET, Plan(_CIRCLE), Wind(), 0.5)


def warm_up_foresight(planner: PredictivePlanner) -> None:
    """Run what predicts a target near a route, to compile it. The planner must not be flown afterwards."""
    planner.follow(MADE_UP_ROUTE, fresh_progress(MADE_UP_ROUTE.east_m.size))
    question = planner.questions[0]
    foreseen(scene_at(_HERE, _TARGET, Plan(_CIRCLE), Wind(), 0.5, question), question)


def warm_up_exchange() -> None:
    """Compile what the exchange and the judgement call, on made-up values."""
    TargetCourse().update(_TARGET, 1.0)
    courses_made_good_rad(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1), 1.0)
    ground_speeds_m_s(np.zeros(2), 15.0, Wind(1.0, 0.0))
    lay_out(FlownPath(*laid_out(_shape(), *_CIRCLE.position_at_course(0.0), 0.0)), _CIRCLE, LineTracking(), math.inf)


def _shape() -> Trapezoid:
    return trapezoid(_CIRCLE.curvature_per_m, 0.0, 300.0, _CIRCLE.curvature_per_m, 1e-3)


def warm_up_track(track: Track) -> None:
    """Run what estimates the target and the payload's delays. The track must not be flown afterwards."""
    times_s, zero, one = np.arange(4.0), np.zeros(4), np.ones(4)
    positions, sights = np.column_stack([times_s, zero, zero, one, zero]), np.column_stack([times_s, zero, one, zero])
    ranges, noise, none = np.column_stack([times_s, one]), (0.01, 1.0, 0.0, 0.0), (0.0, 0.0)
    readings = Readings(positions, sights, sights, ranges, EARTH, noise, none)
    fit_readings(readings, np.ones(SHARED), np.zeros(SHARED, np.bool_), np.zeros(SHARED), 0.0)
    look(readings, 0.0, np.empty((4, 3)))
    for time_s in (0.0, 0.5, 1.0):
        track.add(_sighting(time_s))
        track.estimate(time_s)
    track.begin_again()
    track.add(_sighting(1.5))


def warm_up_over(ground: Ground, track: Track, heights: FlightHeights, field: SightField) -> None:
    """Run what a flight calls over elevation data only. The track must not be flown afterwards."""
    track.stand_on(ground)
    for time_s in (0.0, 0.5):
        track.add(_sighting(time_s))
        track.estimate(time_s)
    track.begin_again()
    track.add(_sighting(1.0))
    here_m = 0.0, 0.0, 100.0
    ground.cut_m(*here_m, 0.0, 0.3, 500.0)
    ground.sees(here_m, here_m)
    ground.heights_at_m(np.zeros(2), np.zeros(2))
    field.sight(*here_m[:2], 1.0, 0.0, here_m[2])
    heights.expected_m(None, here_m[:2])
    heights.clearance_m(*here_m)
    path = FlownPath(*laid_out(trapezoid(0.0, 0.0, 300.0, _CIRCLE.curvature_per_m, 1e-3), *here_m[:2], 0.0))
    for one in (heights, heights.at(0.0)):  # with a climb from far below
        one.levelled(Plan(_CIRCLE, path), -1e3)


def _sighting(time_s: float) -> Sighting:
    return Sighting(time_s, 270.0, math.pi / 2, 0.3, 1.0, 0.01, 0.01, -250.0, 0.0, 80.0)


if __name__ == "__main__":
    _compile_part(*sys.argv[1:])
