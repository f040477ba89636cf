"""The report of a flight: one page that needs nothing else."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from html import escape

import numpy as np

from sidelong.app.analysis.score import Samples
from sidelong.app.analysis.summary import Summary, percent
from sidelong.app.report import html
from sidelong.app.report.history import FlightHistory, FlightRecord, clock, curvature_per_m, estimate_errors
from sidelong.app.report.html import Axis, Chart, Drawing, Mark, line, mark
from sidelong.app.view.shading import hillshade
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.viewpoint.watch_course import side_words

_TICK_S = 50.0
_LABELS_MAX = 12
_STAY_SHARE = 0.04  # of the map's extent: labels that near one another would overlap
_ROUTE_POINTS = 2000
_SHADED_OVER_M = 1000.0  # beyond what is drawn
_COURSE_WORDS = (
    "Over the ground, in whole turns counted on clockwise from north: it rises while the aircraft circles to the "
    "right, falls while it circles to the left, and stands while it flies straight."
)
_TIME = "time since watching began, min:s"
_BIN_DEG = 10.0
_CONSISTENCY_TOP = 2.0  # of the bound: what lies above is drawn at the edge
_CHI2_95 = {2: 5.991, 3: 7.815}  # by the degrees of freedom


def drawings(history: FlightHistory) -> Iterator[Drawing]:
    """Yield the figures in order, those left out that nothing is known for."""
    watched = _map, _range, _observation, _observation_histogram
    flown = _curvature, _course, _target_speed, _route
    makers: tuple[Callable[[FlightHistory], Drawing | None], ...] = *watched, *flown, _errors, _consistency, _uploads
    yield from filter(None, (make(history) for make in makers))


def _map(history: FlightHistory) -> Drawing:
    """Draw paths with a dot every 50 s, joined by the line of sight; circles flown; fences; the shaded ground."""
    moments, flown = history.moments, history.aircraft
    time_s = np.array([m.time_s for m in moments]) - history.start_s
    aircraft = np.array([(m.aircraft_east_m, m.aircraft_north_m) for m in moments]).reshape(-1, 2)
    target = np.array([(m.target_east_m, m.target_north_m) for m in moments]).reshape(-1, 2)
    since = flown.time_s >= history.start_s
    marks = list(_shading(history))
    for of, outlines in (("keep_in", history.asked.keep_in), ("keep_out", history.asked.keep_out)):
        for outline in outlines:
            east_m, north_m = np.array((*outline, outline[0])).T
            marks.append(line((east_m, north_m), "bad", dashed=of == "keep_in", filled=of == "keep_out"))
    if history.route is not None:
        marks.append(line(history.route.outline_m(_ROUTE_POINTS).T, "route", "route", thick=True))
    circles = [(one.east_m, one.north_m, one.radius_m) for _, one in history.circles]
    marks.append(mark("circles", "circle", "circles commanded", circles=circles))
    what = "target" if history.judged_by_truth else "target (estimate)"
    marks.append(line(target.T, "target", what, thick=True))
    path = flown.east_m[since], flown.north_m[since]
    marks.append(line(path, "aircraft", "aircraft", t=flown.time_s[since] - history.start_s))
    if history.judged_by_truth:
        known = [(e.east_m, e.north_m) for e in history.estimates if e.time_s >= history.start_s]
        marks.append(line(np.array(known).reshape(-1, 2).T, "estimate", "estimate"))
    marks += _ticks(time_s, aircraft, target)
    at_s = [one.time_s for one in history.moves]
    numbers = list(map(str, range(1, len(at_s) + 1)))
    east_m, north_m = (np.interp(at_s, flown.time_s, place) for place in (flown.east_m, flown.north_m))
    marks.append(mark("texts", "aircraft", x=east_m, y=north_m, texts=numbers, boxed=True))
    return Drawing(
        "path",
        "Paths over the ground",
        "Aircraft, in the colour of its time, and target with a dot every 50 s, joined by the line of sight; circles "
        "as they were commanded. The numbers are those of the decisions below.",
        [Chart(Axis("east, m"), Axis("north, m"), marks, equal=True)],
    )


def _shading(history: FlightHistory) -> Iterator[Mark]:
    ground, flown = history.asked.ground, history.aircraft
    if ground is not None:
        reach_m = float(np.abs((flown.east_m, flown.north_m)).max()) + _SHADED_OVER_M
        shade = hillshade(ground, reach_m)
        west_m, south_m, east_m, north_m = shade.edges_m
        rect = west_m, east_m, south_m, north_m
        yield mark("image", "ground", href=f"data:image/png;base64,{b64encode(shade.png).decode()}", rect=rect)


def _ticks(time_s: FloatArray, aircraft: FloatArray, target: FloatArray) -> Iterator[Mark]:
    if not len(time_s):
        return
    at_s = np.arange(0.0, time_s[-1] + 1e-9, _TICK_S)
    here_m, there_m = (
        np.column_stack([np.interp(at_s, time_s, track[:, axis]) for axis in (0, 1)]) for track in (aircraft, target)
    )
    joined = np.stack((here_m, there_m, np.full(here_m.shape, np.nan)), axis=1).reshape(-1, 2)
    yield line(joined.T, "faint")
    for of, place_m in (("aircraft", here_m), ("target", there_m)):
        yield mark("dots", of, x=place_m[:, 0], y=place_m[:, 1])
    near_m = _STAY_SHARE * float(np.ptp(np.concatenate((aircraft, target)), axis=0).max())
    stays = _stays(there_m, near_m)[:: max(1, len(at_s) // _LABELS_MAX)]
    texts = [" to ".join(clock(at_s[k]) for k in dict.fromkeys((stay[0], stay[-1]))) for stay in stays]
    at_m = there_m[[stay[0] for stay in stays]]
    yield mark("texts", "target", x=at_m[:, 0], y=at_m[:, 1], texts=texts)


def _stays(target_m: FloatArray, near_m: float) -> list[range]:
    """Return the ticks in runs of which all lie where the first does: a target that stands gets one label."""
    stays: list[range] = []
    for number, place_m in enumerate(target_m):
        if stays and np.hypot(*(place_m - target_m[stays[-1][0]])) < near_m:
            stays[-1] = range(stays[-1][0], number + 1)
        else:
            stays.append(range(number, number + 1))
    return stays


# -- how the target was watched ------------------------------------------------------------------------------


def _range(history: FlightHistory) -> Drawing:
    requirement, judged = history.requirement, history.judged
    limits_m = requirement.range_min_m, requirement.range_max_m
    min_m, max_m = float(judged.range_m.min(initial=math.inf)), float(judged.range_m.max(initial=0.0))
    marks = [
        mark("bands", "band", "allowed band", rects=[(None, None, *limits_m)]),
        line((judged.time_s - history.start_s, judged.range_m), "aircraft", _judged(history)),
    ]
    chart = _over_time(history, Axis("horizontal range, m", (0.0, 1.06 * max(limits_m[1], max_m))), marks)
    asked = "allowed are {:.0f} to {:.0f} m.".format(*limits_m)
    return Drawing("range", "Range to the target", f"Between {min_m:.0f} and {max_m:.0f} m; {asked}", [chart])


def _observation(history: FlightHistory) -> Drawing:
    allowed_deg = math.degrees(history.requirement.allowed_rad)
    time_s, angle_deg = history.judged.time_s - history.start_s, np.degrees(history.judged.observation_rad)
    marks = [
        mark("bands", "band", _wanted(history), rects=[(None, None, -allowed_deg, allowed_deg)]),
        line((time_s, angle_deg), "aircraft", _judged(history), wraps=180.0),
    ]
    caption = (
        "Where the aircraft is, seen from the target: 0° is the middle of the sector asked for."
        if history.requirement.sector is not None
        else "From the normal of the target's motion, on the side asked for, to the line of sight: 0° is abeam; "
        "beyond ±90° the aircraft is on the other side."
    )
    chart = _over_time(history, Axis("observation angle, °", (-180.0, 180.0), degrees=True), marks)
    return Drawing("observation-angle", "Observation angle", caption, [chart])


def _observation_histogram(history: FlightHistory) -> Drawing | None:
    angle_deg = np.degrees(history.judged.observation_rad)
    angle_deg = angle_deg[np.isfinite(angle_deg)]
    if not len(angle_deg):
        return None
    edges_deg = np.arange(-180.0, 180.0 + _BIN_DEG, _BIN_DEG)
    shares = 100.0 * np.histogram(angle_deg, edges_deg)[0] / len(angle_deg)
    bars = zip(edges_deg[:-1] + 0.5, edges_deg[1:] - 0.5, np.zeros(len(shares)), shares.round(2), strict=True)
    allowed_deg = math.degrees(history.requirement.allowed_rad)
    marks = [
        mark("bands", "band", _wanted(history), rects=[(-allowed_deg, allowed_deg, None, None)]),
        mark("bands", "aircraft", rects=[tuple(map(float, bar)) for bar in bars]),
    ]
    axis = Axis("observation angle, °", (-180.0, 180.0), degrees=True)
    share = 100.0 * float(np.mean(np.abs(angle_deg) <= allowed_deg))
    caption = f"{share:.1f} % of the known time the aircraft was where it was asked to be."
    chart = Chart(axis, Axis("share of time, %", (0.0, None)), marks)
    return Drawing("observation-histogram", "How often from which angle", caption, [chart])


# -- how the aircraft flew -----------------------------------------------------------------------------------


def _curvature(history: FlightHistory) -> Drawing:
    time_s, flown_per_m = curvature_per_m(history.aircraft)
    per_km, radius_m = 1e3 * flown_per_m, history.asked.airframe.radius_m
    circle_per_km, reach = 1e3 / radius_m, 1.6e3 / radius_m
    marks = [
        mark("rules", "faint", f"circle of {radius_m:.0f} m", y=[-circle_per_km, circle_per_km], dashed=True),
        line((time_s - history.start_s, per_km), "aircraft", "flown"),
    ]
    caption = f"Over the ground; positive turns right{_beyond(np.abs(per_km), reach, ' 1/km')}."
    chart = _over_time(history, Axis("curvature, 1/km", (-reach, reach)), marks)
    return Drawing("curvature", "Curvature of the flown path", caption, [chart])


def _course(history: FlightHistory) -> Drawing:
    turns = np.unwrap(history.aircraft.course_rad) / math.tau
    marks = [line((history.aircraft.time_s - history.start_s, turns), "aircraft", "flown")]
    return Drawing("course", "Course flown", _COURSE_WORDS, [_over_time(history, Axis("course flown, turns"), marks)])


def _target_speed(history: FlightHistory) -> Drawing:
    marks = []
    if history.judged_by_truth:
        true = Samples.of(history.moments)
        speed_m_s = np.hypot(*true.target_velocity_m_s.T)
        marks.append(line((true.time_s - history.start_s, speed_m_s), "target", "true target", thick=True))
    known = [(one.time_s - history.start_s, one.speed_m_s) for one in history.estimates]
    known = [one for one in known if one[0] >= 0.0]
    marks.append(line(np.array(known).reshape(-1, 2).T, "estimate", "estimate"))
    chart = _over_time(history, Axis("target's speed, m/s", (0.0, None)), marks)
    return Drawing("target-speed", "Speed of the target", "Over the ground.", [chart])


def _route(history: FlightHistory) -> Drawing | None:
    progress = [(time_s, one) for time_s, one in history.progress if time_s >= history.start_s]
    if not progress:
        return None
    time_s = np.array([at_s for at_s, _ in progress]) - history.start_s
    along_m = np.array([one.along_m for _, one in progress])
    off, length_m = ~np.isfinite(along_m), progress[-1][1].route.length_m
    unused = ~off & ~np.array([one.of_use for _, one in progress])
    marks = []
    for where, of, label in ((off, "faint", "off route"), (unused, "bad", "not used")):
        edges = np.flatnonzero(np.diff(where.astype(int), prepend=0, append=0)).reshape(-1, 2) - (0, 1)
        marks.append(mark("bands", of, label, rects=[(*span, None, None) for span in time_s[edges].tolist()]))
    marks.append(line((time_s, along_m), "target", "target (estimate)", wraps=0.5 * length_m))
    on, not_used = (100.0 * float(np.mean(one)) for one in (~off, unused))
    reason = f", {not_used:.1f} % not used: straight on predicts the target better" if not_used else ""
    caption = f"On the route {on:.1f} % of the time{reason}; its length is {length_m:.0f} m."
    chart = _over_time(history, Axis("along the route, m", (0.0, length_m)), marks)
    return Drawing("route", "Progress along the route", caption, [chart])


# -- how good the estimate was -------------------------------------------------------------------------------


def _errors(history: FlightHistory) -> Drawing | None:
    errors = estimate_errors(history)
    if errors is None:
        return None
    time_s = errors.time_s - history.start_s
    marks = [
        line((time_s, errors.radius95_m), "faint", "long half axis of the 95 % ellipse", dashed=True),
        line((time_s, errors.error_m), "estimate", "error"),
    ]
    watched = errors.error_m[time_s >= 0.0]
    claimed_m = float(np.percentile(errors.radius95_m, 90.0))
    top_m = 1.2 * max(claimed_m, float(np.percentile(np.append(watched, 1.0), 99.8)))
    clipped = _beyond(np.append(errors.error_m, errors.radius95_m), top_m, " m")
    caption = (
        f"Horizontal distance from the true target, once a second, compared with what the estimate claims{clipped}."
    )
    chart = _over_time(history, Axis("position error, m", (0.0, top_m)), marks)
    return Drawing("estimate-error", "Error of the estimate", caption, [chart])


def _consistency(history: FlightHistory) -> Drawing | None:
    errors = estimate_errors(history)
    compared = [(one.sighting.time_s, one.nis) for one in history.sightings if math.isfinite(one.nis)]
    rows: list[tuple[str, str, FloatArray, FloatArray, int]] = []
    if errors is not None:
        meaning = "NEES: error against the truth over its claimed covariance, squared"
        rows.append(("NEES", meaning, errors.time_s, errors.nees, 2))
    if compared:
        at_s, nis = np.array(compared).T
        rows.append(("NIS", "NIS: innovation of each sighting, squared", at_s, nis, 3))
    if not rows:
        return None
    charts, words, clipped = [], [], ""
    for name, _, at_s, value, freedom in rows:
        bound = _CHI2_95[freedom]
        top = _CONSISTENCY_TOP * bound
        marks = [
            mark("rules", "bad", f"95 % of chi-square ({freedom})", y=[bound], dashed=True),
            mark("dots", "estimate", name, x=at_s - history.start_s, y=np.minimum(value, top), radius=1),
        ]
        charts.append(_over_time(history, Axis(name, (0.0, top)), marks, departures=False))
        clipped += _beyond(value, top, f", drawn at the edge of {name}")
        words.append(f"{100.0 * float(np.mean(value[at_s >= history.start_s] <= bound)):.1f} % of the {name}")
    explained = "; ".join(meaning for _, meaning, *_ in rows)
    caption = f"{' and '.join(words)} below the bound that 95 % should keep ({explained}){clipped}."
    return Drawing("consistency", "Consistency of the estimate", caption, charts)


def _uploads(history: FlightHistory) -> Drawing | None:
    if not history.plan_changes:
        return None
    start_s, changes = history.start_s, history.plan_changes
    ready = [(one.prepared_s - start_s, one.ready_s - one.prepared_s) for one in changes if one.ready_s is not None]
    left = [(one.departed_s, one.plan.departure_s) for one in changes if one.departed_s is not None]
    departed = [(at_s - start_s, at_s - planned_s) for at_s, planned_s in left]
    failed = np.array([one.prepared_s - start_s for one in changes if one.failed])
    charts = []
    for name, points, least in (("upload took, s", ready, 0.0), ("left after plan, s", departed, None)):
        at_s, value_s = np.array(points).reshape(-1, 2).T
        stems = np.column_stack((value_s, np.zeros(len(at_s)), np.full(len(at_s), np.nan))).ravel()
        marks = [
            line((np.repeat(at_s, 3), stems), "target"),
            mark("dots", "target", name.removesuffix(", s"), x=at_s, y=value_s),
            mark("rules", "faint", y=[0.0]),
        ]
        if points is ready and len(failed):
            marks.append(mark("dots", "bad", "failed", x=failed, y=np.zeros(len(failed)), radius=4))
        charts.append(_over_time(history, Axis(name, (least, None)), marks, departures=False))
    slowest_s = f", the slowest took {max(value for _, value in ready):.2f} s" if ready else ""
    return Drawing(
        "uploads",
        "Uploads",
        f"{len(changes)} plans were sent{slowest_s}; {len(departed)} were flown, {len(failed)} failed. "
        "Below: how much later than planned the aircraft was commanded to leave its circle.",
        charts,
    )


def _beyond(value: FloatArray, limit: float, unit: str) -> str:
    """Return in words what does not fit the frame, '' where all does."""
    above = int(np.sum(value > limit))
    if not above:
        return ""
    return f"; {100.0 * above / len(value):.1f} % lie beyond the frame, up to {float(np.nanmax(value)):.0f}{unit}"


def _wanted(history: FlightHistory) -> str:
    requirement = history.requirement
    if requirement.sector is not None:
        return "sector asked for"
    return "either side" if requirement.either_side else f"{requirement.side} side"


def _judged(history: FlightHistory) -> str:
    return "by the true target" if history.judged_by_truth else "by the estimate"


def _over_time(history: FlightHistory, up: Axis, marks: Sequence[Mark], *, departures: bool = True) -> Chart:
    """Return a chart with the departures, unless left out, over its first mark."""
    departed_s = [one.departed_s - history.start_s for one in history.plan_changes if one.departed_s is not None]
    left = mark("rules", "faint", "leaves its circle", x=departed_s, dashed=True)
    shown = [*marks[:1], left, *marks[1:]] if departures and departed_s else marks
    return Chart(Axis(_TIME, (0.0, history.end_s - history.start_s), time=True), up, shown)


_STAMP = len("20261121T103058Z")
_FOR_CLIENTS = "path", "range", "observation-angle"
_TILES = "attention", "outcome", "watched", "time in band", "time on side", "range", "moves of the circle"


def report_page(flown: FlightRecord) -> str:
    """Return the report of one flight in HTML."""
    figures = {drawing.name: html.figure(drawing) for drawing in drawings(flown.history)}
    client = "\n".join(figures.pop(name) for name in _FOR_CLIENTS if name in figures)
    damaged = f"; {flown.damaged_lines} damaged lines were passed over" if flown.damaged_lines else ""
    rows = list(flown.summary.rows())
    first = [row for row in rows if row[0] in _TILES]
    others = [row for row in rows if row[0] not in _TILES]
    engineers = "\n".join((html.tiles(others), *figures.values(), _configuration(flown)))
    body = f"""<h1>Flight {escape(flown.name)}</h1>
<p class="verdict">{escape(verdict(flown.summary, flown.history.requirement))}</p>
<p>{escape(_where(flown))}. {escape(_asked(flown))}. Recorded by {escape(flown.program)}{damaged}.</p>
{html.tiles(first)}
{client}
{_decisions(flown)}
<details class="engineers"><summary>For engineers</summary>
{engineers}
</details>"""
    return html.document(f"{flown.name}: flight report", body)


def verdict(summary: Summary, requirement: Requirement) -> str:
    """Return in one sentence how well the target was watched."""
    side, band = summary.time_on_side, summary.time_in_band
    if side is None and band is None:
        return "It is not known how well the target was watched."
    limits = f"{requirement.range_min_m:g} to {requirement.range_max_m:g} m"
    shares = (side, f"from the {side_words(requirement)}"), (band, f"within {limits}")
    known = " and ".join(f"{percent(share)} of the time {where}" for share, where in shares if share is not None)
    by = "" if summary.source == "truth" else ", by its own estimate"
    return f"The target was watched for {clock(summary.duration_s)} min: {known}{by}."


def _where(flown: FlightRecord) -> str:
    history, parts = flown.history, []
    with suppress(ValueError):
        begun = datetime.strptime(flown.name[:_STAMP], "%Y%m%dT%H%M%SZ")  # it is UTC by its name
        parts.append(f"{begun:%A, %d %B %Y, %H:%M} UTC".replace(", 0", ", "))
    parts.append(f"at {history.plane.origin_latitude_deg:.4f}, {history.plane.origin_longitude_deg:.4f}")
    speeds_m_s = [one.speed_m_s for one in history.estimates]
    if speeds_m_s:
        parts.append(f"a target of up to {float(np.quantile(speeds_m_s, 0.95)):.1f} m/s")
    if history.wind is not None:
        parts.append(f"wind {math.hypot(history.wind.east_m_s, history.wind.north_m_s):.0f} m/s")
    return "; ".join(parts)


def _asked(flown: FlightRecord) -> str:
    requirement, airframe = flown.history.requirement, flown.history.asked.airframe
    return (
        f"Asked: watch from the {side_words(requirement)} "
        f"at {requirement.range_min_m:g} to {requirement.range_max_m:g} m, "
        f"circles of {airframe.radius_m:g} m at {airframe.airspeed_m_s:g} m/s"
        + "".join(
            f"; from {since_s - flown.history.start_s:.0f} s on from the {side_words(one)} "
            f"at {one.range_min_m:g} to {one.range_max_m:g} m"
            for since_s, one in flown.history.requirements[1:]
        )
    )


def _decisions(flown: FlightRecord) -> str:
    announced, start_s = flown.history.announced, flown.history.start_s
    numbers = {id(one): str(number) for number, one in enumerate(flown.history.moves, 1)}
    rows = [(clock(one.time_s - start_s), numbers.get(id(one), ""), one.kind, one.text) for one in announced]
    words = f"Decisions and announcements ({len(rows)})"
    return html.folded(words, html.table((), rows, words), is_open=True) if rows else ""


def _configuration(flown: FlightRecord) -> str:
    sections = flown.config.model_dump(mode="json").items()
    rows = [
        (f"{section}.{key}", str(value))
        for section, keys in sections
        for key, value in keys.items()
        if value not in (None, [])
    ]
    return html.folded("Configuration", html.table((), rows, "Configuration"))
