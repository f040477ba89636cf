"""Someone's own simulator programs of ArduPlane or PX4, by the command lines the two projects document.

Each has a payload of its own; all see one target.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from sidelong.sitl.payload.companion import Companion, CompanionError, accompany
from sidelong.sitl.payload.devices import Address, DevicePort, device_of
from sidelong.sitl.settings import DEFAULT_HOMES, Flavour, PayloadSettings, Settings
from sidelong.sitl.simulation import camera_of, target_motion
from sidelong.sitl.world.airframe import WindVector
from sidelong.sitl.world.hills import HillsError
from sidelong.sitl.world.motion import SharedTarget

_STOP_S = 5.0
_INSTANCES = 10
_HEADING_DEG = 353
_ARDUPLANE_TCP, _PX4_GROUND_UDP, _PX4_OFFBOARD_UDP = 5760, 18570, 14540
_PX4_SIGNED_PAYLOAD_UDP = 14640
_OUTPUT, _LAST_WORDS = "output.log", 400
# ArduPlane's simulated aeroplane draws about this current at its stock airspeed.
_ARDUPLANE_A = 10.0
# PX4's start script runs the first file of this name in PATH, and has an empty one of its own.
_PX4_PARAMETERS_FILE = "px4-rc.params"
# Before 1.16 the stock simulated aeroplane does not fly: its surfaces and its motor are on outputs that the simulator
# does not read, and aileron and elevator have the wrong sign. With its stock 6 N it then lifts off only now and then.
_PX4_AEROPLANE_AS_IN_1_16 = {
    **{f"PWM_MAIN_FUNC{output}": what for output, what in enumerate(("201", "202", "203", "101", "0", "0"), 1)},
    **{"CA_SV_CS0_TRQ_R": "1", "CA_SV_CS1_TRQ_P": "-1", "CA_ROTOR0_PX": "0.3"},
    **{"EKF2_GPS_DELAY": "0", "SIH_T_MAX": "8"},
}
_CALM = WindVector()


class BinaryError(Exception):
    """The binary cannot be run; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class Run:
    """How an instance is started, and where it is then met by the application and by the payload."""

    command: list[str]
    environment: dict[str, str]
    url: str
    payload_url: str
    system_id: int
    signed_payload: Address | None = None  # where the autopilot forwards a signing payload without its signature


def run_of(own: Settings, binary: Path, folder: Path, instance: int, speed: float) -> Run:
    """Return the stock command line of an instance that keeps its files, its wind among them, in ``folder``."""
    flavour, wind = own.flavour, own.wind
    if flavour is Flavour.ARDUPLANE:
        place = own.home_or_default
        where = f"{place.latitude_deg},{place.longitude_deg},{place.altitude_m},{_HEADING_DEG}"
        command = [str(binary), "--model", "plane", "--speedup", f"{speed:g}", "--home", where]
        command += ["-I", str(instance), "--sysid", str(instance + 1)]
        # A binary inside its source tree has the parameters of its stock aircraft there, too.
        defaults = binary.parents[min(3, len(binary.parents) - 1)] / "Tools/autotest/models/plane.parm"
        files = [str(defaults)] if defaults.exists() else []
        parameters_file = folder / "own.parm"
        text = f"BATT_CAPACITY {own.endurance_s * _ARDUPLANE_A / 3.6:.0f}\n"  # about
        if wind != _CALM:
            from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s)) % 360.0
            text += f"SIM_WIND_SPD {math.hypot(wind.east_m_s, wind.north_m_s):g}\nSIM_WIND_DIR {from_deg:g}\n"
        text += "MNT1_TYPE 6\n" if own.camera is not None else ""  # a MAVLink gimbal
        parameters_file.write_text(text)
        command += ["--defaults", ",".join([*files, str(parameters_file)])]
        port = _ARDUPLANE_TCP + 10 * instance
        return Run(command, {}, f"tcpout://127.0.0.1:{port}", f"tcpout://127.0.0.1:{port + 2}", instance + 1)
    # At sea level by default: PX4's height control starts there, and is late at a higher home.
    place = own.home or replace(DEFAULT_HOMES[flavour], altitude_m=0.0)
    start_files = binary.parent.parent / "etc"
    environment = {"PX4_SIM_MODEL": "sihsim_airplane", "PX4_SIMULATOR": "sihsim"}
    environment["PX4_SIM_SPEED_FACTOR"] = f"{speed:g}"
    parameters = {"SIM_BAT_DRAIN": f"{own.endurance_s:g}", "SIM_BAT_MIN_PCT": "0"}
    if own.camera is not None:  # commanded and turned by version 2 of the gimbal protocol
        parameters |= {"MNT_MODE_IN": "4", "MNT_MODE_OUT": "2"}
    if wind != _CALM:  # by where it comes from
        parameters["SIH_WIND_N"], parameters["SIH_WIND_E"] = f"{-wind.north_m_s:.3f}", f"{-wind.east_m_s:.3f}"
    if _takes_parameters_from_the_environment(start_files):
        # The stock aeroplane's 6 N are those of a parameter that its thruster no longer reads in versions of 2026: by
        # the default of 2 N it rolls along the ground at 6 m/s and never takes off.
        parameters["SIH_F_T_MAX"] = "6"
        environment |= {f"PX4_PARAM_{name}": value for name, value in parameters.items()}
        names = "PX4_HOME_LAT", "PX4_HOME_LON", "PX4_HOME_ALT"
        environment |= dict(zip(names, map(str, astuple(place)), strict=True))
    else:
        e7 = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        parameters |= {"SIH_LOC_LAT0": f"{e7[0]}", "SIH_LOC_LON0": f"{e7[1]}", "SIH_LOC_H0": f"{place.altitude_m}"}
        parameters |= _PX4_AEROPLANE_AS_IN_1_16
        lines = [f"param set {name} {value}\n" for name, value in parameters.items()]
        (folder / _PX4_PARAMETERS_FILE).write_text("".join(lines))
        environment["PATH"] = f"{folder}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    command = [str(binary), "-i", str(instance), "-d", "-w", str(folder), str(start_files)]
    url = f"udpin://127.0.0.1:{_PX4_OFFBOARD_UDP + instance}"
    payload_url = f"udpout://127.0.0.1:{_PX4_GROUND_UDP + instance}"
    signed = "127.0.0.1", _PX4_SIGNED_PAYLOAD_UDP + instance
    return Run(command, environment, url, payload_url, instance + 1, signed)


def _takes_parameters_from_the_environment(start_files: Path) -> bool:
    """Return whether PX4's start script does so: from 1.16 on, which also takes its home in degrees."""
    script = start_files / "init.d-posix" / "rcS"
    return not script.is_file() or "PX4_PARAM_" in script.read_text(errors="replace")


@dataclass(frozen=True, slots=True)
class Binary:
    """A running simulator in a process group of its own. folder: where it keeps its files, its log among them."""

    run: Run
    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    @property
    def last_words(self) -> str:
        """Exit code and the end of what the autopilot printed; it has to have ended."""
        text = (self.folder / _OUTPUT).read_text(errors="replace").strip()
        return f"it ended with code {self.process.returncode}: {text[-_LAST_WORDS:]}"

    def stop(self) -> None:
        """End the process group: SIGTERM, then SIGKILL."""
        for number in (signal.SIGTERM, signal.SIGKILL):  # what a script has started may outlive it
            with contextlib.suppress(ProcessLookupError, PermissionError):  # the latter of a group that has ended
                os.killpg(self.process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(_STOP_S)


@contextlib.contextmanager
def started(own: Settings, binary: Path, speed: float, instance: int = 0) -> Iterator[Binary]:
    """Run a simulator; instance: the first that may be taken, and with it the system id. Raises BinaryError."""
    program = binary.resolve()
    if not os.access(program, os.X_OK) or program.is_dir():
        raise BinaryError(f"{binary} is no program that can be run")
    free = _free_instance(own.flavour, instance)
    with _working_folder(own.logs, own.flavour, free) as folder, (folder / _OUTPUT).open("wb") as output:
        run = run_of(own, program, folder, free, speed)
        try:
            process = subprocess.Popen(
                run.command,
                cwd=folder,
                env=os.environ | run.environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise BinaryError(f"{binary} does not run: {error.strerror or error}") from error
        with contextlib.ExitStack() as stack:
            running = Binary(run, folder, process)
            stack.callback(running.stop)
            yield running


@contextlib.contextmanager
def _working_folder(logs: Path | None, flavour: Flavour, instance: int) -> Iterator[Path]:
    """Make a new folder: what is left of another flight, such as its parameters, would count in the next."""
    if logs is None:
        with tempfile.TemporaryDirectory(prefix="sidelong-sitl-", ignore_cleanup_errors=True) as name:
            yield Path(name)
        return
    folder = logs.resolve() / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{flavour}-{instance + 1}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise BinaryError(f"cannot keep its logs in {logs}: {error.strerror}") from error
    yield folder


def _free_instance(flavour: Flavour, first: int) -> int:
    for instance in range(first, first + _INSTANCES):
        ports = [(socket.SOCK_DGRAM, base + instance) for base in (_PX4_GROUND_UDP, _PX4_OFFBOARD_UDP)]
        if flavour is Flavour.ARDUPLANE:
            ports = [(socket.SOCK_STREAM, _ARDUPLANE_TCP + 10 * instance)]
        if all(_free(*port) for port in ports):
            return instance
    raise BinaryError(f"the ports of {_INSTANCES} instances are all in use")


def _free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(kind is socket.SOCK_STREAM))
        probe.bind(("127.0.0.1", port))
        return True
    return False


def companions_of(settings: Sequence[Settings], vehicle_id: int | None) -> list[Companion]:
    """Return a payload for each vehicle, all about the first one's target. Raises TrackError for a wrong track."""
    first = settings[0]
    shared = SharedTarget(target_motion(first.targets[0], first.seed))
    companions = []
    for vehicle in settings:
        payload, seen = vehicle.payload or PayloadSettings(), shared.seen_from(vehicle.home_east_m)
        camera = None if vehicle.camera is None else partial(camera_of, vehicle, first.seed)
        of_payload = payload, seen, vehicle.seed, vehicle.terrain, vehicle_id, device_of(vehicle), camera
        companions.append(Companion(*of_payload))
    return companions


@contextlib.contextmanager
def served_device(companion: Companion, kind: str, address: Address | None) -> Iterator[Callable[[], None]]:
    """Open the port of a companion's device; yield a function that receives and sends what is due."""
    if address is None:
        yield lambda: None
        return
    with contextlib.closing(DevicePort(kind, companion, address)) as port:

        def exchange() -> None:
            port.receive()
            port.send()

        yield exchange


def print_ready(vehicle_id: int, url: str) -> None:
    print(f"ready system {vehicle_id} component 154 payload -> {url}", flush=True)


def print_waiting(reason: str) -> None:
    print(reason, file=sys.stderr, flush=True)


def run_binaries(
    companions: Sequence[Companion],
    settings: Sequence[Settings],
    programs: Sequence[Path],
    speed: float,
    stopped: Callable[[], bool],
    on_turn: Callable[[], None] = lambda: None,
) -> None:
    """Run the programs until ``stopped`` or all have ended; report each one that ends early.

    on_turn: called in each turn of the payloads' loops. Raises BinaryError where one does not run, or all have ended;
    CompanionError, HillsError as ``accompany``.
    """
    with contextlib.ExitStack() as stack:
        running: list[Binary] = []
        for number, (path, own) in enumerate(zip(programs, settings, strict=True)):
            at_sea = replace(own.home_or_default, altitude_m=0.0)  # where PX4's height control wants to start
            placed = replace(own, home=at_sea) if len(programs) > 1 and own.home is None else own
            running.append(stack.enter_context(started(placed, path, speed, number)))
        _print_how_to_fly(running, settings)
        kept = [str(binary.folder) for binary, own in zip(running, settings, strict=True) if own.logs is not None]
        if kept:
            print("their own logs:", *kept, flush=True)
        failed: list[Exception] = []

        def accompanied(companion: Companion, binary: Binary, key: bytes | None) -> None:
            url, companion.vehicle_id = binary.run.payload_url, binary.run.system_id
            try:
                accompany(
                    companion,
                    url,
                    key=key,
                    straight_to=binary.run.signed_payload if key is not None else None,
                    on_ready=lambda vehicle_id: print_ready(vehicle_id, url),
                    on_wait=print_waiting,
                    on_turn=on_turn,
                    stopped=lambda: stopped() or binary.ended or bool(failed),
                )
            except (CompanionError, HillsError) as error:
                failed.append(error)
            if binary.ended and not stopped() and len(running) > 1:
                print_waiting(f"{binary.run.command[0]}: {binary.last_words}")

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
        run, urls = running[0].run, [running[0].run.url]
        if settings[0].signing_key is not None and run.signed_payload is not None:
            urls.insert(0, "udpin://{}:{}".format(*run.signed_payload))
        print("fly it by: sidelong launch", *(f"--connect {url}" for url in urls), flush=True)
        return
    print("fly them by a fleet file with")
    for number, (binary, own) in enumerate(zip(running, settings, strict=True), 1):
        print(f'[[aircraft]]\nname = "{own.flavour}-{number}"\nurl = "{binary.run.url}"')
    sys.stdout.flush()
