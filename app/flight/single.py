"""One aircraft's flight over a connection of its own: what ``launch`` and ``serve`` both fly."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace

from sidelong.app.analysis.summary import Summary
from sidelong.app.analysis.truth import truth_if_whole
from sidelong.app.assembly import Prepared
from sidelong.app.config import Config
from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.flight.flight import Flight
from sidelong.app.flight.life import Life, describe_aircraft
from sidelong.app.flight.loop import FlightDisplay
from sidelong.app.flight.payload_input import payload_input
from sidelong.app.flight.recording import ClockRate, Recording, link_log
from sidelong.app.flight.session import Session, connected
from sidelong.app.flight.simulated import SimulatedVehicles
from sidelong.app.link.mavsdk_link import SETTLING_S
from sidelong.app.records.run_folder import RunFolder


@dataclass(frozen=True, slots=True)
class FlightEnded:
    """How a flight ended.

    Attributes:
        folder: Where its records are.
        summary: What was flown.
        reason: The error to report and to exit with, None after a regular end.
        aircraft: What the aircraft does now, as the end of a sentence.
    """

    folder: RunFolder
    summary: Summary
    reason: Exception | None
    aircraft: str = ""

    @property
    def is_internal(self) -> bool:
        """Whether the reason is a fault of this program."""
        return self.reason is not None and not isinstance(self.reason, FlightError | InputError | Interrupted)


async def fly_single(
    config: Config,
    duration_s: float | None,
    folder: RunFolder,
    recording: Recording,
    display: FlightDisplay,
    life: Life,
    note: Callable[[str], None],
    prepare: Callable[[], Prepared],
    session: Session | None = None,
) -> FlightEnded:
    """Fly to the end and return how it ended. Raises what happens before the aircraft was armed.

    Args:
        config: The configuration; without link URLs a vehicle is simulated.
        duration_s: How long to watch, of the vehicle's clock; None: until it is stopped.
        folder: The run folder.
        recording: Its records.
        display: Shows the flight, and passes the operator's requests.
        life: What ends the flight early.
        note: Receives messages, from any thread.
        prepare: Returns what the control step is made of; it may compute for seconds.
        session: The connection to the vehicle, where there is one already; ``recording`` has its frames then.
    """
    async with contextlib.AsyncExitStack() as stack:
        with life.computing():
            prepared = prepare()
        urls, truth, simulated = config.link.connections, None, None
        if not urls:
            display.note(f"starting a simulated {config.simulation.autopilot} and its target")
            simulated = SimulatedVehicles([config], [folder.truth], life.fail)
            await stack.enter_async_context(simulated)
            urls, truth = simulated.urls, folder.truth
        if session is None:
            display.note(f"connecting to {' and '.join(urls)}")
            link = config.link
            session = await stack.enter_async_context(
                connected(
                    urls,
                    link.heartbeat_timeout_s,
                    recording.frame,
                    link.signing_key_file,
                    note,
                    system_id=link.system_id if link.connections else None,
                    settling_s=SETTLING_S if link.connections else 0.0,
                )
            )
        await stack.enter_async_context(session.for_a_flight())
        display.note(f"connected to {session.autopilot.name}, system {session.vehicle.system_id}")
        recording.follow(session.vehicle.system_id)
        simulated_url = None if simulated is None else simulated.payload_url
        payload = await stack.enter_async_context(
            payload_input(config, session.vehicle, display.note, recording.frame, simulated_url)
        )
        life.watch(session.vehicle)
        flight = Flight(session, config, prepared, recording, display, duration_s, payload=payload)
        if simulated is not None:
            pace = asyncio.create_task(simulated.keep_pace(lambda: flight.come_to_s))
            stack.callback(pace.cancel)
        telemetry = session.telemetry
        clock_rate = ClockRate(lambda: telemetry.now_s)
        try:
            async with link_log(session.vehicle.link, folder.links, clock_rate, note):
                outcome, error = await flight.fly(life.stopped), None
        except Exception as raised:
            if not life.was_armed and not isinstance(raised, FlightError):
                raise
            outcome, error = f"failed: {raised}", raised
        links = tuple(report.as_json(clock_rate.mean) for report in session.vehicle.link.reports())
        aircraft = describe_aircraft(
            session.vehicle, session.autopilot, flight.controller.snapshot(), simulated=truth is not None
        )
    # Only now, with the simulated vehicle ended, is its truth file whole.
    if life.failure is not None:
        outcome = f"failed: {life.failure}"
    whole = truth_if_whole(truth, flight.controller.time_s, display.note)
    summary = replace(flight.summary(outcome, whole), links=links)
    if life.failure is not None:
        return FlightEnded(folder, summary, FlightError(life.failure))
    if life.signal_name is not None:
        return FlightEnded(folder, summary, Interrupted(f"interrupted by {life.signal_name}: {aircraft}."))
    if isinstance(error, FlightError | InputError):
        return FlightEnded(folder, summary, FlightError(f"{error} Now {aircraft}."))
    return FlightEnded(folder, summary, error, aircraft)
