"""The parts of the service, each against the real thing: a socket, a folder, a manager's datagram."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from configparser import ConfigParser
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from shutil import which
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from sidelong.app.assembly import prepared
from sidelong.app.cli import app
from sidelong.app.commands import serve
from sidelong.app.config import Config, ControlSection, config_from, load_config
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.preflight import Check
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.shell import Life
from sidelong.app.records import run_folder
from sidelong.app.records.run_folder import RunFolder, rotate
from sidelong.app.serve import control_socket
from sidelong.app.serve.resident import Resident, ServiceDisplay, State, feed_watchdog, notify
from sidelong.app.serve.standby import Standby, Triggers
from sidelong.app.view.address import PageAddress
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Alarm, VehicleStatus
from sidelong.mission.core.events import Announce, ModeReported
from tests.messages import heartbeat, message

DEPLOYMENT = Path(__file__).resolve().parents[2] / "docs" / "deployment"
NOW = datetime(2026, 11, 23, tzinfo=UTC)
VEHICLE = 7


def rc(pulse_us, time_ms=0, rssi=255, **others):
    return message("RC_CHANNELS", system=VEHICLE, time_boot_ms=time_ms, chan9_raw=pulse_us, rssi=rssi, **others)


def receiver(healthy):
    bits = {"onboard_control_sensors_present": 0x10000, "onboard_control_sensors_enabled": 0x10000}
    return message("SYS_STATUS", system=VEHICLE, **bits, onboard_control_sensors_health=0x10000 * healthy)


def beat(custom_mode, component=1, system=VEHICLE, **fields):
    return heartbeat(3, custom_mode, 1, component=component, system=system, **fields)


def aux(level, received_s=0.0, function=300, target=VEHICLE):
    fields = {"command": 218, "param1": function, "param2": level, "target_system": target, "target_component": 1}
    return message("COMMAND_LONG", 190, 255, received_s, **fields)


def requests(triggers, messages):
    return [one for one in map(triggers.take, messages) if one is not None]


def switched(*parts, start_ms=0):
    """Yield reports at 2 Hz, with the receiver's health each second; a part: pulse, seconds and other fields."""
    time_ms = start_ms
    for pulse_us, lasts_s, *others in parts:
        fields = dict(*others)
        healthy = fields.pop("healthy", True)
        for step in range(round(2 * lasts_s)):
            yield rc(pulse_us, time_ms, **fields)
            if step % 2 == 0 and healthy is not None:
                yield receiver(healthy)
            time_ms += 500


UP, DOWN, MIDDLE = 2000, 1000, 1500


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        ([(UP, 9)], []),  # up already when it is first received
        ([(DOWN, 4), (UP, 8), (DOWN, 4), (UP, 4)], ["watch", "release", "watch"]),
        ([(DOWN, 4), (MIDDLE, 4), (UP, 4), (MIDDLE, 2), (1690, 2), (1310, 2), (DOWN, 3)], ["watch", "release"]),
        ([(DOWN, 4), (UP, 1), (DOWN, 4)], []),  # touched
        ([(DOWN, 4), (0, 1), (UP, 9)], []),  # the transmitter came back with the switch up
        ([(DOWN, 4), (65535, 1), (UP, 4), (DOWN, 4), (UP, 4)], ["release", "watch"]),
    ],
)
def test_a_switch_requests_by_a_movement_that_lasts(parts, found):
    assert requests(Triggers(ControlSection(rc_channel=9), VEHICLE), switched(*parts)) == found


ILL, STICKS = {"healthy": False}, {"chan1_raw": 1500, "chan3_raw": 1400}


@pytest.mark.parametrize(
    "parts",
    [
        [(DOWN, 4), (UP, 60, ILL)],  # what a receiver presets when it has lost its transmitter
        [(DOWN, 4), (UP, 1), (UP, 60, ILL)],  # reported a second later
        [(DOWN, 4), (UP, 60, {"rssi": 0})],
        [(DOWN, 4), (UP, 60, {"healthy": None})],  # nothing reported since
        [(DOWN, 60, {"healthy": None}), (UP, 60, {"healthy": None})],
        [(DOWN, 4), (UP, 2, ILL), (UP, 60)],  # the transmitter comes back with the switch up
        [(DOWN, 4, ILL), (UP, 60)],
        [(DOWN, 4, STICKS), (UP, 60, {"chan1_raw": 1100, "chan3_raw": 900})],  # several channels jump at once
    ],
)
def test_a_channel_that_a_receiver_presets_requests_nothing(parts):
    triggers = Triggers(ControlSection(rc_channel=9), VEHICLE)
    assert requests(triggers, switched(*parts)) == []
    after = switched((DOWN, 4), (UP, 4), start_ms=200_000)
    assert requests(triggers, after) in (["watch"], ["release", "watch"])  # once it was low again


def test_after_a_restart_of_the_autopilot_the_switch_has_to_be_low_again():
    triggers = Triggers(ControlSection(rc_channel=9), VEHICLE)
    assert requests(triggers, switched((DOWN, 4), start_ms=90_000)) == []
    assert requests(triggers, switched((UP, 20))) == []


def test_a_mode_requests_when_a_person_selects_it():
    triggers = Triggers(ControlSection(flight_mode="loiter"), VEHICLE, ("AUTO", "GUIDED"))
    assert requests(triggers, map(beat, (12, 12, 12, 5, 12, 10, 5))) == ["release"]  # not long enough
    assert requests(triggers, map(beat, (5, 12, 12, 12, 12, 10, 5))) == ["watch"]
    assert requests(triggers, [beat(12, component=191), beat(12, system=8)] * 4) == []
    own = Triggers(ControlSection(flight_mode="AUTO"), VEHICLE, ("AUTO", "GUIDED"))
    assert requests(own, map(beat, (5, 10, 10, 10))) == []  # sidelong selects it itself


def test_a_mode_is_selected_anew_after_sidelong_had_control_between_two_heartbeats():
    triggers = Triggers(ControlSection(flight_mode="loiter"), VEHICLE, ("AUTO",))

    def changed(custom_mode):
        return message("CURRENT_MODE", 1, VEHICLE, custom_mode=custom_mode)

    assert requests(triggers, map(beat, (5, 12, 12, 12, 12))) == ["watch"]
    assert requests(triggers, [changed(10), changed(12), beat(12), beat(12)]) == []
    assert requests(triggers, [beat(12)]) == ["watch"]


def test_a_mode_that_a_failsafe_selects_requests_nothing():
    triggers = Triggers(ControlSection(flight_mode="loiter"), VEHICLE)
    assert requests(triggers, [beat(5), *(beat(12, system_status=5) for _ in range(9))]) == []
    triggers = Triggers(ControlSection(flight_mode="loiter"), VEHICLE)
    assert requests(triggers, [beat(5), beat(12), receiver(healthy=False), *(beat(12) for _ in range(9))]) == []


def test_a_mode_that_is_left_releases_a_watch_that_has_not_begun(serving):
    async def stands_by(resident):
        resident._triggers = Triggers(ControlSection(flight_mode="loiter"), VEHICLE, ("AUTO",))
        for custom_mode in (5, 12, 12, 12, 5):
            resident._on_message(beat(custom_mode))
        resident.again.set()
        await asyncio.Event().wait()

    async def until(resident):
        resident.again = asyncio.Event()
        await asyncio.wait_for(resident.again.wait(), 5.0)

    assert serving(stands_by, until).begun == 0


def test_a_ground_stations_command_requests_once():
    triggers = Triggers(ControlSection(aux_function=300), VEHICLE)
    announced = [aux(2.0), aux(2.0, 1.0), aux(1.0, 1.5), aux(0.0, 2.0), aux(2.0, 9.0), aux(2.0, 20.0)]
    assert requests(triggers, announced) == ["watch", "release", "watch", "watch"]
    assert requests(triggers, [aux(2.0, 40.0, function=301), aux(2.0, 41.0, target=8)]) == []
    assert requests(Triggers(ControlSection(), VEHICLE), [aux(2.0), *switched((DOWN, 4), (UP, 4)), beat(5)]) == []


def recorded(parent, begun, size):
    folder = RunFolder.create(parent, begun)
    folder.journal.write_bytes(b"x" * size)
    return folder.path


def test_the_runs_made_first_make_room_and_nothing_else_is_touched(tmp_path, synchronised):
    kb, log = 1024, []
    runs = [recorded(tmp_path, datetime(2026, 11, day, 12, tzinfo=UTC), 100 * kb) for day in range(10, 20)]
    others = [
        tmp_path / name for name in ("notes", "20261332T996000Z", "20261101T120000Z", "20261101T120000Z photos")
    ]
    for other in others:
        other.mkdir()
        (other / "journal.jsonl").write_bytes(b"x" * 500 * kb)
    month = timedelta(days=30)
    assert rotate(tmp_path, 350 * kb, month, NOW, log.append, present=runs[0]) <= 350 * kb + 130 * kb
    assert [run.exists() for run in runs] == [True, *[False] * 6, *[True] * 3]
    assert [line for line in log if line.endswith("was deleted: beyond the disk budget")] == log
    assert len(log) == 6
    rotate(tmp_path, 1e12, timedelta(days=3.6), NOW, log.append)
    assert [run.name for run in runs if run.exists()] == ["20261119T120000Z"]
    assert log[-1].endswith("was deleted: older than 3.6 days")
    assert all(other.exists() for other in others)
    assert rotate(tmp_path / "missing", 1.0, month, NOW, log.append) == 0


@pytest.fixture
def synchronised(monkeypatch):
    monkeypatch.setattr(run_folder, "clock_is_synchronised", lambda: True)


def test_a_clock_that_is_not_confirmed_deletes_nothing(tmp_path, monkeypatch, synchronised):
    def rotated(now, clock=True):
        return rotate(tmp_path, 1e12, timedelta(days=90), now, log.append, synchronised=clock)

    log = []
    runs = [recorded(tmp_path, NOW - timedelta(days=day), 1024) for day in (200, 2)]
    rotated(NOW, clock=False)
    rotated(NOW + timedelta(weeks=1024))  # a GPS week that has rolled over, and is served as the time
    rotated(datetime(1980, 1, 6, tzinfo=UTC))
    assert (log, all(run.exists() for run in runs)) == ([], True)
    monkeypatch.setattr(run_folder, "clock_is_synchronised", lambda: False)
    without = recorded(tmp_path, datetime(1970, 1, 1, tzinfo=UTC), 1024)  # no clock battery: it is the latest
    rotated(NOW)
    assert [run.exists() for run in (*runs, without)] == [False, True, True]
    rotate(tmp_path, 12 * 1024, timedelta(days=90), NOW, log.append)
    assert [run.exists() for run in (*runs, without)] == [False, False, True]


def test_records_are_their_owners_alone(tmp_path):
    before = os.umask(0)
    try:
        folder = RunFolder.create(tmp_path / "runs", NOW)
        with closing(Recording(folder, Config(), print)) as recording:
            recording.begin(LocalPlane(47.4, 8.5), (47.4, 8.5))
        folder.write_summary({})
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in (folder.path, folder.path.parent)} == {0o700}
    assert {path.stat().st_mode & 0o777 for path in (folder.journal, folder.tlog, folder.summary)} == {0o600}


def test_records_that_have_no_place_go_into_a_new_folder_of_our_own(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    shared = tmp_path / "sidelong-runs"
    shared.mkdir()
    resident = Resident(Config(), Path("/proc/none"), lambda _text: None)
    parents = [resident._run_folder().path.parent for _ in range(2)]
    assert shared not in parents
    assert [parent.stat().st_mode & 0o777 for parent in parents] == [0o700] * 2
    assert len(set(parents)) == 2


def test_records_that_cannot_be_opened_stop_no_watch(tmp_path):
    announced: list[str] = []
    folder = RunFolder.create(tmp_path, NOW)
    folder.tlog.symlink_to("/dev/full")
    folder.journal.symlink_to("/dev/full")
    plane = LocalPlane(47.4, 8.5)
    with closing(Recording(folder, Config(), announced.append, required=False)) as recording:
        recording.frame(b"\xfe\x00\x00\x01\x01\x00\x00\x00")
        recording.begin(plane, (47.4, 8.5), "ArduPlane", 400.0)
        assert recording.begun
        recording.write(ModeReported(1.0, "AUTO", True))
        assert "takes no records" in recording.lost
    assert any("goes on without this record" in text for text in announced)
    with (
        pytest.raises(InputError, match="takes no records"),
        closing(Recording(folder, Config(), announced.append)) as other,
    ):
        other.begin(plane, (47.4, 8.5))


@pytest.fixture
def path(tmp_path, monkeypatch):
    path = tmp_path / "run" / "serve.sock"
    monkeypatch.setenv("SIDELONG_SOCKET", str(path))
    return path


def test_a_socket_in_no_folder_is_refused_and_none_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("SIDELONG_SOCKET", str(tmp_path / "wrong" / "run" / "serve.sock"))

    async def serve():
        async with control_socket.serving(control_socket.own_path(), dict):
            pytest.fail("it was made")

    with pytest.raises(InputError, match=r"SIDELONG_SOCKET: there is no folder .*wrong; create it"):
        asyncio.run(serve())
    assert not (tmp_path / "wrong").exists()


def test_the_socket_answers_and_only_its_owner_reaches_it(path):
    async def talk():
        async with control_socket.serving(path, lambda request: {"accepted": True, "text": request}):
            assert path.stat().st_mode & 0o777 == 0o660
            assert path.parent.stat().st_mode & 0o007 == 0
            answers = [await asyncio.to_thread(control_socket.ask, one) for one in ("status", "arm")]
            with pytest.raises(InputError, match="another sidelong serve runs"):
                async with control_socket.serving(path, dict):
                    pass
            reader, writer = await asyncio.open_unix_connection(path)
            writer.write(b"\xff{" * 10_000)  # nonsense, and no end of it
            assert await reader.read() in (b"", b"\xff")
            writer.close()
            reader, writer = await asyncio.open_unix_connection(path)
            writer.write(b'{"request":' + b"[" * 3000 + b"\n")
            assert b"a request is one of" in await reader.read()
            writer.close()
            answers.append(await asyncio.to_thread(control_socket.ask, "release"))
            return answers

    status, arm, release = asyncio.run(talk())
    assert (status["text"], release["text"]) == ("status", "release")
    assert arm == {"accepted": False, "text": "a request is one of status, watch, release, confirm"}
    assert not path.exists()
    with pytest.raises(InputError, match="start it with: sidelong serve"):
        control_socket.ask("status")


def test_the_socket_of_a_killed_service_is_taken_over(path):
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))

    async def talk():
        async with control_socket.serving(path, lambda request: {"text": request}):
            return await asyncio.to_thread(control_socket.ask, "watch")

    assert asyncio.run(talk())["text"] == "watch"


FOREIGN = """
import os, socket, sys
os.setgid(65534), os.setuid(65534)
os.makedirs(os.path.dirname(sys.argv[1]), exist_ok=True)
server = socket.socket(socket.AF_UNIX)
server.bind(sys.argv[1])
os.chmod(sys.argv[1], 0o777)
server.listen()
print("ready", flush=True)
while True:
    client = server.accept()[0]
    client.sendall(b'{"accepted": true, "text": "watching", "status": {}}\\n')
    client.close()
"""


@pytest.fixture
def foreign():
    """Let another account answer at a path in the folder that all accounts share."""
    if os.getuid() != 0:
        pytest.skip("only root can act as another account")
    begun = []
    with tempfile.TemporaryDirectory() as shared:
        Path(shared).chmod(0o1777)
        path = Path(shared) / f"sidelong-{os.getuid()}" / "sidelong" / "serve.sock"
        begun.append(subprocess.Popen([sys.executable, "-c", FOREIGN, str(path)], stdout=subprocess.PIPE))
        assert begun[0].stdout.readline() == b"ready\n"
        yield path
        begun[0].kill()
        begun[0].wait()


@pytest.mark.parametrize("request_", control_socket.REQUESTS)
def test_the_answer_of_another_account_is_no_answer(foreign, monkeypatch, request_):
    monkeypatch.setenv("SIDELONG_SOCKET", str(foreign))
    with pytest.raises(InputError, match="the account with the number 65534 listens at"):
        control_socket.ask(request_)


def test_a_service_begins_although_another_account_listens_in_a_shared_folder(foreign, monkeypatch, tmp_path):
    monkeypatch.delenv("SIDELONG_SOCKET", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(foreign.parents[2]))
    for runtime in (foreign.parents[1], tmp_path / "missing"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
        path = control_socket.own_path()
        assert path == tmp_path / ".local/state/sidelong/serve.sock"

        async def talk(path=path):
            async with control_socket.serving(path, lambda request: {"text": request}):
                return await asyncio.to_thread(control_socket.ask, "watch")

        assert asyncio.run(talk())["text"] == "watch"


def test_a_socket_is_not_made_where_others_can_write(foreign):
    async def serve():
        async with control_socket.serving(foreign, dict):
            pass

    with pytest.raises(InputError, match="others can write there"):
        asyncio.run(serve())


def test_an_account_outside_the_group_is_not_answered(path, monkeypatch):
    async def talk():
        async with control_socket.serving(path, lambda request: {"text": request}):
            monkeypatch.setattr(control_socket, "_peer", lambda _connection: (12345, 12345))
            reader, writer = await asyncio.open_unix_connection(path)
            with contextlib.suppress(ConnectionResetError):
                writer.write(b'{"request": "watch"}\n')
                return await reader.read()
            return b""

    assert asyncio.run(talk()) == b""


def test_one_account_holds_so_many_conversations_and_no_more(path):
    async def talk():
        async with control_socket.serving(path, lambda request: {"text": request}):
            idle = [await asyncio.open_unix_connection(path) for _ in range(8)]
            await asyncio.sleep(0)
            reader, writer = await asyncio.open_unix_connection(path)
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            for _, one in (*idle, (reader, writer)):
                one.close()
                await one.wait_closed()
            while True:
                reader, writer = await asyncio.open_unix_connection(path)
                writer.write(b'{"request": "watch"}\n')
                if await reader.read() == b'{"text": "watch"}\n':
                    return writer.close()
                writer.close()

    asyncio.run(asyncio.wait_for(talk(), 20.0))


def test_an_answer_that_is_no_json_is_an_error(path):
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        answering = threading.Thread(target=lambda: server.accept()[0].sendall(b"{oops\n"))
        answering.start()
        with pytest.raises(InputError, match="does not answer"):
            control_socket.ask("status")
        answering.join()


def test_the_service_manager_receives_of_readiness_and_life(tmp_path, monkeypatch):
    notify("READY=1")  # without a manager nothing happens
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    monkeypatch.setenv("WATCHDOG_USEC", "30000")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        notify("READY=1", "STATUS=ready")
        assert manager.recv(100) == b"READY=1\nSTATUS=ready"

        async def live():
            alive = asyncio.create_task(feed_watchdog())
            loop = asyncio.get_running_loop()
            manager.setblocking(False)
            received = [await loop.sock_recv(manager, 100) for _ in range(3)]
            alive.cancel()
            return received

        assert asyncio.run(live()) == [b"WATCHDOG=1"] * 3


def test_the_deployment_files_are_valid(tmp_path):
    config = load_config(DEPLOYMENT / "mission.toml")
    assert config_from(config.model_dump(mode="json"), "again").control.aux_function == 300
    actions = json.loads((DEPLOYMENT / "qgroundcontrol-actions.json").read_text())["actions"]
    triggers = Triggers(config.control, VEHICLE)
    sent = [aux(float(one["param2"]), 10.0 * index, int(one["param1"])) for index, one in enumerate(actions)]
    assert requests(triggers, sent) == ["watch", "release"]
    router = ConfigParser()
    router.read(DEPLOYMENT / "mavlink-router.conf")
    assert config.link.url == f"udpin://127.0.0.1:{router['UdpEndpoint sidelong']['Port']}"
    assert router["General"]["SnifferSysid"] == "1"


@pytest.mark.skipif(which("systemd-analyze") is None, reason="systemd is not installed")
def test_the_unit_is_valid_for_systemd(tmp_path):
    unit = (DEPLOYMENT / "sidelong.service").read_text().replace("/opt/sidelong/bin/sidelong", "/bin/true")
    file = tmp_path / "sidelong.service"
    file.write_text(unit)
    verified = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(file)], capture_output=True, text=True, check=False
    )
    complaints = [line for line in verified.stderr.splitlines() if "sidelong.service" in line]
    assert not [line for line in complaints if "mavlink-router" not in line], verified.stderr


class Watched(Resident):
    """A service whose vehicle is always ready; each watch lasts until it is stopped.

    Attributes:
        begun: How many watches have begun.
    """

    def __init__(self, out, stands_by):
        super().__init__(config_from({"link": {"url": "udpin://127.0.0.1:1"}}, "test"), out, lambda _text: None)
        self.begun, self._stands_by = 0, stands_by

    async def _prepare(self):
        pass

    async def _attend(self, stopped):
        while not stopped.is_set():
            self._stands("")
            await self._stands_by(self)
            await self._watch_once(None)

    async def _flown(self, session, display):
        self.begun += 1
        self._life = Life(lambda: True, lambda _text: None)
        await self._life.stopped.wait()
        raise FlightError("the link is lost")


@pytest.fixture
def serving(tmp_path):
    async def served(stands_by, until):
        resident, stopped = Watched(tmp_path, stands_by), asyncio.Event()
        running = asyncio.create_task(resident.run(stopped, tmp_path / "s.sock"))
        await until(resident)
        stopped.set()
        await asyncio.wait_for(running, 5.0)
        return resident

    return lambda stands_by, until: asyncio.run(served(stands_by, until))


def test_a_watch_that_is_released_before_it_begins_does_not_begin(serving):
    async def stands_by(resident):
        if not resident.released:
            resident.released = [resident.request(one, "a command")[0] for one in ("watch", "release")]
            return
        resident.again.set()
        await asyncio.Event().wait()

    async def until(resident):
        resident.released, resident.again = [], asyncio.Event()
        await asyncio.wait_for(resident.again.wait(), 5.0)

    resident = serving(stands_by, until)
    assert resident.released == [True, True]
    assert resident.begun == resident.status.watches == 0


async def _asks_to_watch(resident):
    resident.request("watch", "a command")


async def _has_begun(resident):
    while not resident.begun:
        await asyncio.sleep(0.01)


def test_a_service_that_is_stopped_in_a_watch_ends_with_it(serving):
    assert serving(_asks_to_watch, _has_begun).begun == 1


def test_a_watch_that_is_released_is_shown_as_ending_at_once(serving):
    async def until(resident):
        await _has_begun(resident)
        assert resident.request("release", "a command")[0]
        assert str(resident.status) == "watching: ending: released"

    serving(_asks_to_watch, until)


def test_a_fault_is_shown_until_a_check_fails(tmp_path):
    resident = Watched(tmp_path, None)
    resident._become(State.FAULT, "the link is lost")
    unchecked = Standby(SimpleNamespace(vehicle=SimpleNamespace(listeners=[])), Config()).missing
    for missing, state in (
        (unchecked, State.FAULT),
        ("", State.FAULT),
        ("home: not known", State.WAITING),
        ("", State.READY),
    ):
        resident._stands(missing)
        assert resident.status.state is state


def test_a_vehicle_with_another_system_id_is_obeyed(tmp_path, monkeypatch):
    resident = Watched(tmp_path, None)
    resident._config = config_from({"link": {"url": "udpin://127.0.0.1:1"}, "control": {"aux_function": 300}}, "test")
    asked: list[str] = []
    monkeypatch.setattr(resident, "request", lambda request, _who: (True, asked.append(request)))
    autopilot = SimpleNamespace(name="ArduPlane", mission_mode="AUTO", circle_mode="GUIDED")
    for number, system_id in enumerate((VEHICLE, 3)):
        link = SimpleNamespace(own_id=(245, 190))
        vehicle = SimpleNamespace(system_id=system_id, bystanders=[], link=link)
        resident._join(SimpleNamespace(vehicle=vehicle, autopilot=autopilot))
        vehicle.bystanders[0](aux(2.0, 10.0 * number, target=system_id))
    assert asked == ["watch", "watch"]


def test_the_status_of_a_watch_names_records_that_are_lost_meanwhile(tmp_path, monkeypatch):
    async def flown(shell):
        folder, recording = shell._aircraft[0].folder, shell._aircraft[0].recording
        shown.append(resident.status.records)
        folder.journal.symlink_to("/dev/full")
        recording.begin(LocalPlane(47.4, 8.5), (47.4, 8.5))
        shown.append(resident.status.records)
        raise FlightError("the link is lost")

    shown: list[str] = []
    monkeypatch.setattr("sidelong.app.serve.resident.Shell.fly", flown)
    resident = Resident(Config(), tmp_path, lambda _text: None)
    resident._wanted = True
    asyncio.run(resident._watch_once(None))
    assert shown[0] == ""
    assert "takes no records" in shown[1]
    assert resident.status.records == shown[1]


def test_the_status_of_a_watch_names_what_is_wrong(tmp_path):
    snapshot = prepared(Config()).controller().snapshot()
    resident = Watched(tmp_path, None)
    resident._become(State.WATCHING, "")
    display = resident._display = ServiceDisplay(print, lambda: None, print)
    alarm = Alarm("link", "nothing received from the aircraft for 3 s", "check radio and antenna", 0.0)
    display.show(replace(snapshot, vehicle=VehicleStatus(alarms=(alarm,))))
    assert str(resident.status) == "watching: nothing received from the aircraft for 3 s"
    display.show(replace(snapshot, vehicle=VehicleStatus()))
    assert str(resident.status) == "watching"


def test_a_service_goes_on_without_a_map_that_cannot_be_served(free_port, capsys):
    display = ServiceDisplay(print, lambda: None, print)

    async def show(address):
        async with contextlib.AsyncExitStack() as stack:
            page = serve.ServicePage(Config(), address, stack)
            await page.open()
            async with page.decorate(display) as shown:
                shown.note("taking off")

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port()))
        taken.listen()
        asyncio.run(show(PageAddress("127.0.0.1", taken.getsockname()[1])))
    printed = capsys.readouterr().out
    assert printed.count("the service goes on without the live map: the page cannot be shown on 127.0.0.1:") == 2
    assert "taking off" in printed


def test_the_page_of_a_service_is_there_from_the_start_and_shows_what_is_missing(tmp_path, monkeypatch):
    async def show():
        async with contextlib.AsyncExitStack() as stack:
            page = serve.ServicePage(Config(), PageAddress(port=0), stack)
            resident = Resident(Config(), tmp_path, lambda _text: None, page.decorate, page.draw)
            await page.open(resident)
            shown = [dict(page._view._stage)]
            resident.checks = (Check("home", False, "not known", "wait for the GPS"),)
            resident._stands("home: not known; wait for the GPS")
            shown.append(dict(page._view._stage))
            page._view._pressed({"action": "watch", "who": "operator"})
            shown.append(page._view._announced[-1])
            resident.checks = (Check("home", True, "known"),)
            resident._stands("")
            shown.append(dict(page._view._stage))
            return shown

    first, missing, refused, ready = asyncio.run(show())
    assert (first["name"], first["text"]) == ("waiting", "not connected yet")
    assert missing["checks"] == [("home", False, "not known; wait for the GPS")]
    assert refused == [None, "refused", "watch: home: not known; wait for the GPS"]
    assert ready["name"] == "ready"


def test_a_map_that_cannot_be_served_is_reported_at_the_start(monkeypatch):
    async def ended(*_arguments):
        pass

    monkeypatch.setattr(Resident, "run", ended)
    arguments = ["serve", "--connect", "udpin://127.0.0.1:1", "--view", "--set", "display.port=0", "--set"]
    far, here = (
        CliRunner().invoke(app, [*arguments, f"display.host={host}"]).output for host in ("192.0.2.1", "127.0.0.1")
    )
    assert "the page cannot be shown on 192.0.2.1:0: port 0 cannot be opened (Cannot assign requested address)" in far
    assert "192.0.2.1" not in here
    assert "live map: http://127.0.0.1:" in here
    assert "`sidelong watch`" in here


def test_a_run_that_is_deleted_while_it_is_measured_stops_no_rotation(tmp_path, monkeypatch):
    def vanished(_path, _pattern):
        raise FileNotFoundError

    recorded(tmp_path, NOW, 1024)
    monkeypatch.setattr(Path, "rglob", vanished)
    assert rotate(tmp_path, 1e9, timedelta(days=30), NOW, print) == 0


def test_a_refused_resumption_is_in_the_status_and_sent_to_the_ground_station(tmp_path, monkeypatch):
    resident, sent = Watched(tmp_path, None), []
    monkeypatch.setattr(resident, "_inform_station", sent.append)
    resident._become(State.YIELDED, "the flight mode was changed to MANUAL")
    display = ServiceDisplay(print, lambda: None, resident._refused)
    display.say(Announce(0.0, "refused", "resume refused: the aircraft is on the ground"))
    assert str(resident.status) == "yielded: resume refused: the aircraft is on the ground"
    assert sent[-1] == "resume refused: the aircraft is on the ground"
