"""The pages of the Python API: one for each package of the core, drawn from the docstrings."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path


def pages(root: Path) -> dict[str, str]:
    """Return the pages by their path."""
    listed = []
    made = {}
    for package in ("estimators", "mission"):
        for folder in sorted({path.parent for path in (root / package).rglob("*.py")}):
            modules = list(_modules(folder))
            if not modules:
                continue
            name = ".".join(("sidelong", *folder.relative_to(root).parts))
            listed.append((name, _summary(folder / "__init__.py")))
            made[f"reference/api/{name.removeprefix('sidelong.')}.md"] = _page(name, modules)
    rows = "\n".join(f"| [`{name}`]({name.removeprefix('sidelong.')}.md) | {about} |" for name, about in listed)
    made["reference/api/index.md"] = (
        "# Python API\n\nThe names that `import sidelong` offers are stable within a minor version."
        f" The packages below document them.\n\n{_public(root)}\n\n| package | |\n| --- | --- |\n{rows}\n"
    )
    return made


def _modules(folder: Path) -> Iterator[str]:
    """Yield the modules of a folder with a public name; compiled kernels are internal."""
    for path in sorted(folder.glob("*.py")):
        if path.stem != "__init__" and not path.stem.endswith("_kernel"):
            yield path.stem


def _page(name: str, modules: list[str]) -> str:
    blocks = [f"::: {name}.{module}\n" for module in modules]
    return f"# {name}\n\n" + "\n".join(blocks)


def _summary(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def _public(root: Path) -> str:
    """Return the names of the public interface with where each is documented."""
    tree = ast.parse((root / "sidelong/__init__.py").read_text(encoding="utf-8"))
    rows = ["| `from sidelong import` | defined in |", "| --- | --- |"]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sidelong."):
            rows += [f"| `{alias.name}` | `{node.module}` |" for alias in node.names]
    return "\n".join(rows)
