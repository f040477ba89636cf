"""What the wheel installs, and that a user's own files of the same names do not get in its way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests.command_line import FEW_FLIGHTS

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Return a wheel built from a source distribution of the checkout."""
    folder = tmp_path_factory.mktemp("package")
    unwanted = shutil.ignore_patterns(".*", "build", "dist", "runs", "tests", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=unwanted)
    with tarfile.open(built("build_sdist", folder / "checkout", folder)) as archive:
        archive.extractall(folder / "source", filter="data")
    (source,) = (folder / "source").iterdir()
    return built("build_wheel", source, folder)


def built(hook: str, source: Path, folder: Path) -> Path:
    """Call a hook of the build backend in a process of its own, and return the file that it writes."""
    code = f"import sys; from setuptools import build_meta; print(build_meta.{hook}(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, folder], cwd=source, check=True, capture_output=True, text=True
    )
    return folder / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """Return the Python of a new environment that holds the wheel and finds this one's packages after it."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False)
    (packages,) = folder.glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin" / "python"


@pytest.fixture
def workspace(tmp_path) -> Path:
    """Return a folder with modules of a user that bear names of ours and of our libraries, all of which fail."""
    for name in ("mission.py", "sitl.py", "numpy.py", "estimators.py", "app/__init__.py"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("raise SystemExit(f'the user has {__name__}')\n")
    return tmp_path


def test_the_wheel_installs_one_name_with_its_pages(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"sidelong"}
    data = {"sidelong/py.typed", "sidelong/app/view/page/charts.js", "sidelong/app/report/report.css"}
    assert {*data, "sidelong/sitl/cli.py"} <= set(names)


@pytest.mark.udp
def test_a_flight_with_a_live_map_starts_with_files_of_our_names_in_its_folder_and_on_the_path(
    installed, workspace, free_port
):
    (workspace / "mission.toml").write_text("[planner]\nname = 'paper'\n[sensors]\nfilter = 'ekf'\n")
    # As the installed script does it.
    script = "from sidelong.app.__main__ import main; main()"
    options = ["launch", "mission.toml", "--duration", "5", "--set", "simulation.speed=20", "--view", "--set"]
    done = subprocess.run(
        [installed, "-P", "-c", script, *options, f"display.port={free_port()}"],
        cwd=workspace,
        env=os.environ | {"PYTHONPATH": str(workspace)},
        capture_output=True,
        text=True,
        timeout=240.0,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "completed" in done.stdout


@pytest.mark.udp
def test_a_flight_loads_none_of_the_large_libraries(tmp_path):
    without = "import sys; sys.modules.update(dict.fromkeys(('scipy', 'matplotlib', 'filterpy', 'rasterio')))"
    script = without + FEW_FLIGHTS

    def run(*arguments):
        command = [sys.executable, "-P", "-c", script, *arguments]  # the checkout, whose kernels are compiled
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240.0, check=False)

    flown = run("launch", "--duration", "5", "--set", "simulation.speed=20")
    assert (flown.returncode, "completed" in flown.stdout) == (0, True), flown.stdout + flown.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    assert run("replay", str(folder), "--verify").returncode == 0
    assert run("report", str(folder)).returncode == 0


def test_a_helper_finds_installed_packages_before_those_of_the_user(installed, workspace):
    script = (
        "from sidelong.app.process import *; import subprocess, sys; prefer_installed_packages();"
        "import numpy; print(numpy.__version__);"
        "code = 'import numpy, sidelong.mission; print(numpy.__version__)';"
        "subprocess.run([sys.executable, '-P', '-c', code], env=helper_environment(), check=True)"
    )
    done = subprocess.run(
        [installed, "-P", "-c", script],
        cwd=workspace,
        env=os.environ | {"PYTHONPATH": str(workspace)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ours, helpers = done.stdout.split()
    assert ours == helpers


def test_a_copy_without_symbolic_links_is_refused_in_a_sentence_with_the_way_out(tmp_path):
    """Where git may not make links, it writes files with their destinations."""
    copy = tmp_path / "sidelong"
    copy.mkdir()
    for file in (ROOT / "sidelong").glob("*.py"):
        shutil.copy(file, copy)
    for name in ("app", "estimators", "mission", "sitl"):
        (copy / name).write_text(f"../{name}")
    words = [sys.executable, "-m", "sidelong", "--help"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "git config core.symlinks true" in done.stderr
