"""The simulated vehicle in a process of its own."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
from collections.abc import Callable
from pathlib import Path

from app.config import Config
from app.errors import FlightError, InputError

_READY_S = 30.0
_STOP_S = 5.0


def free_udp_port() -> int:
    """Return a UDP port of the loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class SimulatedVehicle:
    """Starts ``python -m sitl`` for a configuration, and stops it. Use as ``async with``.

    on_end gets a sentence when the vehicle ends by itself meanwhile.
    """

    def __init__(self, config: Config, truth: Path, on_end: Callable[[str], object]) -> None:
        self.port = free_udp_port()
        self.url = f"udpin://127.0.0.1:{self.port}"
        simulation = config.simulation
        self._options = [
            *("--autopilot", simulation.autopilot),
            *("--to", f"127.0.0.1:{self.port}"),
            *("--target", simulation.target),
            *("--target-speed", f"{config.requirement.target_speed_max_m_s:g}"),
            *("--seed", str(simulation.seed)),
            *("--speed", f"{simulation.speed:g}"),
            *("--airspeed", f"{config.aircraft.airspeed_m_s:g}"),
            *("--wind-speed", f"{simulation.wind_speed_m_s:g}"),
            *("--wind-from-deg", f"{simulation.wind_from_deg:g}"),
            *("--truth", str(truth)),
            *(("--require-signing", str(key)) if (key := config.link.signing_key_file) is not None else ()),
            *(("--terrain", config.terrain.folder) if config.terrain.folder is not None else ()),
            *((f"--home={simulation.home[0]},{simulation.home[1]}",) if simulation.home is not None else ()),
            "--while-input",  # so that it does not outlive this program, however that ends
        ]
        self._process: asyncio.subprocess.Process | None = None
        self._on_end = on_end
        self._vigil: asyncio.Task[None] | None = None

    async def __aenter__(self) -> SimulatedVehicle:
        # A session of its own keeps the terminal's Ctrl-C from ending it before the mission has been wound up.
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "sitl", *self._options),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        try:
            line = await asyncio.wait_for(self._process.stdout.readline(), _READY_S)
        except TimeoutError as error:
            await self._stop()
            raise FlightError(f"the simulated vehicle was not ready within {_READY_S:g} s.") from error
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

    async def _keep_vigil(self) -> None:
        why = await self.ended()
        self._on_end(f"the simulated vehicle has ended: {why.rstrip('.')}; nothing flies any more.")

    async def ended(self) -> str:
        """Wait until the process has ended by itself, and return why."""
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
