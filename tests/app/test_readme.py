"""The commands that the documents show can be given as they stand there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from sidelong.app.cli import COMMANDS, help_groups, load_command

ROOT = Path(__file__).resolve().parents[2]
_COMMAND = re.compile(r"\bsidelong (?!sidelong)([a-z]+)((?:[ ]+[^\s`|#]+)*)")


DOCUMENTS = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
    *(ROOT / "docs").rglob("*.md"),
)


def shown() -> list[tuple[str, str]]:
    """Return (command, arguments) of every command line in the documents."""
    found = []
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8").replace("\\\n", " ")
        code = re.findall(r"```sh\n(.*?)```", text, re.DOTALL) + re.findall(r"`((?:SIDE[A-Z_=\w]+ )?[^`\n]*)`", text)
        for line in (line for block in code for line in re.split(r"\n|&&|;|   +", block)):
            found += [(name, rest.strip()) for name, rest in _COMMAND.findall(line)]
    return sorted(set(found))


@pytest.mark.parametrize(("name", "arguments"), shown(), ids=lambda part: part or "-")
def test_a_command_of_the_documents_is_understood(name, arguments):
    assert name in COMMANDS
    words = shlex.split(arguments.replace("...", "0,0,1,1").replace("RUN\\|LOG", "run"))
    words = ["1,2,3,4" if word == "S,W,N,E" else word for word in words]
    context = load_command(name).make_context(name, words)
    assert context.command.name == name


@pytest.mark.parametrize("document", sorted((ROOT / "docs").glob("[th]*/*.md")), ids=lambda path: path.stem)
def test_a_tutorial_runs_the_program_that_the_installation_made(document):
    text = document.read_text(encoding="utf-8")
    commands = re.findall(rf"(\S*)\bsidelong (?:{'|'.join(COMMANDS)})\b", text)
    assert set(commands) <= {".venv/bin/", "`.venv/bin/"}, commands


@pytest.mark.parametrize("name", COMMANDS)
def test_help_explains_every_option_in_short_groups_and_shows_valid_examples(name):
    command = load_command(name)
    with command.make_context(name, [], resilient_parsing=True) as context:
        lines = re.findall(rf"^ +sidelong {name}\b([^#\n]*)", command.get_help(context), re.MULTILINE)
        groups = help_groups(command, context)
    assert lines
    for arguments in lines:
        command.make_context(name, shlex.split(arguments))
    assert all(about for records in groups.values() for _, about in records)
    assert max(map(len, groups.values())) <= 12, "group the options by rich_help_panel"


@pytest.mark.parametrize("document", DOCUMENTS[:3], ids=lambda path: path.name)
def test_a_link_between_documents_leads_somewhere(document):  # mkdocs checks those of the site
    for file, place in re.findall(r"\]\(([\w./-]*)(?:#([\w-]+))?\)", document.read_text(encoding="utf-8")):
        there = document.parent / file if file else document
        assert there.exists(), file
        headings = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE) if place else []
        assert not place or place in {heading.lower().replace(" ", "-") for heading in headings}, place


def test_the_readme_lists_every_command():
    listed = re.findall(r"^\| `([a-z]+)", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(COMMANDS) <= set(listed)
