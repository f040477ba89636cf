"""The pipe to the page's process never waits, and never tears a line."""

from __future__ import annotations

import sys
from contextlib import closing

import pytest

from sidelong.app.view.feed import Feed, FeedError

# Says that it is up, then reads nothing until it is told to: by a line on its input's place, a file.
LAZY = """
import pathlib, sys, time
print("up", flush=True)
while not pathlib.Path(sys.argv[1]).exists(): time.sleep(0.005)
for line in sys.stdin.buffer: sys.stdout.buffer.write(line); sys.stdout.buffer.flush()
"""


def python(code: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code, *arguments)


def test_what_does_not_fit_is_left_out_and_the_rest_arrives_whole_and_in_order(tmp_path):
    begin = tmp_path / "begin"
    with closing(Feed(python(LAZY, str(begin)))) as feed:
        assert feed.wait_for_line(30.0) == b"up"
        lines = [b"%04d:" % n + b"x" * 3000 for n in range(200)]
        sent = [line for line in lines if feed.send(line)]
        assert 2 < len(sent) < len(lines)
        begin.touch()
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
        assert not feed.send(b"anybody?")


def test_the_complaint_of_a_process_that_does_not_come_up_is_told():
    with pytest.raises(FeedError, match="no such port"):
        Feed(python("import sys; sys.exit('no such port')")).wait_for_line(30.0)
