"""The page of all commands, from the command line's own definitions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from sidelong.app.cli import COMMANDS, help_groups, load_command


def page() -> str:
    """Return the page in Markdown."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield "# Commands\n"
    yield "This page is generated from the command line's definitions. `sidelong COMMAND --help` prints the same.\n"
    yield "| command | what it does |\n| --- | --- |"
    for name, (_, about) in COMMANDS.items():
        yield f"| [`{name}`](#{name}) | {about} |"
    yield "\n| exit code | meaning |\n| --- | --- |"
    yield "| 0 | done |"
    yield "| 1 | the flight failed; the message states the reason and what the aircraft does now |"
    yield "| 2 | invalid input; the message names the option, field or file and what to change |"
    yield "| 130 | interrupted; the message states what the aircraft does now |"
    for name in COMMANDS:
        yield from _command(name, load_command(name))


def _command(name: str, command: Any) -> Iterator[str]:
    about, _, examples = (command.help or "").replace("\b", "").partition("For example:")
    yield f"\n## {name}\n"
    yield "\n\n".join(re.sub(r"\s+", " ", part) for part in about.strip().split("\n\n"))
    if examples.strip():
        lines = "\n".join(line.strip() for line in examples.strip().splitlines())
        yield f"\n```sh\n{lines}\n```\n"
    context = command.make_context(name, [], resilient_parsing=True)
    for group, records in help_groups(command, context).items():
        rows = [f"| `{option}` | {_cell(about)} |" for option, about in records if option != "--help"]
        if rows:
            yield f"\n| {group} | |\n| --- | --- |"
            yield from rows


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")
