from dataclasses import replace

import pytest

from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.predictive.planner import table_configuration
from sidelong.mission.predictive.value_table import compute


@pytest.fixture(scope="session")
def paper_aircraft():
    return Aircraft(airspeed_m_s=10.0, radius_m=50.0)


@pytest.fixture(scope="session")
def paper_requirement():
    return Requirement(100.0, 500.0, Side.LEFT, 5.0)


@pytest.fixture(scope="session")
def paper_table(paper_aircraft, paper_requirement):
    """The real table of the paper's requirement, on a coarser grid than in use: some seconds, once."""
    configuration = table_configuration(paper_aircraft, paper_requirement)
    return compute(replace(configuration, cells=20, improvements=(5, 3)))


@pytest.fixture
def on_circle():
    """Returns the state of an aircraft that flies a circle, on a given course."""

    def state(circle, course_rad, time_s=0.0, speed_m_s=10.0):
        east_m, north_m = circle.position_at_course(course_rad)
        return AircraftState(time_s, east_m, north_m, course_rad, speed_m_s, circle.curvature_per_m)

    return state
