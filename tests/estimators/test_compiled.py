import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CALLEE = """
from sidelong.estimators.compiled import compiled

@compiled
def inner(x):
    return 2.0 * x
"""
CALLER = """
from callee import inner
from sidelong.estimators.compiled import compiled

@compiled
def outer(x):
    return inner(x) + 1.0

print(outer(1.0), sum(outer.stats.cache_hits.values()))
"""


def outer(folder, script="caller.py", **environment):
    done = subprocess.run(
        [sys.executable, str(folder / script)],
        env=os.environ
        | {"PYTHONPATH": f"{ROOT}:{folder}", "NUMBA_CACHE_DIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
        | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_change_of_a_kernel_or_of_what_it_imports_uses_another_folder(tmp_path):
    (tmp_path / "caller.py").write_text("from sidelong.estimators.compiled import FOLDER\nprint(FOLDER.name)")
    package = tmp_path / "copy" / "sidelong"
    for room in ("estimators", "mission"):
        shutil.copytree(ROOT / room, package / room)
    (package / "__init__.py").touch()

    def folder_after_a_change_of(file):
        with (package / file).open("a") as code:
            code.write("# another version\n")
        return outer(tmp_path, PYTHONPATH=str(tmp_path / "copy"))[0]

    unrelated = folder_after_a_change_of("estimators/rotations.py")
    imported = folder_after_a_change_of("mission/core/requirement.py")
    kernel = folder_after_a_change_of("estimators/filters/imm_kernel.py")
    assert folder_after_a_change_of("estimators/rotations.py") == kernel
    assert len({unrelated, imported, kernel}) == 3


def test_second_start_loads_the_cached_code(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE)
    assert outer(tmp_path) == ["3.0", "0"]
    assert outer(tmp_path) == ["3.0", "1"]


def test_function_is_compiled_into_another_from_the_cache(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE)
    outer(tmp_path)
    (tmp_path / "caller.py").write_text(
        CALLER.replace("1.0\n", "5.0\n") + "print(sum(inner.stats.cache_hits.values()))"
    )
    assert outer(tmp_path) == ["7.0", "0", "1"]


def test_cached_code_keeps_no_parsed_module_in_memory(tmp_path):
    parsed = "print([one.library._shared_module for one in outer.overloads.values()])"
    (tmp_path / "caller.py").write_text(CALLER + parsed)
    (tmp_path / "callee.py").write_text(CALLEE)
    outer(tmp_path)
    assert outer(tmp_path) == ["3.0", "1", "[None]"]


def test_cache_falls_back_to_the_temporary_folder_without_a_writable_home(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER + "from sidelong.estimators.compiled import FOLDER\nprint(FOLDER)")
    (tmp_path / "callee.py").write_text(CALLEE)
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    nowhere = {"XDG_CACHE_HOME": str(tmp_path / "callee.py"), "NUMBA_CACHE_DIR": "", "TMPDIR": str(temporary)}
    *found, folder = outer(tmp_path, **nowhere)
    assert found == ["3.0", "0"]
    assert Path(folder).is_relative_to(temporary)
    assert outer(tmp_path, **nowhere)[:2] == ["3.0", "1"]


def test_folders_of_unused_versions_are_removed_after_a_month(tmp_path):
    (tmp_path / "caller.py").write_text("import sidelong.estimators.compiled\n")
    old, recent = tmp_path / "kernels-000000000000", tmp_path / "kernels-111111111111"
    for folder in (old, recent):
        folder.mkdir()
    os.utime(old, (0.0, 0.0))
    outer(tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    assert not old.exists()
    assert recent.exists()
