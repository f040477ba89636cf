"""Run external simulator programs, each with its own payload, and one target for all."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from sidelong.sitl.binary import Binary, BinaryError, started
from sidelong.sitl.payload.companion import Companion, CompanionError, accompany
from sidelong.sitl.payload.device_port import Address, device_port
from sidelong.sitl.payload.devices import device_of
from sidelong.sitl.settings import PayloadSettings, Settings
from sidelong.sitl.simulation import target_motion
from sidelong.sitl.world.hills import HillsError
from sidelong.sitl.world.shared_target import SharedTarget


def companions_of(
    settings: Sequence[Settings], payload: PayloadSettings, terrain: Path | None, vehicle_id: int | None
) -> list[Companion]:
    """Return a payload for each vehicle, all about the first one's target. Raises TrackError for a wrong track."""
    first = settings[0]
    shared = SharedTarget(target_motion(first.targets[0], first.seed))
    return [
        Companion(payload, shared.seen_from(one.home_east_m), one.seed, terrain, vehicle_id, device_of(one))
        for one in settings
    ]


@contextlib.contextmanager
def served_device(companion: Companion, kind: str, address: Address | None) -> Iterator[Callable[[], None]]:
    """Open the port of a companion's device; yields a function that exchanges what is due."""
    if address is None:
        yield lambda: None
        return
    with contextlib.closing(device_port(kind, companion, address)) as port:

        def exchange() -> None:
            port.receive()
            port.send()

        yield exchange


def ready(vehicle_id: int, url: str) -> None:
    print(f"ready system {vehicle_id} component 154 payload -> {url}", flush=True)


def waits(reason: str) -> None:
    print(reason, file=sys.stderr, flush=True)


def run_binaries(
    companions: Sequence[Companion],
    settings: Sequence[Settings],
    programs: Sequence[Path],
    speed: float,
    logs: Path | None,
    stopped: Callable[[], bool],
    on_turn: Callable[[], None] = lambda: None,
) -> None:
    """Run the programs until ``stopped`` or all have ended; report each one that ends early.

    logs: where their folders are kept. on_turn: called in each turn of the payloads' loops.

    Raises BinaryError where one does not run, or all have ended; CompanionError, HillsError as ``accompany``.
    """
    with contextlib.ExitStack() as stack:
        running: list[Binary] = []
        for number, (path, own) in enumerate(zip(programs, settings, strict=True)):
            binary = started(own.flavour, path, speed, own.home, own.wind, number, logs, own.endurance_s)
            running.append(stack.enter_context(binary))
        _print_how_to_fly(running, settings)
        if logs is not None:
            print("their own logs:", *(str(binary.folder) for binary in running), flush=True)
        failed: list[Exception] = []

        def accompanied(companion: Companion, binary: Binary, key: bytes | None) -> None:
            url, companion.vehicle_id = binary.run.payload_url, binary.run.system_id
            try:
                accompany(
                    companion,
                    url,
                    key=key,
                    straight_to=binary.run.signed_payload if key is not None else None,
                    on_ready=lambda vehicle_id: ready(vehicle_id, url),
                    on_wait=waits,
                    on_turn=on_turn,
                    stopped=lambda: stopped() or binary.ended or bool(failed),
                )
            except (CompanionError, HillsError) as error:
                failed.append(error)
            if binary.ended and not stopped() and len(running) > 1:
                waits(f"{binary.run.command[0]}: {binary.last_words}")

        threads = [
            threading.Thread(target=accompanied, args=(companion, binary, own.signing_key))
            for companion, binary, own in zip(companions, running, settings, strict=True)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failed:
            raise failed[0]
        if not stopped():
            raise BinaryError(running[-1].last_words)


def _print_how_to_fly(running: Sequence[Binary], settings: Sequence[Settings]) -> None:
    if len(running) == 1:
        run, urls = running[0].run, []
        if settings[0].signing_key is not None and run.signed_payload is not None:
            urls.append("udpin://{}:{}".format(*run.signed_payload))
        print("fly it by: sidelong launch", *(f"--connect {url}" for url in (*urls, run.url)), flush=True)
        return
    print("fly them by a fleet file with")
    for number, (binary, own) in enumerate(zip(running, settings, strict=True), 1):
        print(f'[[aircraft]]\nname = "{own.flavour}-{number}"\nurl = "{binary.run.url}"')
    sys.stdout.flush()
