"""A key from its making to a signed flight, on the simulated vehicle over UDP."""

from __future__ import annotations

import json
import threading
import time

import pytest

from sidelong.app.commands.sign import sign
from sidelong.app.errors import InputError
from sidelong.sitl.server import serve
from sidelong.sitl.settings import Settings
from sidelong.sitl.simulation import Simulation
from tests import command_line
from tests.command_line import new_process

pytestmark = pytest.mark.udp


def sidelong(*arguments: object, code: int = 0) -> str:
    done = (new_process if arguments[0] == "launch" else command_line.sidelong)(*arguments)
    announced = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == code, announced
    return announced


@pytest.fixture
def vehicle(free_port):
    """Return a simulated vehicle on the ground, and its URL."""
    simulation, port, over = Simulation(Settings(boot_unix_s=time.time())), free_port(), threading.Event()
    simulation.advance(30.0)
    served = [(simulation, [("127.0.0.1", port)])]
    thread = threading.Thread(target=serve, args=(served,), kwargs={"stopped": over.is_set})
    thread.start()
    yield simulation, f"udpin://127.0.0.1:{port}"
    over.set()
    thread.join(10.0)


def test_a_key_is_made_given_demanded_and_taken_back(tmp_path, vehicle, capsys):
    key, other, (simulation, url) = tmp_path / "plane.key", tmp_path / "other.key", vehicle
    sign(key, url, timeout=20.0)
    assert "refuses frames that are not signed" in " ".join(capsys.readouterr().out.split())
    assert simulation.vehicle.radio.signing.required
    assert "AIRSPEED_CRUISE 15" in sidelong("connect", url, "--set", f"link.signing_key_file={key}", "--listen", 1)
    sign(other)
    refusal = sidelong(
        "connect", url, "--set", f"link.signing_key_file={other}", "--set", "link.heartbeat_timeout_s=3", code=2
    )
    assert "signed with another key" in refusal
    sign(key, url, remove=True, timeout=20.0)
    assert not simulation.vehicle.radio.signing.required


def test_a_key_is_given_on_the_ground_and_by_cable_only(tmp_path, vehicle):
    key, (simulation, url) = tmp_path / "plane.key", vehicle
    simulation.vehicle.arm()
    with pytest.raises(InputError, match="armed; disarm"):
        sign(key, url, timeout=20.0)
    with pytest.raises(InputError, match="by USB"):
        sign(key, "udpin://0.0.0.0:14599")
    with pytest.raises(InputError, match="--connect"):
        sign(key, remove=True)


def test_a_signed_flight_and_its_records_without_the_key(tmp_path):
    key, summary = tmp_path / "plane.key", tmp_path / "summary.json"
    sign(key)
    announced = sidelong(
        *(
            "launch",
            "--set",
            f"link.signing_key_file={key}",
            "--duration",
            60,
            "--set",
            "simulation.speed=30",
            "--seed",
            3,
            "--planner",
            "paper",
        ),
        *("--out", tmp_path / "runs", "--json", summary),
    )
    values = json.loads(summary.read_text())
    assert values["outcome"] == "completed"
    assert values["sightings"] > 200
    secret = key.read_text().strip()
    (run,) = (tmp_path / "runs").iterdir()
    records = [file.read_bytes() for file in run.rglob("*") if file.is_file()]
    assert len(records) >= 4
    for content in records:
        assert secret.encode() not in content
        assert bytes.fromhex(secret) not in content
    assert secret not in announced
