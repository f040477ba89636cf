"""The pipe to the page's process never waits, and never tears a line."""

from __future__ import annotations

import os
import sys
from contextlib import closing

import pytest

from sidelong.app.view.process import Feed, FeedError

# Prints that it is up, then reads nothing until the test opens the named pipe for writing.
LAZY = """
import sys
print("up", flush=True)
open(sys.argv[1]).close()
for line in sys.stdin.buffer: sys.stdout.buffer.write(line); sys.stdout.buffer.flush()
"""


def python(code: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code, *arguments)


def test_what_does_not_fit_is_left_out_and_the_rest_arrives_whole_and_in_order(tmp_path):
    begin = tmp_path / "begin"
    os.mkfifo(begin)
    with closing(Feed(python(LAZY, str(begin)))) as feed:
        assert feed.wait_for_line(30.0) == b"up"
        lines = [b"%04d:" % n + b"x" * 3000 for n in range(200)]
        sent = [line for line in lines if feed.send(line)]
        assert 2 < len(sent) < len(lines)
        begin.open("w").close()
        echoed: list[bytes] = []
        while len(echoed) < len(sent):
            echoed += feed.lines()
            feed.flush()
            assert feed.alive
        assert echoed == sent
        assert feed.send(b"again")


def test_a_process_that_ends_is_noticed_and_harmless():
    with closing(Feed(python("print('up', flush=True)"))) as feed:
        feed.wait_for_line(30.0)
        while feed.alive:
            feed.lines()
        assert not feed.send(b"anyone?")


def test_the_complaint_of_a_process_that_does_not_come_up_is_reported():
    with pytest.raises(FeedError, match="no such port"):
        Feed(python("import sys; sys.exit('no such port')")).wait_for_line(30.0)
