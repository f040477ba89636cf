"""The report of a flight: what it shows is what was flown, and it needs nothing but itself."""

from __future__ import annotations

import html
import json
import math
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sidelong.app.analysis.score import Moment
from sidelong.app.assembly import tracker_of
from sidelong.app.commands.export import write_export
from sidelong.app.commands.report import write_report
from sidelong.app.errors import InputError
from sidelong.app.records.export import Format
from sidelong.app.records.log import LogContext
from sidelong.app.report.history import AircraftTrack, HistoryBuilder, curvature_per_m, feed, read_flight
from sidelong.app.report.page import report_page
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.fleet import FleetAdvice, Role
from sidelong.mission.core.requirement import Side
from sidelong.mission.route.route import RouteProgress, route_of
from tests.command_line import sidelong
from tests.logs import dataflash_pieces
from tests.messages import message

FIGURES = [
    "path",
    "range",
    "observation-angle",
    "observation-histogram",
    "curvature",
    "course",
    "target-speed",
    "estimate-error",
    "consistency",
    "uploads",
]
SVG = "http://www.w3.org/2000/svg"  # a name, not an address


@pytest.fixture(scope="module")
def flown(run_folder):
    return read_flight(run_folder)


@pytest.fixture(scope="module")
def page(flown) -> str:
    return report_page(flown)


class Elements(HTMLParser):
    """Every element's name and attributes, and the ids."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def values(self, name: str) -> list[str]:
        return [attributes[name] for _, attributes in self.found if name in attributes]


def charts_of(page: str) -> dict[str, list[dict[str, Any]]]:
    """Return the charts of each figure, as the page has them as data."""
    found = re.findall(r'<figure id="([^"]+)">.*?<script type="application/json">(.*?)</script>', page, re.DOTALL)
    return {name: json.loads(data) for name, data in found}


def test_the_page_refers_to_nothing_outside_itself(page):
    elements = Elements(page)
    assert "://" not in page.replace(SVG, "")
    assert not {"link", "iframe", "object", "base"} & {tag for tag, _ in elements.found}
    assert elements.values("href") == elements.values("src") == []
    assert "url(" not in page
    assert "default-src 'none'" in elements.values("content")[0]  # the browser refuses the rest


def test_each_id_is_unique(page):
    ids = Elements(page).values("id")
    assert len(ids) == len(set(ids))


def test_the_page_is_small(page):
    assert len(page.encode()) < 1_000_000


def test_all_figures_are_there_in_order(page):
    assert [a["id"] for tag, a in Elements(page).found if tag == "figure"] == FIGURES


def test_the_same_flight_gives_the_same_page(page, run_folder):
    assert report_page(read_flight(run_folder)) == page


def test_a_run_may_be_named_by_its_journal(run_folder, tmp_path):
    journal, out = run_folder / "journal.jsonl", tmp_path / "out"
    assert f"report: {out}" in sidelong("report", journal, "--out", out).stdout
    assert "time in band" in sidelong("replay", journal).stdout


def test_the_figure_of_the_route_shows_when_it_was_not_used(flown):
    route = route_of(np.zeros(2), np.array([0.0, 500.0]))
    used = RouteProgress(route, True, 200.0, 4.0, 0.9, 75.0)
    off = RouteProgress(route, False, math.nan, math.nan, 0.1, math.nan)
    seconds = enumerate([used, used, replace(used, of_use=False), off], math.ceil(flown.history.start_s))
    page = report_page(replace(flown, history=replace(flown.history, progress=tuple(seconds))))
    assert "On the route 75.0 % of the time, 25.0 % not used: straight on predicts the target better;" in page
    route_chart = charts_of(page)["route"][0]
    assert [mark["label"] for mark in route_chart["marks"] if mark["label"]][-2:] == ["not used", "target (estimate)"]
    assert [len(mark["rects"]) for mark in route_chart["marks"] if mark["kind"] == "bands"] == [1, 1]


def test_decisions_are_reported_in_words(page, flown):
    decisions = [one.text for one in flown.history.announced if one.kind == "decision"]
    assert len(decisions) >= len(flown.history.plan_changes) > 0
    assert all(html.escape(text) in page for text in decisions)


def test_uploads_have_their_times(flown):
    assert flown.history.plan_changes
    for change in flown.history.plan_changes:
        assert change.ready_s == pytest.approx(change.prepared_s + 0.4)
        assert change.departed_s == pytest.approx(change.plan.departure_s, abs=0.15)


def test_a_cut_off_run_is_judged_by_its_truth(flown):
    summary = flown.summary
    assert summary.outcome.startswith("the record ends early, at 300 s")
    assert summary.source == "truth"
    assert summary.moves == len(flown.history.plan_changes)
    ranges_m = flown.history.judged.range_m
    assert summary.min_range_m == pytest.approx(ranges_m.min())
    assert summary.max_range_m == pytest.approx(ranges_m.max())
    assert 0.1 < summary.estimate_rmse_m < 3.0


def test_without_a_truth_the_estimate_judges(run_folder, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(run_folder, copy)
    (copy / "truth.csv").unlink()
    flown = read_flight(copy)
    assert flown.summary.source == "estimate"
    assert flown.summary.estimate_rmse_m is None
    assert 'id="estimate-error"' not in report_page(flown)


def test_a_journal_cut_in_mid_line_still_makes_a_report(run_folder, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(run_folder, copy)
    journal = copy / "journal.jsonl"
    data = journal.read_bytes()
    journal.write_bytes(data[: len(data) // 2])
    flown = read_flight(copy)
    assert flown.history.end_s - flown.history.start_s == pytest.approx(150.0, abs=15.0)


def test_time_with_a_frozen_gimbal_is_unknown_in_replay_and_report_alike(tmp_path):
    log, result = tmp_path / "frozen.bin", tmp_path / "summary.json"
    log.write_bytes(b"".join(dataflash_pieces()))
    replayed = sidelong("replay", log, "--json", result)
    assert "the gimbal: its orientation is frozen" in replayed.stdout
    summary, reported = json.loads(result.read_text()), read_flight(log).summary
    assert summary["duration_s"] == pytest.approx(29.0, abs=1.0)
    assert summary["time_in_band"] < 0.3
    assert summary["moves"] == reported.moves == 0
    assert reported.sightings == summary["sightings"]
    assert reported.time_in_band == pytest.approx(summary["time_in_band"], abs=0.05)
    assert reported.time_unknown == pytest.approx(summary["time_unknown"], abs=0.05)


def test_the_observation_angle_has_no_values_while_the_inputs_are_unknown(flown):
    history = flown.history
    unknown = np.arange(len(history.moments)) > 200
    moments = [replace(one, known=not out) for one, out in zip(history.moments, unknown.tolist(), strict=True)]
    judged = replace(history, moments=tuple(moments)).judged
    assert not np.isfinite(judged.observation_rad[unknown]).any()
    assert np.array_equal(judged.observation_rad[~unknown], history.judged.observation_rad[~unknown], equal_nan=True)


def test_the_tutorial_names_the_figures_as_the_page_does(page):
    text = (Path(__file__).parents[2] / "docs" / "tutorials" / "reading-a-report.md").read_text(encoding="utf-8")
    rows = text.partition("| figure |")[2].partition("## The tiles")[0].splitlines()[2:]
    names = [row.split("|")[1].strip() for row in rows if row.startswith("|")]
    assert len(names) == 9
    assert all(name in page for name in names)


def test_a_log_of_two_flights_is_named_by_each_command(tmp_path):
    flight = (Path(__file__).parents[1] / "data" / "no-laser-vtol.tlog").read_bytes()
    for flights, warned in ((1, False), (2, True)):
        log = tmp_path / f"{flights}.tlog"
        log.write_bytes(flights * flight)
        for command in ("replay", "report", "export"):
            words = sidelong(command, log).stdout
            assert (f"{flights}.tlog: warning: the vehicle's clock starts again in it (2 flights)" in words) is warned


def context_of(messages) -> LogContext:
    context = LogContext()
    for one in messages:
        context.take(one)
    return context


def test_of_a_log_of_two_vehicles_only_the_first_counts_and_the_other_is_named():
    messages = [
        message("HEARTBEAT", type=1, autopilot=3),
        message("HOME_POSITION", altitude=500_000),
        message("HEARTBEAT", system=2, type=2, autopilot=12),
        message("HOME_POSITION", system=2, altitude=90_000),
        message("HEARTBEAT", system=255, type=6, autopilot=8),
    ]
    context = context_of(messages)
    assert context.warning.endswith("the results are of the vehicle of system 1 only; it also has 2")
    assert (context.home_altitude_m, context.kind, context.autopilot) == (500.0, 1, LogContext().autopilot)


@pytest.mark.parametrize(("kind", "warning"), [(1, ""), (2, "the vehicle is of MAV_TYPE 2, no fixed wing")])
def test_a_log_of_no_fixed_wing_is_named(kind, warning):
    heartbeats = [message("HEARTBEAT", type=kind, autopilot=3), message("HEARTBEAT", 100, type=30, autopilot=8)]
    context = context_of(heartbeats)
    assert warning in context.warning
    assert bool(warning) is bool(context.warning)


def test_tracks_of_a_run_without_its_tlog_can_be_exported(run_folder, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(run_folder, copy, ignore=shutil.ignore_patterns("flight.tlog"))
    write_export(copy, Format.GEOJSON, tmp_path / "out.geojson")
    names = [one["properties"]["name"] for one in json.loads((tmp_path / "out.geojson").read_text())["features"]]
    assert names[:2] == ["aircraft", "target"]


def test_the_charts_have_what_was_flown(page, flown):
    (chart,) = charts_of(page)["range"]
    drawn = next(mark for mark in chart["marks"] if mark["kind"] == "line")
    judged = flown.history.judged
    assert drawn["x"] == pytest.approx(judged.time_s - flown.history.start_s, abs=0.1)
    assert drawn["y"] == pytest.approx(judged.range_m, abs=0.1)
    (ways,) = charts_of(page)["path"]
    path = next(mark for mark in ways["marks"] if mark["label"] == "aircraft")
    since = flown.history.aircraft.time_s >= flown.history.start_s
    assert path["x"] == pytest.approx(flown.history.aircraft.east_m[since], abs=0.1)


def test_over_hills_the_shaded_ground_lies_under_the_paths(flown):
    east_m, north_m = np.meshgrid(*[np.arange(-3000.0, 3001.0, 60.0)] * 2)
    ground = Ground((0.1 * east_m + 0.05 * north_m).astype(np.float32), -3000.0, -3000.0, 60.0, 60.0)
    history = replace(flown.history, asked=replace(flown.history.asked, ground=ground))
    first, *_ = charts_of(report_page(replace(flown, history=history)))["path"][0]["marks"]
    assert first["kind"] == "image"
    assert first["href"].startswith("data:image/png;base64,")
    west_m, east_m, south_m, north_m = first["rect"]
    track = history.aircraft
    assert west_m < track.east_m.min() < track.east_m.max() < east_m < 3100.0
    assert south_m < track.north_m.min() < track.north_m.max() < north_m < 3100.0


def test_a_name_cannot_end_the_script_of_a_chart(flown):
    hostile = replace(flown.history.announced[0], kind="decision", text="moving </script><script>alert(1)</script>")
    page = report_page(replace(flown, name="</script>", history=replace(flown.history, announced=(hostile,))))
    assert "<script>alert" not in page
    assert len(charts_of(page)) == len(FIGURES)


@pytest.mark.parametrize("name", ["missing", "empty"])
def test_what_is_no_flight_is_reported_in_a_sentence(name, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=name):
        write_report(tmp_path / name, tmp_path / "out.html")


def test_a_page_that_cannot_be_written_is_reported_before_the_work(run_folder, tmp_path):
    with pytest.raises(InputError, match="--out"):
        write_report(run_folder, tmp_path / "no" / "folder.html")


@pytest.mark.parametrize("clockwise", [True, False])
def test_curvature_of_a_circle_is_one_over_its_radius(clockwise):
    sign, time_s = (1.0 if clockwise else -1.0), np.arange(0.0, 60.0, 0.2)
    course_rad = sign * time_s * 15.0 / 50.0
    wrapped_rad = np.arctan2(np.sin(course_rad), np.cos(course_rad))
    still = np.zeros_like(time_s)
    _, flown_per_m = curvature_per_m(AircraftTrack(time_s, still, still, wrapped_rad, still + 15.0))
    assert flown_per_m == pytest.approx(np.full(len(flown_per_m), sign / 50.0), rel=1e-6)


def test_the_observation_angle_counts_from_abeam_and_keeps_the_course_through_a_stop(flown):
    # The target drives north, then stands; left of it is west. At first it has made good no course.
    places = [(0.0, -200.0), (-200.0, 0.0), (0.0, 200.0), (200.0, 0.0), (-200.0, 0.0)]
    moments = tuple(
        Moment(float(n), east_m, north_m, 0.0, 0.0 if n else -12.0, 0.0, 0.0 if n > 1 else 12.0)
        for n, (east_m, north_m) in enumerate(places)
    )
    before, *angles = replace(flown.history, moments=moments).judged.observation_rad
    assert math.isnan(before)
    assert angles[0] == pytest.approx(0.0)
    assert angles[1] == pytest.approx(math.pi / 2)
    assert abs(angles[2]) == pytest.approx(math.pi)
    assert angles[3] == pytest.approx(0.0)


def test_the_report_opens_offline_in_a_browser(page, tmp_path, browser):
    file = tmp_path / "report.html"
    file.write_text(page, encoding="utf-8")
    shown = browser.new_context(offline=True).new_page()
    asked: list[str] = []
    shown.on("request", lambda request: asked.append(request.url))
    complaints: list[str] = []
    shown.on("console", lambda message: complaints.append(message.text))
    shown.goto(file.as_uri())
    assert asked == [file.as_uri()]
    assert complaints == []
    verdict = shown.locator(".verdict").inner_text()
    assert re.fullmatch(r"The target was watched for \d+:\d\d min: .* % of the time from the left and .*", verdict)
    assert shown.locator("details[open] td", has_text=re.compile("^1$")).count() == 1  # the number on the map
    assert not shown.locator("#consistency svg[role]").first.is_visible()
    shown.locator(".engineers > summary").click()
    shown.locator("#uploads .mark").first.wait_for(state="attached")
    boxes = [shown.locator(f"#{name} svg[role]").first.bounding_box() for name in FIGURES]
    assert all(box["width"] > 600 and box["height"] > 150 for box in boxes)
    shown.context.close()


def test_a_value_is_shown_under_the_pointer_and_a_dragged_frame_is_zoomed_to(page, tmp_path, browser):
    file = tmp_path / "report.html"
    file.write_text(page, encoding="utf-8")
    shown = browser.new_page()
    shown.goto(file.as_uri())
    chart = shown.locator("#range svg[role]")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    ticks = shown.locator("#range .grid text")
    whole = ticks.all_inner_texts()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.mouse.move(x, y)
    assert re.fullmatch(r"\d:\d\d(\.\d)?\nby the true target: \d+", shown.locator("#range .tip").inner_text())
    shown.mouse.down()
    shown.mouse.move(x + 0.1 * box["width"], y)
    shown.mouse.up()
    assert ticks.all_inner_texts() != whole
    chart.dblclick()
    assert ticks.all_inner_texts() == whole
    shown.close()


def test_what_is_seen_before_the_fleet_names_its_target_is_of_the_first_one_named(flown, run_folder):
    builder, seen = HistoryBuilder(tracker_of(flown.config)), []
    feed(run_folder, SimpleNamespace(event=seen.append, command=lambda _: None))
    named_s = seen[len(seen) // 2].time_s
    for event in seen:
        builder.event(event)
        if event.time_s == named_s:
            builder.event(FleetAdvice(named_s, "boat", Role.WANTED, Side.LEFT, None, 100.0, ()))
    history = builder.build(flown.history.asked, flown.history.plane, None)
    assert history.estimates[0].time_s < named_s
    assert set(history.targets) == {one.target for one in history.moments} == {"boat"}
