"""The service as a process of its own, on a simulated vehicle: handed over and back, killed, and started again."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import time

import pytest

from tests.autopilot.conftest import Application, vehicle_of  # noqa: F401  # a fixture
from tests.command_line import SIDELONG

pytestmark = pytest.mark.udp

TIMES = int(os.environ.get("TIMES", "2"))  # how often the aircraft is handed over and back
PATIENCE_S = 120.0


class Service(Application):
    """``sidelong serve`` on a vehicle, and the commands that speak with it."""

    def __init__(self, url, folder, *options):
        self.socket = str(folder / "serve.sock")
        self._environment = os.environ | {"SIDELONG_SOCKET": self.socket}
        self.out = folder / "runs"
        self._log = folder / "serve.log"
        with self._log.open("a") as log:
            command = [SIDELONG, "serve", *options, "--connect", url, "--out", str(self.out)]
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=self._environment)

    def ask(self, *request):
        return subprocess.run(
            [SIDELONG, *request], env=self._environment, capture_output=True, text=True, check=False, timeout=60.0
        )

    @property
    def status(self):
        with socket.socket(socket.AF_UNIX) as client:  # a command takes half a second to start
            try:
                client.connect(self.socket)
                client.sendall(b'{"request": "status"}\n')
                return json.loads(client.makefile().readline())["status"]
            except (OSError, ValueError):
                return {"state": "down"}

    def until(self, state, reason=""):
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            status = self.status
            if (status["state"], status.get("reason")) == (state, reason) or (
                status["state"] == state and reason is None
            ):
                return status
            assert time.monotonic() < deadline_s, (status, self.announced)
            time.sleep(0.1)


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_a_day_on_board(vehicle_of, tmp_path, flavour):  # noqa: F811
    vehicle = vehicle_of(flavour, speed=4.0)
    by_pilot = 5 if flavour == "arduplane" else 0x00020000
    with Service(vehicle.url, tmp_path) as first:
        first.until("ready")
        before = [kind for _, kind in vehicle.commanded if kind != "COMMAND_LONG"]  # streams are asked for
        assert before == []
        assert first.ask("watch").returncode == 0
        first.until("watching")
        for _ in range(TIMES):
            vehicle.wait(10.0)
            vehicle.do(lambda: vehicle.autopilot.set_mode(by_pilot))
            assert "flight mode was changed" in first.until("yielded", None)["reason"]
            vehicle.wait(5.0)
            assert first.ask("watch").returncode == 0
            first.until("watching")
        refused = first.ask("watch")
        assert (refused.returncode, "a watch is under way" in refused.stderr) == (1, True)
        first.kill()
        first.process.wait(10.0)
    with Service(vehicle.url, tmp_path) as second:
        second.until("ready")
        assert second.ask("watch").returncode == 0
        second.until("watching")
        second.wait_for("taking over the circle that is flown")
        vehicle.wait(10.0)
        assert second.ask("release").returncode == 0
        run = second.until("ready")["run"]
        assert json.loads((tmp_path / run / "summary.json").read_text())["outcome"].startswith("ended")
        vehicle.deaf = True  # switched off
        second.until("waiting", None)
        vehicle.deaf = False
        second.until("ready")
        second.process.terminate()
        assert second.process.wait(60.0) == 0
        assert "Traceback" not in second.announced
    assert len(list((tmp_path / "runs").iterdir())) == 2
