import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CALLEE = """
from sidelong.estimators.compiled import compiled

@compiled
def inner(x):
    return {} * x
"""
CALLER = """
from callee import inner
from sidelong.estimators.compiled import compiled

@compiled
def outer(x):
    return inner(x) + 1.0

print(outer(1.0), sum(outer.dispatcher.stats.cache_hits.values()))
"""
BORROWER = """
from __future__ import annotations
import numpy as np
from sidelong.estimators.compiled import compiled

@compiled
def first(rows: np.ndarray) -> np.ndarray:
    return rows[0]

@compiled
def borrower(rows: np.ndarray) -> float:
    row = rows[1]
    return row[0] + row[1]

@compiled
def owner(rows: np.ndarray) -> float:
    return first(rows)[0] + borrower(rows)

print(owner(np.array([[1.0, 2.0], [3.0, 4.0]])))
print(*("NRT_" in "".join(one.dispatcher.inspect_llvm().values()) for one in (borrower, owner)))
"""


def outer(folder, script="caller.py", **environment):
    done = subprocess.run(
        [sys.executable, str(folder / script)],
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{folder}", "PYTHONDONTWRITEBYTECODE": "1"} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_a_change_of_what_is_called_compiles_the_caller_anew(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(2.0))
    assert outer(tmp_path) == ["3.0", "0"]
    assert outer(tmp_path) == ["3.0", "1"]
    (tmp_path / "callee.py").write_text(CALLEE.format(5.0))
    assert outer(tmp_path) == ["6.0", "0"]


def test_a_caller_is_compiled_of_what_was_kept(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER + "print(sum(inner.dispatcher.stats.cache_hits.values()))")
    (tmp_path / "callee.py").write_text(CALLEE.format("2.0"))
    (tmp_path / "first.py").write_text("from callee import inner\nprint(inner(1.0))")
    assert outer(tmp_path, "first.py") == ["2.0"]
    assert outer(tmp_path) == ["3.0", "0", "1"]
    assert outer(tmp_path) == ["3.0", "1", "0"]


def test_without_a_place_to_keep_it_each_start_compiles(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(2.0))
    (tmp_path / "__pycache__").write_text("a file where the folder would be")
    nowhere = {"XDG_CACHE_HOME": str(tmp_path / "callee.py"), "NUMBA_CACHE_DIR": ""}
    assert outer(tmp_path, **nowhere) == ["3.0", "0"]
    assert outer(tmp_path, **nowhere) == ["3.0", "0"]


def test_what_makes_no_arrays_counts_no_references(tmp_path):
    (tmp_path / "borrower.py").write_text(BORROWER)
    assert outer(tmp_path, "borrower.py") == ["8.0", "False", "True"]


def test_of_processes_that_begin_together_one_compiles(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(2.0))
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(lambda _: outer(tmp_path), range(3)))
    assert sorted(found) == [["3.0", "0"], ["3.0", "1"], ["3.0", "1"]]
