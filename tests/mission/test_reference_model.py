import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sidelong.mission.core.circle import Circle
from sidelong.mission.paper.planner import RelativePosition, displacement_m


def test_the_model_is_the_integral_of_the_papers_equations() -> None:
    """l' = -v cos(theta - psi), theta' = (v / l) sin(theta - psi), one and a half laps of R = 50 at 10 m/s."""
    speed_m_s, radius_m, duration_s = 10.0, 50.0, 47.0
    circle = Circle(0.0, 150.0, radius_m, True)
    begin_rad = -math.pi / 2  # at the circle's south, heading west

    def rates(time_s: float, state: list[float]) -> list[float]:
        range_m, bearing_rad = state
        lead_rad = bearing_rad - (begin_rad + speed_m_s / radius_m * time_s)
        return [-speed_m_s * math.cos(lead_rad), speed_m_s / range_m * math.sin(lead_rad)]

    start = RelativePosition.of(0.0, -100.0)
    solved = solve_ivp(rates, (0.0, duration_s), [start.range_m, start.bearing_rad], rtol=1e-10, atol=1e-10)

    model = start
    at_m = circle.position_at_course(begin_rad)
    for step in range(1, 48):
        next_m = circle.position_at_course(begin_rad + speed_m_s / radius_m * step)
        model = model.after_flying(next_m[0] - at_m[0], next_m[1] - at_m[1])
        at_m = next_m
    assert model.range_m == pytest.approx(solved.y[0, -1], abs=1e-6)
    assert math.remainder(model.bearing_rad - solved.y[1, -1], 2 * math.pi) == pytest.approx(0.0, abs=1e-8)


@given(
    target_m=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    moved_m=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    flown_m=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
def test_the_error_vector_is_the_targets_own_displacement(
    target_m: tuple[float, float], moved_m: tuple[float, float], flown_m: tuple[float, float]
) -> None:
    reference = RelativePosition.of(*target_m).after_flying(*flown_m)
    measured = RelativePosition.of(target_m[0] + moved_m[0] - flown_m[0], target_m[1] + moved_m[1] - flown_m[1])
    assert displacement_m(measured, reference) == pytest.approx(moved_m, abs=1e-9)
