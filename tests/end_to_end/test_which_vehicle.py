"""Two vehicles on one link: they are listed, and nothing is sent before one is named."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.command_line import sidelong

pytestmark = pytest.mark.udp


@contextmanager
def vehicles(port: int, *options: tuple[object, ...]) -> Iterator[None]:
    with ExitStack() as stack:
        for one in options:
            command = [
                sys.executable,
                "-m",
                "sidelong.sitl",
                "--to",
                f"127.0.0.1:{port}",
                "--speed",
                "10",
                *map(str, one),
            ]
            process = stack.enter_context(subprocess.Popen([*command, "--while-input"], stdin=subprocess.PIPE))
            stack.callback(process.terminate)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.bind(("127.0.0.1", port))
            station.settimeout(120.0)
            begun: set[object] = set()
            while len(begun) < len(options):  # on a busy machine the last begins long after the first
                begun.add(station.recvfrom(4096)[1])
        yield


def test_of_two_vehicles_one_has_to_be_named(free_port, tmp_path):
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    with vehicles(port, ("--set", "system_id=1"), ("--set", "system_id=7", "--autopilot", "px4")):
        unnamed = sidelong("launch", "--connect", url, "--out", tmp_path)
        assert unnamed.returncode == 2, unnamed.stdout + unnamed.stderr
        assert "several vehicles share the link: system 1 (" in unnamed.stderr
        assert "system 7 (px4" in unnamed.stderr
        assert "--set link.system_id=ID" in unnamed.stderr
        named = sidelong(
            "connect", url, "--set", "link.system_id=7", "--listen", 1, "--json", tmp_path / "found.json"
        )
        assert named.returncode == 0, named.stderr
        assert json.loads((tmp_path / "found.json").read_text())["system_id"] == 7
        absent = sidelong("connect", url, "--set", "link.system_id=3", "--set", "link.heartbeat_timeout_s=2")
        assert absent.returncode == 2
        assert "system 3 sends nothing, only system 1" in absent.stderr


def test_two_vehicles_with_one_id_are_reported_before_anything_is_armed(free_port, tmp_path):
    port = free_port()
    with vehicles(port, ("--seed", 1), ("--seed", 2)):
        done = sidelong("launch", "--connect", f"udpin://127.0.0.1:{port}", "--out", tmp_path)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "two vehicles speak with the same system id" in done.stderr
    assert "arming" not in done.stdout
