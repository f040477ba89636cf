"""A flight that is interrupted at some moment, and what has to be left of it."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.tlog import read_tlog

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NOTHING_BEGUN = re.compile(r"sidelong: interrupted(: nothing was commanded; no records are kept)?\.")
_WOUND_UP = re.compile(
    r"sidelong: interrupted by SIG(INT|TERM|HUP): the aircraft "
    r"(is not armed|flies to its first circle and stays on it|goes on circling where it is|flies on in \w+), "
    r"but it was simulated and ends with this program\."
)
_LAUNCH = ("launch", "--planner", "paper", "--duration", "250", "--target", "straight")
_ENDS_WITHIN_S = 90.0
_BEGUN = "signals are handled"
# The program as ``python -m sidelong.app`` runs it. What it imports first, it imports once it handles signals. It
# suspends itself where it prints the first argument: how far it is then does not depend on the load of the machine.
_PROGRAM = f"""
import os, signal, sys
from sidelong.app.__main__ import main
after, printed, write = sys.argv.pop(1), "", sys.stdout.write
def write_and_wait(text):
    global printed
    count, printed = write(text), printed + text
    if after in printed and text.endswith("\\n"):
        sys.stdout.write = write
        sys.stdout.flush()
        os.kill(os.getpid(), signal.SIGSTOP)
    return count
sys.stdout.write = write_and_wait
def report(event, arguments):
    if event == "import" and arguments[0] == "sidelong.app.process":
        print("{_BEGUN}")
    if event == "import" and arguments[0] == "sidelong.app.commands.flying":
        from sidelong.app.study import prediction
        prediction.FLIGHT_S = 60.0  # 3 s of computing less before each flight
sys.addaudithook(report)
main()
"""


@dataclass(frozen=True, slots=True)
class Interruption:
    """after_s: of wall time since the program printed a line with the text ``after``."""

    signal: signal.Signals
    after_s: float
    after: str = _BEGUN
    speed: float = 10.0

    @staticmethod
    def drawn(seed: str) -> Interruption:
        rng = random.Random(seed)
        after = rng.choice((_BEGUN, "connecting", "checking", "arming", "taking off", "watched from now on"))
        return Interruption(rng.choice(SIGNALS), rng.uniform(0.2, 4.0), after)


def left_of(interruption: Interruption, out: Path) -> tuple[str, list[str]]:
    """Interrupt a flight into ``out``; return its last sentence, and what is wrong with what it left."""
    process = subprocess.Popen(
        # Hanging up counts, whatever the tests run under.
        [
            "env",
            "--default-signal=HUP",
            sys.executable,
            "-c",
            _PROGRAM,
            interruption.after,
            *_LAUNCH,
            "--set",
            f"simulation.speed={interruption.speed}",
            "--out",
            str(out),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    announced = []
    for line in process.stdout:
        announced.append(line)
        if interruption.after in line:
            break
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    timer = threading.Timer(interruption.after_s, process.send_signal, (interruption.signal,))
    if interruption.after_s:
        timer.start()
    else:
        process.send_signal(interruption.signal)
    try:
        process.send_signal(signal.SIGCONT)
        rest, complaint = process.communicate(timeout=_ENDS_WITHIN_S)
    except subprocess.TimeoutExpired as late:
        return "none", [f"had not ended after {_ENDS_WITHIN_S:g} s: {late.stdout!r}"]
    finally:
        timer.cancel()
        process.kill()
    wrong = list(_wrongs(process.returncode, "".join(announced) + rest, complaint.strip(), list(out.glob("2*"))))
    return f"{process.returncode} {complaint.strip()}", wrong


def _wrongs(code: int, announced: str, complaint: str, runs: list[Path]) -> list[str]:
    if code == 0 and not complaint:
        return [] if "completed" in announced else ["ended in order, and not on its own"]  # the signal came too late
    wrong = [] if code == 130 else [f"exit code {code}"]
    if "Traceback" in complaint or "\n" in complaint:
        wrong.append(f"more than a sentence: {complaint[:500]}")
    if _NOTHING_BEGUN.fullmatch(complaint):
        return wrong + [f"{run} was left" for run in runs]
    if not _WOUND_UP.fullmatch(complaint):
        wrong.append(f"not a sentence that is known: {complaint[:500]}")
    if len(runs) != 1:
        return [*wrong, f"{len(runs)} run folders"]
    if "outcome" not in announced or str(runs[0]) not in announced:
        wrong.append("no summary")
    return wrong + _damages(runs[0])


def _damages(run: Path) -> list[str]:
    """Return anything not whole of a run's records."""
    wrong = []
    summary = run / "summary.json"
    if not summary.exists() or json.loads(summary.read_text())["outcome"] != "interrupted":
        wrong.append("no summary.json of an interrupted flight")
    journal = JournalReader(run / "journal.jsonl", JOURNAL_TYPES)
    for _ in journal:
        pass
    if journal.damaged_lines or not (run / "journal.jsonl").read_bytes().endswith(b"\n"):
        wrong.append("the journal is cut")
    if not any(True for _ in read_tlog(run / "flight.tlog", ["HEARTBEAT"])):
        wrong.append("the tlog is empty")
    return wrong
