"""How long the next upload is expected to take."""

from __future__ import annotations

from collections import deque

# The longest of so many uploads but one, once there are three: one that hung says nothing of the next. Each took as
# many round trips as the next will take, at least two of them: the announcement's and the items'.
_UPLOADS, _MARGIN_S = 5, 0.1
_ROUND_TRIPS = 2.0


class UploadLatency:
    """expected_s: of the next upload, on the vehicle's clock; as it is given until one was measured."""

    def __init__(self, expected_s: float) -> None:
        self.expected_s = self._given_s = expected_s
        self._round_trip_s: float | None = None  # of the link, now
        self._took_s: deque[tuple[float, float | None]] = deque([(expected_s, None)], _UPLOADS)

    def note(self, took_s: float) -> None:
        """Take how long an upload took; of one that was given up too, which would have taken longer."""
        self._took_s.append((took_s, self._round_trip_s))
        self._expect()

    def note_round_trip(self, round_trip_s: float) -> None:
        """Take how long the link takes now."""
        self._round_trip_s = round_trip_s
        self._expect()

    def _expect(self) -> None:
        now_s = self._round_trip_s
        expected = sorted(
            took_s if now_s is None or then_s is None else took_s + _ROUND_TRIPS * (now_s - then_s)
            for took_s, then_s in self._took_s
        )
        if len(self._took_s) > 1:
            self.expected_s = expected[-2 if len(expected) > 2 else -1] + _MARGIN_S
        else:
            self.expected_s = self._given_s
        if now_s is not None:
            self.expected_s = max(self.expected_s, _ROUND_TRIPS * now_s)
