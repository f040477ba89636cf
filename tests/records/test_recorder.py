"""Telemetry logs written while flying: what other programs open, from any thread, on a full disk, after a kill."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from pymavlink import mavutil

from sidelong.app.errors import InputError
from sidelong.app.records import text_file
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import check_space
from sidelong.app.records.text_file import Appender
from sidelong.app.records.tlog import TlogWriter, read_tlog
from sidelong.mission.core.events import Announce

ROOT = Path(__file__).parents[2]


def no_trouble(sentence: str) -> None:
    raise AssertionError(sentence)


def test_pymavlink_reads_what_was_written_with_its_times(tmp_path, sender):
    path = tmp_path / "flight.tlog"
    with TlogWriter(path, no_trouble) as log:
        for i in range(100):
            log.write(sender().attitude(i), 1.7e9 + 0.1 * i)
    read = mavutil.mavlink_connection(str(path))
    found = []
    while (m := read.recv_match(type="ATTITUDE")) is not None:
        found.append((m.time_boot_ms, m._timestamp))
    assert found == [(i, pytest.approx(1.7e9 + 0.1 * i, abs=1e-6)) for i in range(100)]


def test_frames_of_many_threads_stay_whole(tmp_path, sender):
    path = tmp_path / "flight.tlog"
    with TlogWriter(path, no_trouble) as log:

        def write(component: int) -> None:
            for i in range(500):
                log.write(sender(component=component).attitude(i), 1.7e9)

        threads = [threading.Thread(target=write, args=(component,)) for component in range(1, 5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = list(read_tlog(path))
    assert len(found) == 2000
    for component in range(1, 5):
        assert [m.fields["time_boot_ms"] for m in found if m.component_id == component] == list(range(500))


def test_a_log_is_never_written_over(tmp_path):
    (tmp_path / "flight.tlog").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        TlogWriter(tmp_path / "flight.tlog", no_trouble)


# A real full disk needs a file system of its own; a limit on the size of files refuses the write just the same.
LIMITED = """
import resource, signal, sys
from pathlib import Path
from sidelong.app.records import text_file
from sidelong.app.records.text_file import Appender
from sidelong.app.records.journal import JournalReader
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
appender = Appender(Path(sys.argv[1]), lambda sentence: print(sentence, flush=True))
for _ in range(3):
    appender.append(bytes(6_000))
    appender.append(bytes(6_000))
appender.close()
appender.append(b"late")
print("flew on")
"""


def test_a_full_disk_ends_the_recording_with_one_sentence_and_not_the_flight(tmp_path):
    path = tmp_path / "flight.tlog"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path)], capture_output=True, text=True, timeout=60, check=True
    )
    sentence, last = done.stdout.splitlines()
    assert sentence == f"recording has ended: {path} cannot be written (File too large); the flight goes on."
    assert last == "flew on"
    assert path.stat().st_size == 10_000


def test_a_backlog_that_no_disk_takes_ends_the_recording(tmp_path, monkeypatch):
    monkeypatch.setattr(text_file, "_BACKLOG_MAX_BYTES", 1000)
    announced: list[str] = []
    with Appender(tmp_path / "flight.tlog", announced.append) as log:
        log.append(bytes(1001))
        log.append(b"late")
    assert announced == [
        f"recording has ended: the disk of {tmp_path / 'flight.tlog'} is too slow; the flight goes on."
    ]
    assert (tmp_path / "flight.tlog").read_bytes() == b""


FLYING = """
import sys, time
from pathlib import Path
from sidelong.app.records.journal import Header, JournalWriter
from sidelong.app.records.tlog import TlogWriter
from sidelong.mission.core.events import Announce
from pymavlink.dialects.v20 import ardupilotmega as dialect
folder, mav = Path(sys.argv[1]), dialect.MAVLink(None, srcSystem=1, srcComponent=1)
tlog = TlogWriter(folder / "flight.tlog", print)
journal = JournalWriter(folder / "journal.jsonl", Header("test", {}, None, {}), print)
while True:
    now_s = time.time()
    journal.write(Announce(now_s, "track", "as long as a line may be " * 5))
    tlog.write(dialect.MAVLink_heartbeat_message(1, 3, 81, 10, 4, 3).pack(mav), now_s)
    print(repr(now_s), flush=True)
    sys.stdin.readline()  # the test sets the pace
"""


@pytest.mark.parametrize("events", [1, 100, 170, 600])
def test_a_kill_at_any_moment_leaves_both_records_readable_to_the_last_second(tmp_path, events):
    process = subprocess.Popen(
        [sys.executable, "-c", FLYING, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
        cwd=ROOT,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        announced_s = []
        for _ in range(events):
            announced_s.append(float(process.stdout.readline()))
            process.stdin.write("\n")
    finally:
        process.kill()
    with process:
        announced_s += [float(line) for line in process.stdout]
    assert process.returncode == -signal.SIGKILL
    read_s = [event.time_s for event in JournalReader(tmp_path / "journal.jsonl", [Announce])]
    received_s = [m.received_s for m in read_tlog(tmp_path / "flight.tlog")]
    assert read_s[: len(announced_s)] == announced_s[: len(read_s)]
    assert received_s[: len(announced_s)] == pytest.approx(announced_s[: len(received_s)], abs=1e-6)
    if announced_s[-1] - announced_s[0] > 1.0:
        assert announced_s[-1] - read_s[-1] < 1.0
        assert announced_s[-1] - received_s[-1] < 1.0


@pytest.mark.parametrize(
    ("free", "duration_s", "aircraft", "answer"),
    [(10e6, 60.0, 1, "refused"), (30e6, 3600.0, 1, "warned"), (100e6, 3600.0, 1, ""), (100e6, 3600.0, 2, "warned")],
)
def test_the_free_space_is_checked_before_a_flight(tmp_path, monkeypatch, free, duration_s, aircraft, answer):
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=free) if path == tmp_path else None)
    warnings = []
    if answer == "refused":
        with pytest.raises(InputError, match=r"only 10\.0 MB are free"):
            check_space(tmp_path / "runs" / "new", duration_s, aircraft, warnings.append)
    else:
        check_space(tmp_path / "runs" / "new", duration_s, aircraft, warnings.append)
    assert bool(warnings) is (answer == "warned")
