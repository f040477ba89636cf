"""How long the next plan is expected to take until it is flown. Source: docs/explanation/exchange.md."""

from __future__ import annotations

from collections import deque

# The second longest of this many plans, once there are three: a stalled upload is an outlier. Each took as many round
# trips as the next will take: an upload at least two (the count's and the items'), a command one.
_PLANS, _MARGIN_S = 5, 0.1
_UPLOAD_ROUND_TRIPS, _COMMAND_ROUND_TRIPS = 2.0, 1.0


class UploadLatency:
    """expected_s: of the next plan, on the vehicle's clock; as it is given until one was measured.

    command_s: from a command that is sent until it is obeyed, as a rule; 0 before one was measured.
    """

    def __init__(self, expected_s: float) -> None:
        self.expected_s = self._given_s = expected_s
        self.command_s = 0.0
        self._by_command = False
        self._round_trip_s: float | None = None  # of the link, now
        self._took_s: deque[tuple[float, float | None]] = deque([(expected_s, None)], _PLANS)

    def note(self, took_s: float, *, by_command: bool = False) -> None:
        """Process the duration of an upload, also of one that was abandoned and would have taken longer.

        Args:
            took_s: Duration until the plan could be flown, s.
            by_command: The plan was not uploaded, but flown as soon as one command was obeyed.
        """
        self._by_command = by_command
        self._took_s.append((took_s, self._round_trip_s))
        self._expect()

    def note_round_trip(self, round_trip_s: float) -> None:
        """Process a measured round trip of the link."""
        self._round_trip_s = round_trip_s
        self._expect()

    def _expect(self) -> None:
        now_s = self._round_trip_s
        round_trips = _COMMAND_ROUND_TRIPS if self._by_command else _UPLOAD_ROUND_TRIPS
        min_s = 0.0 if now_s is None else round_trips * now_s
        expected = sorted(
            took_s if now_s is None or then_s is None else took_s + round_trips * (now_s - then_s)
            for took_s, then_s in self._took_s
        )
        if len(expected) > 1:
            self.expected_s = expected[-2 if len(expected) > 2 else -1] + _MARGIN_S
        else:
            self.expected_s = self._given_s
        self.expected_s = max(self.expected_s, min_s)
        if self._by_command:
            self.command_s = max(expected[(len(expected) - 1) // 2], min_s)
