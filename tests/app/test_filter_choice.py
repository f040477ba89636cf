"""``sensors.filter``: what is configured flies, and is replayed."""

from datetime import UTC, datetime

import pytest
from filterpy.kalman import ExtendedKalmanFilter

from sidelong.app.analysis.replay import JournalReplay
from sidelong.app.assembly import prepared
from sidelong.app.config import Config
from sidelong.app.flight.recording import JOURNAL_TYPES
from sidelong.app.records.journal import JournalReader
from sidelong.app.records.run_folder import RunFolder
from tests.app.conftest import recorded

pytestmark = pytest.mark.usefixtures("small_tables")


def test_a_flight_on_the_ekf_of_filterpy_is_replayed_to_the_last_bit(tmp_path, monkeypatch):
    counted = {"predict": 0, "update": 0}
    for name in counted:
        real = getattr(ExtendedKalmanFilter, name)

        def counting(*arguments, name=name, real=real, **named):
            counted[name] += 1
            return real(*arguments, **named)

        monkeypatch.setattr(ExtendedKalmanFilter, name, counting)
    config = Config.model_validate({"sensors": {"filter": "ekf"}})
    folder = RunFolder.create(tmp_path, datetime(2026, 11, 22, tzinfo=UTC))
    recorded(folder, config, 60.0, {})
    assert min(counted.values()) > 200

    replay = JournalReplay(prepared(config).controller())
    assert list(replay.run(JournalReader(folder.journal, JOURNAL_TYPES)))
    assert replay.difference is None
    assert replay.compared > 10
    other = JournalReplay(prepared(Config()).controller())
    assert list(other.run(JournalReader(folder.journal, JOURNAL_TYPES)))
    assert other.difference is not None
