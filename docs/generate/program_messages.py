"""The page of messages that the program can print, collected from the source.

A message is the text of an error, an announcement, an alarm or a warning. A part in <angle brackets> is filled in.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

_CALLS = {
    "InputError": "input",
    "LinkError": "link",
    "FlightError": "flight",
    "ValueError": "value",
    "warn": "warning",
}
_GROUPS = {
    "input": (
        "Invalid input (exit code 2)",
        "The command did nothing. Change what the message names, then repeat the command.",
    ),
    "value": (
        "Values of a configuration (exit code 2)",
        "The message is preceded by the file and the key. Change the value, then repeat the command.",
    ),
    "flight": (
        "Failed flights (exit code 1)",
        "The message states what the aircraft does now. Remove the cause, then start `sidelong launch` again:"
        " it takes over an aircraft that flies its circle.",
    ),
    "link": (
        "The link",
        "The link cannot be used. Check the URL, the cable and the other programs on it.",
    ),
    "warning": ("Warnings", "The command goes on. The message states what is missing or different."),
    "flown": (
        "Announcements of a flight",
        "These are printed during a flight, logged in the journal and shown on the page. The table of"
        " [what the terminal prints](../how-to/read-the-terminal.md) explains the common ones.",
    ),
}
# Where announcements, alarms and reports of a flight are worded.
_FLOWN = (
    "mission/control",
    "mission/exchange",
    "mission/health",
    "mission/predictive/planner.py",
    "mission/viewpoint",
    "mission/fleet/coordinator.py",
    "mission/fleet/coordinator.py",
    "app/flight",
)
_FOLDERS = ("app", "mission", "estimators", "sitl")
_WORDS = 3  # a text of fewer words is a name or a unit


def page(root: Path) -> str:
    """Return the page in Markdown."""
    return "\n".join(_lines(root)) + "\n"


def _lines(root: Path) -> Iterator[str]:
    found: dict[str, dict[str, set[str]]] = {group: {} for group in _GROUPS}
    for path in (path for folder in _FOLDERS for path in sorted((root / folder).rglob("*.py"))):
        module = path.relative_to(root).as_posix()
        for group, text in _messages(path, module):
            found[group].setdefault(text, set()).add(module.removesuffix(".py"))
    yield "# Messages of the program\n"
    yield "Generated from the source. A part in *italics* is filled in. Search for a word of the message.\n"
    for group, (title, meaning) in _GROUPS.items():
        yield f"\n## {title}\n\n{meaning}\n\n| message | from |\n| --- | --- |"
        for text, modules in sorted(found[group].items(), key=lambda item: (sorted(item[1]), item[0])):
            yield f"| {text} | `{', '.join(sorted(modules))}` |"


def _messages(path: Path, module: str) -> Iterator[tuple[str, str]]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    parts -= {id(node) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)}
    taken = set(map(id, _docstrings(tree)))
    for node in ast.walk(tree):
        name = _called(node)
        if name in _CALLS:
            assert isinstance(node, ast.Call)
            for text in _texts(node, parts | taken):
                taken.add(id(text))
                yield _CALLS[name], _markdown(text)
    if module.startswith(_FLOWN):
        for text in _texts(tree, parts | taken):
            yield "flown", _markdown(text)


def _docstrings(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node.value


def _called(node: ast.AST) -> str:
    if not isinstance(node, ast.Call):
        return ""
    return getattr(node.func, "id", None) or getattr(node.func, "attr", "")


def _texts(node: ast.AST, left_out: set[int]) -> Iterator[ast.Constant | ast.JoinedStr]:
    for part in ast.walk(node):
        if id(part) in left_out or not isinstance(part, ast.JoinedStr | ast.Constant):
            continue
        if isinstance(part, ast.Constant) and not isinstance(part.value, str):
            continue
        if len(re.findall(r"[A-Za-z]{2,}", _plain(part))) >= _WORDS:
            yield part


def _plain(text: ast.Constant | ast.JoinedStr) -> str:
    if isinstance(text, ast.Constant):
        return str(text.value)
    return "".join(str(part.value) if isinstance(part, ast.Constant) else " " for part in text.values)


def _markdown(text: ast.Constant | ast.JoinedStr) -> str:
    parts = [text] if isinstance(text, ast.Constant) else text.values
    words = "".join(
        _escaped(str(part.value)) if isinstance(part, ast.Constant) else f"*{_name(part.value)}*" for part in parts
    )
    return re.sub(r"\s+", " ", words).strip()


def _name(value: ast.AST) -> str:
    """Return the last name in an expression, as words."""
    names = re.findall(r"[A-Za-z_][A-Za-z_]+", ast.unparse(value).split("(")[0].split("[")[0]) or ["value"]
    return _escaped(names[-1].strip("_").replace("_", " ")) or "value"


def _escaped(text: str) -> str:
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", text)
