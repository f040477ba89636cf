"""The vehicle of :mod:`sidelong.sitl` in the closed loop: every message is packed into a frame and parsed again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from sidelong.app.link.frames import Decoder, Packer
from sidelong.app.link.message import Message
from sidelong.sitl.simulation import STEP_S, Simulation

ADDRESS = "us"
_SET_MESSAGE_INTERVAL = 511
_BOOT_S = 25.0
RATES_HZ = {30: 20.0, 33: 10.0, 42: 5.0, 87: 2.0, 360: 2.0, 436: 5.0}
"""Of the messages a flight needs, by id."""


class SitlVehicle:
    """A simulation with one station, which has asked for the messages that a flight needs.

    Args:
        simulation: the vehicle with target and payload; it is booted here.
        rates_hz: messages to ask for, by id.
        address: of the station.
    """

    def __init__(
        self, simulation: Simulation, rates_hz: Mapping[int, float] = RATES_HZ, address: str = ADDRESS
    ) -> None:
        self.simulation, self._address = simulation, address
        self._decoder = Decoder()
        simulation.connect(address)
        simulation.advance(simulation.time_s + _BOOT_S)
        packer = Packer()
        for message_id, rate_hz in rates_hz.items():
            asked = {"command": _SET_MESSAGE_INTERVAL, "param1": message_id, "param2": 1e6 / rate_hz}
            self.receive(packer.frame("COMMAND_LONG", asked, self.system_id))

    @property
    def system_id(self) -> int:
        """Its MAVLink system id."""
        return self.simulation.settings.system_id

    @property
    def tick_s(self) -> float:
        """The step of the simulation."""
        return STEP_S

    @property
    def time_s(self) -> float:
        """The simulation's clock."""
        return self.simulation.time_s

    def advance(self, to_s: float) -> None:
        """Fly until a time."""
        self.simulation.advance(to_s)

    def receive(self, frame: bytes) -> None:
        """Take a frame from sidelong."""
        self.simulation.receive(self._address, frame)

    def take(self) -> list[bytes]:
        """Return the frames to the station since the last call."""
        return [frame for address, frame in self.simulation.take() if address == self._address]

    def messages(self, packets: Iterable[bytes], received_s: float) -> Iterator[Message]:
        """Decode frames."""
        for packet in packets:
            yield from self._decoder.messages(packet, received_s)
