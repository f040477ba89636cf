"""requirements.txt: what a plain install takes, by hash. It agrees with the dependencies and with constraints.txt."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
ENTRY = re.compile(r"(?P<name>[\w.-]+)==(?P<version>[\w.]+)(?P<hashes>( \\\n    --hash=sha256:[0-9a-f]{64})+)\n")
REMEDY = "write it again by pip-compile"


@pytest.fixture(scope="module")
def pinned() -> dict[str, str]:
    """Return the versions in requirements.txt, by name."""
    text = re.sub(r"^(#.*)?\n", "", (ROOT / "requirements.txt").read_text(), flags=re.MULTILINE)
    entries = list(ENTRY.finditer(text))
    assert "".join(entry[0] for entry in entries) == text, "there is more in it than names, versions and hashes"
    return {canonicalize_name(entry["name"]): entry["version"] for entry in entries}


def test_the_versions_are_those_of_the_constraints(pinned):
    lines = (ROOT / "constraints.txt").read_text().split()
    constraints = {canonicalize_name(name): version for name, _, version in (line.partition("==") for line in lines)}
    assert pinned == {name: constraints.get(name) for name in pinned}, REMEDY


def test_nothing_is_missing_that_a_plain_install_and_its_build_take(pinned):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = [Requirement(text) for text in project["project"]["dependencies"] + project["build-system"]["requires"]]
    taken: set[str] = set()
    while wanted:
        one = wanted.pop()
        name = canonicalize_name(one.name)
        if name in taken or not (one.marker is None or one.marker.evaluate({"extra": ""})):
            continue
        taken.add(name)
        assert name in pinned, f"{one} is missing: {REMEDY}"
        assert pinned[name] in one.specifier, f"{one}: {REMEDY}"
        wanted += [] if name == "setuptools" else map(Requirement, requires(name) or [])


def test_the_security_document_lists_every_package_that_users_install():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert sorted(re.findall(r"^\| ([a-z0-9]+) \| [^|]+ \| [^|]+ \|$", text, re.MULTILINE)) == _names(
        project["dependencies"]
    )
    listed = {}
    for names, packages in re.findall(r"^\| (`[^|]+`) \| ([^|]+) \|$", text, re.MULTILINE):
        listed |= dict.fromkeys(re.findall(r"`(\w+)`", names), sorted(re.findall(r"([a-z0-9-]+) \(", packages)))
    assert listed == {name: _names(extras[name]) for name in extras if name not in ("dev", "docs", "bench", "jsbsim")}


def _names(requirements: list[str]) -> list[str]:
    return sorted(Requirement(line).name for line in requirements)
