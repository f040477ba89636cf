"""House rules for committed files that no linter checks; ruff, mypy and the import contracts run before the tests."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_no_machine_path_and_no_registry_is_named():
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    forbidden = ["/" + "home/", "/" + "root/", "py" + "pi.org", "python" + "hosted.org", "npm" + "js.org"]
    for name in names:
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt", ".csv", ".gpx", ""} and path.is_file():
            text = path.read_text(encoding="utf-8", errors="replace")
            assert not [word for word in forbidden if word in text], name


def test_every_hazard_names_a_rule_and_a_test_that_exists():
    page = (ROOT / "docs" / "explanation" / "hazards.md").read_text(encoding="utf-8")
    tables = page.split("## Unsafe control actions")[1].split("## ")
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for part in tables for line in part.splitlines()]
    rows = [row for row in rows if len(row) > 3 and not {"rule", "---"} & set(row)]
    assert len(rows) > 30
    for row in rows:
        named = re.findall(r"`(tests/[a-z_/0-9]+\.py)(?:::(test_\w+))?`", " ".join(row))
        assert [test for _, test in named if test], row
        assert len(row[2]) > 5, row  # the rule
        for file, test in named:
            text = (ROOT / file).read_text(encoding="utf-8")
            assert not test or f"def {test}(" in text, (row[0], file, test)
