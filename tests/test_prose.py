"""Plain technical English: common words in everything that is read, and short sentences in documents and docstrings.

A failure prints where the words and sentences are. ``python -m tests.test_prose`` prints all of them.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Rare words, and turns of phrase, for which english of robotics has a common word (report, receive, predict, accept).
WORDS = re.compile(
    r"\b(?:un)?(?:tell|tells|told|heard|hear|hears|said|says|foretell|foretells|foretold|foreseen|anew|believe|believed|"
    r"doubted|heed|heeds|astray|askew|spoilt|nobody|anybody|somebody|beside|meanwhile|dear)\b"
    r"|\b(?:of before|kept code|wanted side|for ever|by itself|one that is|at the most|it is no\b(?! longer| more)|"
    r"so (?:many|long|often|much)\b(?! as\b)|what is (?:not|asked)|"
    r"who (?:waits|holds|wants|watches|has|is|knows|may))\b",
    re.IGNORECASE,
)
READ = {".md", ".py", ".js", ".html", ".toml", ".yml", ".yaml", ".service", ".svg"}
MAX_WORDS = 25
_TEXT = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)}
_CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")


def test_documents_docstrings_messages_and_names_use_common_words():
    found = [place for path in files() if not path.stem.endswith("_kernel") for place in rare_words(path)]
    assert len(found) < 50, "\n".join(found)


def test_documents_have_short_sentences():
    _assert_short([sentence for path in files() if path.suffix == ".md" for sentence in document_sentences(path)])


def test_docstrings_have_short_sentences():
    _assert_short([sentence for path in files() if path.suffix == ".py" for sentence in docstring_sentences(path)])


def test_public_functions_name_the_source_of_their_method():
    without = [
        f"{module}:{place}"
        for module in documented_modules()
        for place in functions_without_source(ast.parse((ROOT / module).read_text(encoding="utf-8")))
    ]
    assert not without, "\n".join(without)


def test_documents_named_as_sources_exist():
    missing = []
    for module in documented_modules():
        source = (ROOT / module).read_text(encoding="utf-8")
        for name, anchor in re.findall(r"\b(docs/[\w/-]+\.md)#?([\w-]*)", source):
            headings = re.findall(r"^#+ (.*)", (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)
            if anchor and anchor not in {re.sub(r"[^\w-]", "", one.lower().replace(" ", "-")) for one in headings}:
                missing.append(f"{module}: {name}#{anchor}")
    assert not missing, "\n".join(missing)


def documented_modules() -> list[str]:
    """Return the files of the Python API, as the site renders it."""
    spec = importlib.util.spec_from_file_location("api", ROOT / "docs/generate/api.py")
    assert spec is not None and spec.loader is not None
    api = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(api)
    names = re.findall(r"^::: sidelong\.(\S+)", "\n".join(api.pages(ROOT).values()), re.MULTILINE)
    assert len(names) > 60
    return [f"{name.replace('.', '/')}.py" for name in names]


def functions_without_source(node: ast.Module | ast.ClassDef | ast.FunctionDef) -> Iterator[str]:
    """Yield the public functions with no ``Source:`` in their own, their class's or their module's docstring."""
    if re.search(r"\bSource: \S", ast.get_docstring(node) or ""):
        return
    if isinstance(node, ast.FunctionDef):
        yield f"{node.lineno}: {node.name}"
        return
    for one in node.body:
        if isinstance(one, ast.ClassDef | ast.FunctionDef) and not one.name.startswith("_"):
            yield from functions_without_source(one)


def files() -> list[Path]:
    """Return the committed files that are read by people, other than this one."""
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    paths = [ROOT / name for name in names if Path(name).suffix in READ]
    return [path for path in paths if path.is_file() and path != Path(__file__).resolve()]


def rare_words(path: Path) -> Iterator[str]:
    """Yield each rare word of a file, a name of a program once, as file, line, word and text."""
    source = path.read_text(encoding="utf-8")
    if WORDS.search(_CAPITAL.sub(" ", source).replace("_", " ")):
        for line, text in _texts(path, source):
            for match in WORDS.finditer(text):
                yield f"{path.relative_to(ROOT)}:{line}: [{match.group()}] {text.strip()}"


def _texts(path: Path, source: str) -> Iterator[tuple[int, str]]:
    if path.suffix != ".py":
        yield from enumerate(source.splitlines(), 1)
        return
    names = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in _TEXT:
            yield from enumerate(token.string.splitlines(), token.start[0])
        elif token.type == tokenize.NAME and token.string not in names:
            names.add(token.string)
            yield token.start[0], _CAPITAL.sub(" ", token.string).replace("_", " ")


def document_sentences(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the sentences of a document, without its tables, headings and code, with the file."""
    text = re.sub(r"```[\s\S]*?```|^[|#][^\n]*", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    yield from ((str(path.relative_to(ROOT)), sentence) for sentence in _sentences(text))


def docstring_sentences(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the sentences of a module's docstrings, each argument's on their own, with file and line."""
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"
            yield from ((place, sentence) for sentence in _sentences(text or ""))
        waiting += (child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt | ast.ExceptHandler))


def _sentences(text: str) -> Iterator[str]:
    for paragraph in re.split(r"\n\s*\n|\n\s*(?=[-*>] |\d+\. |[\w*]+: )", text):
        for sentence in re.split(r"(?<=[.!?:;])\s+", paragraph):
            if len(sentence.split()) > 2:
                yield " ".join(sentence.split())


def _assert_short(sentences: list[tuple[str, str]]) -> None:
    long = [f"{place}: {text}" for place, text in sentences if len(text.split()) > MAX_WORDS]
    assert len(long) < 0.03 * len(sentences), "\n".join((f"{len(long)} of {len(sentences)}", *long))


if __name__ == "__main__":
    for test in list(globals().values()):
        if getattr(test, "__name__", "").startswith("test_"):
            try:
                test()
            except AssertionError as error:
                print(error)
