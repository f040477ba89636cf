"""The packages that the how-tos show: written as printed there, installed by pip, and used by the commands."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.command_line import FEW_FLIGHTS

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"`([\w.]+)`:\n\n```\w+\n(.*?)```", re.DOTALL)


@pytest.fixture
def sidelong(tmp_path):
    """Return what installs the package of a how-to and runs sidelong next to it."""

    def installed(document):
        folder, site = tmp_path / "package", tmp_path / "site"
        folder.mkdir()
        files = dict(NAMED.findall((ROOT / "docs/how-to" / document).read_text(encoding="utf-8")))
        assert "pyproject.toml" in files
        for name, text in files.items():
            assert text.count("\n") <= 45, "the how-to promises a short package"
            (folder / name).write_text(text, encoding="utf-8")
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
        subprocess.run([*pip, "--target", str(site), str(folder)], check=True)

        def run(*arguments):
            path = os.pathsep.join((str(site), str(ROOT)))
            command = [sys.executable, "-c", FEW_FLIGHTS, *arguments]
            environment = os.environ | {"PYTHONPATH": path}
            return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=tmp_path)

        return run

    return installed


def test_the_planner_of_the_how_to_is_installed_and_flies(sidelong):
    run = sidelong("own-planner.md")
    ran = run("check", "--planner", "far")
    assert "predicted from 3 simulated flights" in ran.stdout, ran.stderr
    assert "Traceback" not in ran.stderr
    assert "far" in run("launch", "--help").stdout


class PlainTextDevice:
    """Answers as the how-to's payload does, with 250 m straight ahead and 20 degrees down."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port, self.asked = self.socket.getsockname()[1], 0
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self):
        while True:
            try:
                data, peer = self.socket.recvfrom(100)
            except OSError:
                return
            if data == b"?\n":
                self.asked += 1
                self.socket.sendto(b"250.0 0.0 -20.0 0.0\n", peer)


def test_the_payload_of_the_how_to_is_installed_and_read(sidelong):
    run, device = sidelong("own-payload.md"), PlainTextDevice()
    ran = run("payload", f"plaintext://127.0.0.1:{device.port}", "--duration", "2")
    device.socket.close()
    assert device.asked > 5
    assert "250.0 m" in ran.stdout, ran.stdout + ran.stderr
    assert "-20.0" in ran.stdout


def test_a_program_next_to_a_copy_named_sidelong_imports_the_package(tmp_path):
    """The folder of the copy would be a package without a file; what an editable install puts on the path wins."""
    assert 'mode = "compat"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (tmp_path / "sidelong").symlink_to(ROOT)
    (tmp_path / "my.py").write_text("import sidelong; print(sidelong.watch.__name__)")
    added = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); sys.path.append({str(ROOT)!r}); import my"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [sys.executable, "-c", added]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd="/")
    assert ran.stdout == "watch\n", ran.stderr
