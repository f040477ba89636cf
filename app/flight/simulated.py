"""The simulated vehicles in a process of their own."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.payload.registry import MAVLINK, kind_by_name
from sidelong.app.process import helper_command, helper_environment
from sidelong.sitl.settings import (
    CameraSettings,
    Flavour,
    HomePosition,
    PayloadSettings,
    RunSettings,
    Settings,
    TargetSettings,
    in_a_row,
)
from sidelong.sitl.world.airframe import WindVector

_READY_S = 30.0
_STOP_S = 5.0
_PACE_S = 0.01


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class SimulatedVehicles:
    """Starts ``python -m sitl`` for one configuration or several, and stops it. Use as ``async with``.

    truths: one file per vehicle. ``urls`` are the vehicles'; their system ids count from 1. Shared settings, such as
    the wind, are the first one's. on_end: receives a sentence if they end early. targets: instead of the configured
    one; looks_at: which of them each payload sees first, from 0.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        truths: Sequence[Path | None],
        on_end: Callable[[str], object],
        targets: Sequence[TargetSettings] = (),
        looks_at: Sequence[int] = (),
    ) -> None:
        first, simulation = configs[0], configs[0].simulation
        ports = [free_udp_port() for _ in configs]
        self.urls = tuple(f"udpin://127.0.0.1:{port}" for port in ports)
        self.payload_url: str | None = None
        self.video_url: str | None = None
        device, camera = "", None
        if first.camera.source is not None:
            self.video_url = f"udp://127.0.0.1:{free_udp_port()}"
            camera = CameraSettings(self.video_url, view_deg=first.camera.view_deg, rate_hz=first.camera.rate_hz)
        if first.payload.kind != MAVLINK:
            payload_port = free_udp_port()
            scheme = kind_by_name(first.payload.kind).url.partition(":")[0]
            self.payload_url = f"{scheme}://127.0.0.1:{payload_port}"
            device = f"{first.payload.kind}@127.0.0.1:{payload_port}"
        speed_max_m_s = first.requirement.target_speed_max_m_s
        payload = PayloadSettings(
            dropout_fraction=PayloadSettings().dropout_fraction if simulation.laser else 1.0,
            pan_limit_deg=math.degrees(first.aircraft.aircraft().pan_limit_rad),
        )
        common = Settings(
            flavour=Flavour(simulation.autopilot),
            seed=simulation.seed,
            wind=WindVector.blowing_from(simulation.wind_speed_m_s, math.radians(simulation.wind_from_deg)),
            home=None if simulation.home is None else HomePosition(*simulation.home),
            home_on_ground=True,
            targets=tuple(replace(one, speed_max_m_s=speed_max_m_s) for one in targets)
            or (TargetSettings(simulation.target, speed_max_m_s),),
            payload=payload,
            device=device,
            camera=camera,
            terrain=None if first.terrain.folder is None else Path(first.terrain.folder),
        )
        self.settings = RunSettings(
            tuple(
                replace(
                    one,
                    flavour=Flavour(config.simulation.autopilot),
                    airspeed_m_s=config.aircraft.airspeed_m_s,
                    stations=(f"127.0.0.1:{port}",),
                    truth=truth,
                    looks_at=seen,
                )
                for one, config, port, truth, seen in zip(
                    in_a_row(common, len(configs)),
                    configs,
                    ports,
                    truths or [None] * len(configs),
                    looks_at or [0] * len(configs),
                    strict=True,
                )
            ),
            simulation.speed,
            signing_key_file=first.link.signing_key_file,
        )
        self._what = "the simulated vehicle" if len(configs) == 1 else "the simulation of the vehicles"
        self._process: asyncio.subprocess.Process | None = None
        self._on_end = on_end
        self._vigil: asyncio.Task[None] | None = None

    async def __aenter__(self) -> SimulatedVehicles:
        # A session of its own keeps the terminal's Ctrl-C from ending it before the mission has been wound up.
        self._process = await asyncio.create_subprocess_exec(
            *helper_command("sidelong.sitl", "--settings", "-"),
            env=helper_environment(),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        # It ends with this input, so that it does not outlive this program, however that ends.
        self._process.stdin.write(self.settings.to_json() + b"\n")
        try:
            line = await asyncio.wait_for(self._process.stdout.readline(), _READY_S)
        except TimeoutError as error:
            await self._stop()
            raise FlightError(f"{self._what} was not ready within {_READY_S:g} s.") from error
        except asyncio.CancelledError:
            await self._stop()
            raise
        if not line.startswith(b"ready"):
            raise InputError(await self.ended())  # asyncio has words for a process that ends after its loop
        self._vigil = asyncio.create_task(self._keep_vigil())
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._vigil is not None
        self._vigil.cancel()
        await asyncio.gather(self._vigil, return_exceptions=True)
        await self._stop()

    async def keep_pace(self, time_s: Callable[[], float]) -> None:
        """Let the simulation wait for the controlling program if that falls behind.

        time_s: simulation time the program has processed, inf if not known. A program that no longer flies sends
        nothing, and the simulation does not wait for it.
        """
        assert self._process is not None
        assert self._process.stdin is not None
        announced_s = -math.inf
        with contextlib.suppress(ConnectionError):
            while True:
                await asyncio.sleep(_PACE_S)
                now_s = time_s()
                if announced_s < now_s < math.inf:
                    announced_s = now_s
                    self._process.stdin.write(f"{now_s:.3f}\n".encode())
                    await self._process.stdin.drain()

    async def _keep_vigil(self) -> None:
        why = await self.ended()
        self._on_end(f"{self._what} has ended: {why.rstrip('.')}; nothing flies any more.")

    async def ended(self) -> str:
        """Wait until the process has ended, and return the reason."""
        assert self._process is not None
        await self._process.wait()
        return await self._complaint()

    async def _complaint(self) -> str:
        assert self._process is not None
        assert self._process.stderr is not None
        text = (await self._process.stderr.read()).decode(errors="replace").strip()
        return text.splitlines()[-1] if text else f"it stopped with code {self._process.returncode}."

    async def _stop(self) -> None:
        process = self._process
        if process is None or process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), _STOP_S)
        except TimeoutError:
            process.kill()
            await process.wait()
