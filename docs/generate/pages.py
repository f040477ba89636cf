"""MkDocs hook: adds the pages that are generated from the code, and the documents that stand at the top level."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import api
import commands
import configuration
import mavlink_messages
import program_messages
from equations import math_fence
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
_TOP_LEVEL = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "SECURITY.md": "security.md"}
_API = "reference/api/index.md"
_LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)")


def on_config(config: Any) -> Any:
    """Let fenced blocks of kind ``math`` become MathML, and put the pages of whole folders into the navigation."""
    fences = config["mdx_configs"].setdefault("pymdownx.superfences", {}).setdefault("custom_fences", [])
    fences.append({"name": "math", "class": "math", "format": math_fence})
    for part in (entries for chapter in config["nav"] for entries in chapter.values() if isinstance(entries, list)):
        for entry in part:
            for title, value in entry.items():
                if value == "reference/api/":
                    entry[title] = [_API, *sorted(api.pages(ROOT).keys() - {_API})]
                elif value == "decisions/":
                    entry[title] = [f"decisions/{one.name}" for one in sorted((ROOT / "docs/decisions").glob("*.md"))]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    pages = {
        "reference/commands.md": commands.page(),
        "reference/configuration.md": configuration.page(),
        "reference/mavlink.md": mavlink_messages.page(),
        "reference/program-messages.md": program_messages.page(ROOT),
        "reference/glossary.md": _glossary(),
        **{new: (ROOT / old).read_text(encoding="utf-8") for old, new in _TOP_LEVEL.items()},
        **api.pages(ROOT),
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links to documents of the repository at their pages of the site."""
    folder = posixpath.dirname(page.file.src_uri)

    def moved(match: re.Match[str]) -> str:
        link = match[1]
        if page.file.src_uri in _TOP_LEVEL.values():
            link = link.removeprefix("docs/")
        name = posixpath.basename(link)
        if name in _TOP_LEVEL and posixpath.normpath(posixpath.join("docs", folder, link)) == name:
            link = posixpath.relpath(_TOP_LEVEL[name], folder or ".")
        return f"]({link}"

    return _LINK.sub(moved, markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Link the documents that docstrings name as their source."""
    if not page.file.src_uri.startswith("reference/api/"):
        return html
    return re.sub(r"\bdocs/([\w/-]+)\.md(#[\w-]+)?", r'<a href="../../\1.html\2">\g<0></a>', html)


def _glossary() -> str:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.split("## One word for one thing\n")[1].split("\n## ")[0]
    return f"# Glossary\n{table}"
