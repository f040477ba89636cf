import math
from dataclasses import replace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sidelong.mission.core.feasibility import in_words
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.paper.scope import infeasible, scope

AIRCRAFT = Aircraft(airspeed_m_s=10.0, radius_m=50.0)
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0, 1.0)


def test_the_papers_example_is_feasible() -> None:
    assert infeasible(AIRCRAFT, REQUIREMENT) == ()
    verdict = scope(AIRCRAFT, REQUIREMENT)
    assert verdict.x_tr_m == pytest.approx(192.153, abs=5e-4)
    assert verdict.shortest_time_s == pytest.approx(110.907, abs=5e-4)
    assert verdict.straight_left_m == pytest.approx(48.416, abs=5e-4)


def test_a_small_threshold_fails_and_the_least_one_is_named() -> None:
    reasons = infeasible(AIRCRAFT, replace(REQUIREMENT, threshold=0.8))
    threshold = next(change for change in reasons if change.field == "threshold")
    assert str(threshold) == (
        "a move of 227 m would be wanted, but the transition needs 284 m: threshold must be at least 0.9081, not 0.8"
    )


@pytest.mark.parametrize(
    ("aircraft", "requirement", "fields"),
    [
        (replace(AIRCRAFT, radius_m=8.0), REQUIREMENT, {"radius_m", "airspeed_m_s"}),
        (AIRCRAFT, replace(REQUIREMENT, range_max_m=199.0), {"range_max_m", "range_min_m", "radius_m"}),
        (AIRCRAFT, replace(REQUIREMENT, target_speed_max_m_s=11.0), {"target_speed_max_m_s", "airspeed_m_s"}),
    ],
)
def test_each_cause_names_its_numbers(aircraft: Aircraft, requirement: Requirement, fields: set[str]) -> None:
    assert fields <= {change.field for change in infeasible(aircraft, requirement)}


def test_a_reason_is_reported_once_with_all_that_would_help() -> None:
    reasons = infeasible(replace(AIRCRAFT, radius_m=8.0), replace(REQUIREMENT, range_max_m=110.0))
    tight, narrow = in_words(reasons[:5]).split("; ")
    assert tight.startswith("the circle is tighter than a bank of 45 degrees allows: radius_m must be at least ")
    assert narrow == (
        "the circle does not fit between the least and the greatest range: "
        "range_max_m must be at least 116, not 110, or range_min_m must be at most 94, not 100, "
        "or radius_m must be at most 5, not 8"
    )


@given(
    airspeed_m_s=st.floats(8, 25),
    radius_m=st.floats(5, 250),
    range_min_m=st.floats(20, 300),
    band_m=st.floats(50, 800),
    target_speed_max_m_s=st.floats(0, 20),
    threshold=st.floats(0.5, 1.0),
    psi_c_rad=st.floats(0.2, math.pi / 2),
)
def test_every_named_value_cures_its_cause(
    airspeed_m_s: float,
    radius_m: float,
    range_min_m: float,
    band_m: float,
    target_speed_max_m_s: float,
    threshold: float,
    psi_c_rad: float,
) -> None:
    aircraft = Aircraft(airspeed_m_s, radius_m)
    requirement = Requirement(range_min_m, range_min_m + band_m, Side.LEFT, target_speed_max_m_s, threshold)
    reasons = infeasible(aircraft, requirement, psi_c_rad)
    assume(reasons)
    for change in reasons:
        value = change.nearest_rounded
        assert math.isclose(value, change.nearest, rel_tol=2e-3)
        if hasattr(aircraft, change.field):
            after = infeasible(replace(aircraft, **{change.field: value}), requirement, psi_c_rad)
        else:
            after = infeasible(aircraft, replace(requirement, **{change.field: value}), psi_c_rad)
        cause = change.because.split(" of ")[0]
        assert cause not in {other.because.split(" of ")[0] for other in after}
