"""Text files are written whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from sidelong.app.records.text_file import write_text
from tests.command_line import sidelong


def _full(_descriptor):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("before", ["", "kept"])
def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch, before):
    monkeypatch.setattr(os, "fsync", _full)
    file = tmp_path / "mission.toml"
    if before:
        file.write_text(before)
    ended = sidelong("init", file, "--force")
    assert ended.returncode == 2
    assert "cannot be written (No space left on device)" in ended.stderr
    assert [path.read_text() for path in tmp_path.iterdir()] == ([before] if before else [])


def test_a_link_and_the_permissions_of_a_file_stay(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("before")
    file.chmod(0o600)
    link.symlink_to(file)
    write_text(link, "after")
    assert link.is_symlink()
    assert file.read_text() == "after"
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_device_is_written_directly():
    write_text(Path("/dev/null"), "text")
    assert Path("/dev/null").is_char_device()
