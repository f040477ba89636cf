"""Reports in a real browser: everybody can read them, on a telephone, too."""

from __future__ import annotations

import pytest
from axe_playwright_python.sync_playwright import Axe
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.commands.report import write_report

STUDY = (
    *(
        "study",
        "--planner",
        "lvfg",
        "--planner",
        "park",
        "--set",
        "study.perfect_sensors=true",
        "--runs",
        "2",
        "--duration",
        "60",
    ),
    *("--jobs", "1", "--sweep", "aircraft.airspeed_m_s=10,12", "--sweep", "requirement.range_max_m=400,500"),
)


@pytest.fixture(scope="module")
def reports(run_folder, tmp_path_factory):
    """Return the pages about a flight and about a study."""
    folder = tmp_path_factory.mktemp("reports")
    flight, study = folder / "flight.html", folder / "study.html"
    write_report(run_folder, flight)
    done = CliRunner().invoke(app, [*STUDY, "--report", str(study)])
    assert done.exit_code == 0, done.output
    return {"flight": flight, "study": study}


@pytest.mark.parametrize("name", ["flight", "study"])
@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (390, "dark")])
def test_everybody_can_read_it(browser, reports, name, width, scheme):
    page = browser.new_context(viewport={"width": width, "height": 844}, color_scheme=scheme).new_page()
    page.goto(reports[name].as_uri())
    page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]})
    assert found.violations_count == 0, found.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth") <= width  # what is wide scrolls on its own
    page.context.close()
