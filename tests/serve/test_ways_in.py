"""What a ground station sends to the service, over a real socket and MAVSDK, next to a live simulated vehicle."""

from __future__ import annotations

import asyncio
import socket
from contextlib import asynccontextmanager
from itertools import product

import pytest
from mavsdk.asyncio import Mavsdk
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.config import config_from
from sidelong.app.errors import FlightError
from sidelong.app.serve import resident as service
from sidelong.app.serve.resident import Resident, State
from tests.autopilot.conftest import vehicle_of  # noqa: F401  # a fixture

pytestmark = pytest.mark.udp

PATIENCE_S = 120.0
HIGH, LOW = 2.0, 0.0
FUNCTION = 300


class Station:
    """A ground station whose frames come to the service's own port, as from a router."""

    def __init__(self, port):
        self._address = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def press(self, level, target=(1, 1), sender=(255, 190), as_int=False):
        packer = mavlink.MAVLink(None, *sender)
        kind, head, rest = mavlink.MAVLink_command_long_message, (mavlink.MAV_CMD_DO_AUX_FUNCTION, 0), (0.0,) * 5
        if as_int:
            kind, head = mavlink.MAVLink_command_int_message, (0, mavlink.MAV_CMD_DO_AUX_FUNCTION, 0, 0)
            rest = (0.0, 0.0, 0, 0, 0.0)
        message = kind(*target, *head, float(FUNCTION), level, *rest)
        self.socket.sendto(message.pack(packer), self._address)


class Transmitter:
    """A transmitter and the receiver of a live vehicle, which reports channel 9 and the receiver's health."""

    def __init__(self, vehicle):
        autopilot, self._vehicle = vehicle.autopilot, vehicle
        self._pulse_us, self.receives = 1000, True
        builder_of, receiver = autopilot._builder_of, mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        status = builder_of(mavlink.MAVLINK_MSG_ID_SYS_STATUS)

        def health():
            message = status()
            message.onboard_control_sensors_present |= receiver
            message.onboard_control_sensors_enabled |= receiver
            message.onboard_control_sensors_health &= ~receiver
            message.onboard_control_sensors_health |= receiver * self.receives
            return message

        def channels():
            pulses = [1500] * 8 + [self._pulse_us] + [65535] * 9
            return mavlink.MAVLink_rc_channels_message(autopilot.boot_ms, 16, *pulses, 200)

        own = {mavlink.MAVLINK_MSG_ID_SYS_STATUS: health, mavlink.MAVLINK_MSG_ID_RC_CHANNELS: channels}
        vehicle.do(lambda: setattr(autopilot, "_builder_of", lambda number: own.get(number) or builder_of(number)))

    def move(self, pulse_us, receives=True):
        """Let channel 9 have another pulse width from now on."""
        self._pulse_us, self.receives = pulse_us, receives


class Watching:
    """What stands for a flight: it lasts until the service ends it.

    Attributes:
        begun: How many have begun.
        lasting: How many last.
    """

    def __init__(self):
        self.begun = self.lasting = 0

    async def fly(self, life):
        self.begun, self.lasting = self.begun + 1, self.lasting + 1
        await life.stopped.wait()
        self.lasting -= 1
        raise FlightError("released")


async def come(condition):
    """Wait until a condition holds."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.01)


@asynccontextmanager
async def serving(vehicle, out, monkeypatch, heartbeat_timeout_s=10.0, **control):
    """Serve a live vehicle; yield the service, what it watches with, and a station."""

    async def prepared(_resident):
        pass

    watching = Watching()
    monkeypatch.setattr(Resident, "_prepare", prepared)
    monkeypatch.setattr(service.Shell, "fly", lambda shell: watching.fly(shell._life))
    link = {"url": vehicle.url, "heartbeat_timeout_s": heartbeat_timeout_s}
    config = config_from({"link": link, "control": control}, "test")
    resident, stopped = Resident(config, out / "runs", lambda _text: None), asyncio.Event()
    running = asyncio.create_task(resident.run(stopped, out / "serve.sock"))
    station = Station(vehicle.ports[0])
    try:
        await come(lambda: resident.status.state is State.READY)
        yield resident, watching, station
    finally:
        stopped.set()
        await asyncio.wait_for(running, PATIENCE_S)
        station.socket.close()


TARGETS = ((1, 1), (1, 0), (0, 0), (1, 191))
SENDERS = ((255, 190), (255, 0), (250, 190), (42, 1))


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_an_auxiliary_function_arrives_in_each_form(vehicle_of, tmp_path, monkeypatch, flavour):  # noqa: F811
    async def pressed():
        requested = []
        async with serving(vehicle_of(flavour, speed=2.0), tmp_path, monkeypatch, aux_function=FUNCTION) as (
            resident,
            _,
            station,
        ):
            monkeypatch.setattr(resident, "request", lambda one, _who: requested.append(one) or (True, ""))
            for target, sender, as_int in product(TARGETS, SENDERS, (False, True)):
                for level, request in ((HIGH, "watch"), (LOW, "release")):
                    requested.clear()
                    station.press(level, target, sender, as_int)
                    await come(lambda: requested)
                    assert requested == [request], (target, sender)
            requested.clear()
            for target in ((7, 1), (245, 190), (1, 154)):
                station.press(HIGH, target)
            station.press(HIGH)
            await come(lambda: requested)
            assert requested == ["watch"]

    asyncio.run(pressed())


def test_a_command_to_us_is_answered_once_as_accepted(vehicle_of, tmp_path, monkeypatch):  # noqa: F811
    async def pressed():
        vehicle = vehicle_of("arduplane", speed=2.0)
        async with serving(vehicle, tmp_path, monkeypatch, aux_function=FUNCTION) as (_, watching, station):
            station.socket.setblocking(False)
            parser, answers = mavlink.MAVLink(None), []
            beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 255, 190))
            station.socket.sendto(beat, station._address)
            station.press(HIGH, (1, 191))
            await come(lambda: watching.lasting)

            def answered():
                try:
                    while True:
                        for one in parser.parse_buffer(station.socket.recv(4096)) or ():
                            if one.get_type() == "COMMAND_ACK" and one.command == mavlink.MAV_CMD_DO_AUX_FUNCTION:
                                answers.append((one.target_system, one.result))
                except BlockingIOError:
                    return bool(answers)

            await come(answered)
            station.press(LOW, (1, 191))
            await come(lambda: answered() and len(answers) >= 2)
            assert answers == [(255, mavlink.MAV_RESULT_ACCEPTED)] * 2

    asyncio.run(pressed())


def test_a_connection_that_mavsdk_never_completes_is_tried_again(vehicle_of, tmp_path, monkeypatch):  # noqa: F811
    asked, first_autopilot = [], Mavsdk.first_autopilot

    async def silent_at_first(instance, timeout_s):
        asked.append(timeout_s)
        return await (asyncio.Event().wait() if len(asked) == 1 else first_autopilot(instance, timeout_s))

    async def served():
        monkeypatch.setattr(Mavsdk, "first_autopilot", silent_at_first)
        async with serving(vehicle_of("px4", speed=2.0), tmp_path, monkeypatch, heartbeat_timeout_s=1.0):
            assert len(asked) == 2

    asyncio.run(served())


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_what_is_requested_at_any_time_is_what_is_done(vehicle_of, tmp_path, monkeypatch, flavour):  # noqa: F811
    async def pressed():
        vehicle = vehicle_of(flavour, speed=2.0)
        async with serving(vehicle, tmp_path, monkeypatch, aux_function=FUNCTION) as (resident, watching, station):
            taken, request = [], resident.request
            monkeypatch.setattr(resident, "request", lambda *given: taken.append(given) or request(*given))
            for steps in range(6):
                for apart_s in (0.0, 0.1 * steps, 0.9 * steps):
                    await come(lambda: resident.status.state in (State.READY, State.FAULT))
                    taken.clear()
                    station.press(HIGH)
                    await asyncio.sleep(apart_s)
                    station.press(LOW)
                    await come(lambda: len(taken) == 2)
                    await come(lambda: resident._display is None and not resident._wanted)
                    assert watching.lasting == 0
            begun = watching.begun
            station.press(HIGH)
            await come(lambda: watching.begun == begun + 1)
            station.press(LOW)
            station.press(HIGH)  # while the watch before is ended
            await come(lambda: watching.begun == begun + 2)
            assert watching.lasting == 1

    asyncio.run(pressed())


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_the_switch_and_the_flight_mode_arrive(vehicle_of, tmp_path, monkeypatch, flavour):  # noqa: F811
    async def pressed():
        vehicle = vehicle_of(flavour, speed=4.0)
        transmitter = Transmitter(vehicle)
        mode, name, by_pilot = (12, "LOITER", 5) if flavour == "arduplane" else (0x00020000, "ALTCTL", 0x00030000)
        control = {"rc_channel": 9, "flight_mode": name}
        async with serving(vehicle, tmp_path, monkeypatch, **control) as (resident, watching, _):
            switch = resident._triggers._rc
            for begun in (1, 2):
                transmitter.move(1000)
                await come(lambda: switch.up is False and switch.healthy_ms is not None)
                transmitter.move(2000)
                await come(lambda begun=begun: watching.begun == begun and watching.lasting)
                transmitter.move(1000)
                await come(lambda: not watching.lasting and resident.status.state is State.FAULT)
            transmitter.move(2000, receives=False)  # what a receiver presets at the loss of its transmitter
            await come(lambda: switch.healthy_ms is None)
            for custom_mode in (by_pilot, mode):
                before = resident._triggers._mode
                vehicle.do(lambda custom_mode=custom_mode: vehicle.autopilot.set_mode(custom_mode))
                await come(lambda before=before: resident._triggers._mode != before)
            await asyncio.sleep(0)
            assert watching.begun == 2  # nor a mode while the receiver has no signal
            transmitter.move(1000)
            await come(lambda: switch.up is False)
            vehicle.do(lambda: vehicle.autopilot.set_mode(by_pilot))
            await come(lambda: resident._triggers._chosen is None and resident._triggers._mode != name)
            vehicle.do(lambda: vehicle.autopilot.set_mode(mode))
            await come(lambda: watching.begun == 3)

    asyncio.run(pressed())
