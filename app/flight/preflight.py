"""What has to be right before anything is armed, each point with what was found and what to do.

It includes how often the sources of the target report, and which of them the estimators use.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sidelong.app.assembly import tracker_settings
from sidelong.app.autopilots.autopilot import Autopilot, Limits, ParameterTable, Purpose, Release, RequiredParameter
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_mav_autopilot, check_guidance
from sidelong.app.config import Config, SharingSection
from sidelong.app.errors import InputError
from sidelong.app.flight.outputs import open_beacon
from sidelong.app.link import telemetry
from sidelong.app.link.message import Message, plain
from sidelong.app.link.vehicle import REMOTE_ID_STATUS, Vehicle, is_flying, mode_of
from sidelong.app.terrain.elevation_data import elevation_data
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing import readings
from sidelong.estimators.tracking.sources import Rank, SourceSelector, range_rank, sight_rank
from sidelong.mission.core.requirement import Aircraft
from sidelong.mission.exchange.dialect import Home

_ANYWHERE = LocalPlane(0.0, 0.0)  # before the flight has one, a beacon is only counted


@dataclass(frozen=True, slots=True)
class SourceRate:
    kind: str  # range, gimbal or target
    source: readings.Source  # who sends
    rate_hz: float  # messages per second of the vehicle's clock
    fault: str = ""  # why none of them holds a reading, '' if they do

    def __str__(self) -> str:
        source, sender = self.source, "a beacon"
        if source.message not in readings.BEACON_MESSAGES:
            sender = f"component {source.component_id} id {source.sensor_id}"
            sender += f" orientation {source.orientation}" if self.kind == "range" else ""
        spoken = f"{source.message} of {sender} at {self.rate_hz:.1f} Hz"
        return f"{spoken}, but {self.fault}" if self.fault else spoken


class SourceRates:
    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        vehicle.listeners.append(self._count)
        self.begin()

    def begin(self) -> None:
        """Count from here on."""
        self._telemetry = telemetry.Telemetry(self._vehicle.system_id)
        self._counts: Counter[tuple[str, readings.Source]] = Counter()
        self._begun_s = math.inf  # of this computer's clock
        self._first_s = math.inf  # of the vehicle's

    def close(self) -> None:
        self._vehicle.listeners.remove(self._count)

    async def received(self, wall_s: float, sharing: SharingSection) -> tuple[SourceRate, ...]:
        """Return the rates, on the vehicle's clock, after listening for ``wall_s`` in total; then restart the count.

        Raises InputError if the beacon's address is in use or not local.
        """
        contacts: list[Callable[[Message], object]] = []
        beacon = await open_beacon(
            sharing, _ANYWHERE, lambda: self._telemetry.now_s, self._count_fix, listeners=contacts
        )
        self._vehicle.listeners += contacts
        listened_s = time.time() - self._begun_s if beacon is None else 0.0
        try:
            await asyncio.sleep(wall_s - min(max(listened_s, 0.0), wall_s))
        finally:
            for contact in contacts:
                self._vehicle.listeners.remove(contact)
            if beacon is not None:
                beacon.stop()
                await asyncio.sleep(0)  # its port is free again once the loop has turned
        # A simulation may run faster than the clock on the wall.
        by_vehicle_s, by_wall_s = self._telemetry.now_s - self._first_s, time.time() - self._begun_s
        duration_s = next((s for s in (by_vehicle_s, by_wall_s) if 0.0 < s < math.inf), wall_s)
        counts = {(*received, ""): number for received, number in self._counts.items()}
        counts |= {key: number for key, number in self._telemetry.unusable.items() if key[:2] not in self._counts}
        rates = tuple(
            SourceRate(kind, source, number / duration_s, fault)
            for (kind, source, fault), number in sorted(counts.items(), key=lambda item: (item[0][0], -item[1]))
        )
        self.begin()
        return rates

    def _count(self, message: Message) -> None:
        event = self._telemetry.event(message)
        self._begun_s = min(self._begun_s, message.received_s)
        if self._first_s == math.inf and self._telemetry.now_s > -math.inf:
            self._first_s = self._telemetry.now_s
        if isinstance(event, readings.RangeReading):
            self._counts["range", event.source] += 1
        elif isinstance(event, readings.GimbalReading):
            self._counts["gimbal", event.source] += 1
        elif isinstance(event, readings.TargetFixReading):
            self._count_fix(event)

    def _count_fix(self, reading: readings.TargetFixReading) -> None:
        self._counts["target", reading.source] += 1


def why_unused(config: Config, kind: str, source: readings.Source) -> str:
    """Return why a source of a kind (range, gimbal, target) is never used, and what would use it; '' if it may be."""
    if kind == "target":
        return ""
    settings = tracker_settings(config.sensors, config.planner.lost_after_s)
    rank, choice = (range_rank, settings.range_source) if kind == "range" else (sight_rank, settings.gimbal_source)
    return SourceSelector(rank, choice).why_never(source, f"sensors.{kind}_component")


def describe_use(config: Config, kind: str, received: Sequence[readings.Source]) -> dict[readings.Source, str]:
    """Return what becomes of each source of a kind: range, gimbal, or target (a camera's own tracker)."""
    settings, key = tracker_settings(config.sensors, config.planner.lost_after_s), f"sensors.{kind}_component"
    choice = settings.range_source if kind == "range" else settings.gimbal_source
    rank: Rank = range_rank if kind == "range" else sight_rank
    ranks = {source: own for source in received if kind != "target" and (own := rank(source)) is not None}
    best = min(ranks.values(), default=None)
    first = [source for source, own in ranks.items() if own == best]

    def use(source: readings.Source) -> str:
        if kind == "target":
            own = source.message in readings.BEACON_MESSAGES
            return "used: the target's own" if own else "used while no laser is received"
        if why := why_unused(config, kind, source):
            return f"not used: {why}"
        if choice is not None:
            return f"used: {key} names it"
        if source in first:
            if len(first) > 1:
                return f"used if it is received first; select one with {key}"
            return "used: " + ("the only one" if len(ranks) == 1 else "the payload's own, before what repeats it")
        repeats = source.component_id == telemetry.AUTOPILOT_COMPONENT
        why = "the autopilot only repeats it" if repeats else "it is not fixed to a gimbal"
        return f"stands by for when the other falls silent: {why}"

    return {source: use(source) for source in received}


_VTOL_TYPES = frozenset({19, 20, 21, 22, 23, 24, 25})  # MAV_TYPE_VTOL_*
_MIN_RATE_HZ = 0.5
_HOME_OFF_MAX_M = 60.0  # geoid models differ by a metre, a GPS height by some, terrain data by twenty
_TERRAIN_OFF_MAX_M = 40.0  # other posts, other sources
_REMOTE_ID_GOOD, _REMOTE_ID_SILENT_S = 0, 10.0
_NAMED = (Purpose.GROUND_STATION, Purpose.MISSION_ITEMS)
_SENSORS = {
    0x1: "gyroscope",
    0x2: "accelerometer",
    0x4: "compass",
    0x8: "barometer",
    0x20: "GPS",
    0x200000: "attitude and position",
}


@dataclass(frozen=True, slots=True)
class Check:
    """One requirement: ready or not, what was found, and the way out when it is not."""

    name: str
    ready: bool
    found: str
    remedy: str = ""
    before_take_off: bool = False  # an aircraft that flies already is taken over without it
    lasts: bool = False  # waiting does not change it: parameters are read once

    @property
    def words(self) -> str:
        """What was found, with the remedy if it is not ready."""
        return self.found + (f"; {self.remedy}" if self.remedy and not self.ready else "")

    def __str__(self) -> str:
        return f"{self.name}: {self.words}"


def check_takeover(vehicle: Vehicle, allowed: Sequence[str]) -> None:
    """Raise InputError if a flying aircraft would be silently taken out of a return, a landing or a failsafe.

    allowed: modes out of which the operator allows a takeover; ``failsafe`` stands for all failsafes.
    """
    if not is_flying(vehicle):
        return
    mode, state = mode_of(vehicle), int(vehicle.latest["HEARTBEAT"].fields["system_status"])
    reasons = [mode] if mode in telemetry.RECOVERY_MODES else []
    if state in telemetry.FAILSAFE_STATES:
        reasons.append(telemetry.FAILSAFE)
    refused = [reason for reason in reasons if reason.upper() not in set(map(str.upper, allowed))]
    if refused:
        named = ", ".join(f'"{reason}"' for reason in refused)
        raise InputError(
            f"the aircraft flies in {' and '.join(refused)}, which the pilot or the autopilot has chosen; "
            f"change the flight mode, or take it over by --set 'link.take_over_from=[{named}]'."
        )


def autopilot_of(vehicle: Vehicle) -> Autopilot:
    """Return the module for the vehicle's autopilot. Raises InputError if it is unknown or not a fixed wing."""
    heartbeat = vehicle.latest["HEARTBEAT"].fields
    kind = int(heartbeat["type"])
    if kind != telemetry.TYPE_FIXED_WING:
        what = "a VTOL" if kind in _VTOL_TYPES else f"of MAV_TYPE {kind}"
        raise InputError(f"system {vehicle.system_id} is {what}, no fixed wing; connect to a fixed-wing vehicle.")
    autopilot = autopilot_by_mav_autopilot(int(heartbeat["autopilot"]))
    if autopilot is None:
        raise InputError(
            f"system {vehicle.system_id} runs an autopilot of MAV_AUTOPILOT {heartbeat['autopilot']}; "
            f"{' and '.join(known.name for known in AUTOPILOTS)} are supported."
        )
    return autopilot


def check_release(autopilot: Autopilot, release: Release | None) -> str | None:
    """Return a remark on a release that sidelong does not know. Raises InputError if it is older than supported."""
    name, supported = autopilot.name, autopilot.releases
    oldest, newest = supported.oldest.series, supported.newest.series
    if release is None:
        return f"{name} did not report its release; sidelong knows {oldest} to {newest}"
    if release < supported.oldest:
        raise InputError(
            f"{name} {release} is not supported: it lacks {supported.older_lack}; update it to {oldest} or later."
        )
    if Release(release.major, release.minor) > supported.newest:
        return f"{name} {release} is newer than {newest}, the newest that sidelong knows; test it first"
    return None


def checks(
    config: Config,
    vehicle: Vehicle,
    autopilot: Autopilot,
    parameters: ParameterTable,
    home: Home | None,
    rates: tuple[SourceRate, ...],
    required_parameters: tuple[RequiredParameter, ...] = (),
) -> tuple[Check, ...]:
    """Return every requirement with whether it is met; ``required_parameters`` are those that are not set yet."""
    aircraft = config.aircraft.aircraft()
    return (
        _health_check(vehicle),
        _position_check(vehicle),
        _guidance_check(config, autopilot),
        Check("home", home is not None, "known" if home else "not known", "wait for the GPS fix that sets it"),
        _ground_check(config, home),
        *_terrain_checks(config, vehicle),
        *_limit_checks(config, aircraft, autopilot.limits(parameters.values), parameters),
        *(Check(purpose, True, parameters.found_for(purpose)) for purpose in _NAMED),
        *_link_failsafe_checks(vehicle, autopilot, parameters),
        *_remote_id_checks(vehicle),
        *map(_parameter_check, required_parameters),
        *_camera_checks(vehicle),
        *_source_checks(config, vehicle, rates),
    )


def _parameter_check(need: RequiredParameter) -> Check:
    remedy = f"set {need.value:g}, or give --set link.set_parameters=true"
    return Check(need.name, False, f"{need.present:g}: {need.why}", remedy, lasts=True)


def _health_check(vehicle: Vehicle) -> Check:
    message = vehicle.latest.get("SYS_STATUS")
    if message is None:
        return Check("health", True, "not reported")
    fields = message.fields
    used = int(fields["onboard_control_sensors_present"]) & int(fields["onboard_control_sensors_enabled"])
    ill = [name for bit, name in _SENSORS.items() if used & ~int(fields["onboard_control_sensors_health"]) & bit]
    return Check("health", not ill, f"unhealthy: {', '.join(ill)}" if ill else "good", "wait, or see what is wrong")


def _link_failsafe_checks(vehicle: Vehicle, autopilot: Autopilot, parameters: ParameterTable) -> tuple[Check, ...]:
    """Report a failsafe of the data link that our own heartbeats keep from beginning."""
    failsafe = "" if vehicle.is_companion else autopilot.renewed_failsafe(parameters.values, vehicle.own_id[0])
    found = f"{failsafe} does not begin while sidelong is connected as a ground station; link.role = companion"
    return (Check("link failsafe", True, found),) if failsafe else ()


def _remote_id_checks(vehicle: Vehicle) -> tuple[Check, ...]:
    """Require that a Remote ID module, where there is one, allows arming."""
    message, heartbeat = vehicle.latest.get(REMOTE_ID_STATUS), vehicle.latest.get("HEARTBEAT")
    if message is None:
        return ()
    error = plain(str(message.fields["error"])) or "it gives no reason"
    found = "ready" if int(message.fields["status"]) == _REMOTE_ID_GOOD else f"does not allow arming: {error}"
    if heartbeat is not None and heartbeat.received_s - message.received_s > _REMOTE_ID_SILENT_S:
        found = "its module is silent"
    return (Check("Remote ID", found == "ready", found, "set the operator, or see the module", before_take_off=True),)


def _guidance_check(config: Config, autopilot: Autopilot) -> Check:
    try:
        check_guidance(autopilot, config.planner.guidance)
    except InputError as refusal:
        return Check("planner.guidance", False, f"{refusal}".rstrip("."), lasts=True)
    return Check("planner.guidance", True, config.planner.guidance)


def _position_check(vehicle: Vehicle) -> Check:
    message = vehicle.latest.get("GLOBAL_POSITION_INT")
    if message is None or not telemetry.has_fix(message.fields):
        return Check("position", False, "none", "wait for the GPS fix")
    fields = message.fields
    found = (
        f"{fields['lat'] * 1e-7:.6f}, {fields['lon'] * 1e-7:.6f}, {fields['relative_alt'] * 1e-3:.0f} m above home"
    )
    return Check("position", True, found)


def _ground_check(config: Config, home: Home | None) -> Check:
    """Compare the elevation data with the autopilot's own height of home: a wrong home or datum shows there."""
    if config.terrain.folder is None:
        return Check("ground", True, "no elevation data: taken as flat, at the height of home")
    if home is None:
        return Check("ground", False, "home is not known", "wait for the GPS fix that sets it")
    reported_m = elevation_data(Path(config.terrain.folder)).height_above_sea_m(home.latitude_deg, home.longitude_deg)
    if math.isnan(reported_m):
        return Check("ground", False, "the elevation data is void at home", "add tiles whose voids are filled")
    found = f"{reported_m:.0f} m above sea at home by the elevation data, {home.altitude_m:.0f} m by the autopilot"
    remedy = "see which of the two is wrong: home, or the tiles"
    return Check("ground", abs(reported_m - home.altitude_m) <= _HOME_OFF_MAX_M, found, remedy)


def _terrain_checks(config: Config, vehicle: Vehicle) -> tuple[Check, ...]:
    """Compare the elevation data with what the autopilot's own terrain database has below it, where it has any."""
    message = vehicle.latest.get("TERRAIN_REPORT")
    if config.terrain.folder is None or message is None or not message.fields["spacing"]:
        return ()
    fields = message.fields
    own_m = elevation_data(Path(config.terrain.folder)).height_above_sea_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
    if math.isnan(own_m):
        return ()  # reported by the home check, or outside the data: each plan checks the ground below it
    reported_m = fields["terrain_height"]
    found = f"{own_m:.0f} m above sea below the aircraft, {reported_m:.0f} m by the autopilot's own data"
    remedy = "see which of the two is wrong: the tiles, or the autopilot's terrain data (on its card)"
    return (Check("terrain data", abs(own_m - reported_m) <= _TERRAIN_OFF_MAX_M, found, remedy),)


def _limit_checks(
    config: Config, aircraft: Aircraft, limits: Limits, parameters: ParameterTable
) -> tuple[Check, ...]:
    bank_deg = limits.bank_max_deg
    found = parameters.found_for(Purpose.BANK_LIMIT) if bank_deg is None else f"{bank_deg:g} degrees"
    bank_ok = bank_deg is None or bank_deg >= config.aircraft.bank_max_deg - 0.5
    remedy = f"set aircraft.bank_max_deg to at most {found} or raise the autopilot's limit"
    bank = Check("bank limit", bank_ok, found, remedy, lasts=True)
    least, most = limits.airspeed_min_m_s, limits.airspeed_max_m_s
    speed_ok = (least is None or aircraft.airspeed_m_s >= least) and (most is None or aircraft.airspeed_m_s <= most)
    found = f"{aircraft.airspeed_m_s:g} m/s wanted, {_number(least)} to {_number(most)} m/s allowed"
    if None in (least, most, limits.airspeed_cruise_m_s):
        found = parameters.found_for(Purpose.AIRSPEED)
    remedy = "set aircraft.airspeed_m_s within the autopilot's limits"
    return bank, Check("airspeed", speed_ok, found, remedy, lasts=True)


def _camera_checks(vehicle: Vehicle) -> tuple[Check, ...]:
    if readings.IMAGE_TRACKER not in vehicle.latest:
        return ()
    known = [name for name in ("CAMERA_FOV_STATUS", "CAMERA_INFORMATION") if name in vehicle.latest]
    remedy = "let the camera send CAMERA_FOV_STATUS: without it the target's place in the image is not used"
    return (Check("field of view", bool(known), ", ".join(known) or "none received", remedy, True),)


def _source_checks(config: Config, vehicle: Vehicle, rates: tuple[SourceRate, ...]) -> tuple[Check, ...]:
    received = {kind: [rate for rate in rates if rate.kind == kind] for kind in ("range", "gimbal", "target")}
    usable = {kind: [rate for rate in of_kind if _is_usable(config, rate)] for kind, of_kind in received.items()}
    paired = bool(usable["range"] and usable["gimbal"])
    if received["target"] and not paired:
        return (Check("target source", True, "; ".join(map(str, received["target"]))),)
    if config.sharing.beacon is not None and not paired:
        remedy = (
            f"let the beacon send to {config.sharing.beacon} (sharing.beacon_name names it), or start the payload"
        )
        return (Check("target source", False, "neither a beacon nor a laser with a gimbal", remedy, True),)
    if vehicle.only_mavlink_1 and not received["gimbal"]:
        remedy = "switch its port to MAVLink 2 (SERIALn_PROTOCOL = 2 of ArduPilot, MAV_PROTO_VER = 2 of PX4)"
        found = "none received: the link has MAVLink 1 only, which cannot carry GIMBAL_DEVICE_ATTITUDE_STATUS"
        gimbal = Check("gimbal source", False, found, remedy, True)
    else:
        remedy = "send GIMBAL_DEVICE_ATTITUDE_STATUS from the gimbal"
        gimbal = _rate_check(config, "gimbal", received["gimbal"], remedy)
    if config.terrain.is_known and config.sensors.angles_alone and not usable["range"]:
        return Check("range source", True, "none: the line of sight is cut with the ground"), gimbal
    remedy = "send DISTANCE_SENSOR or RANGEFINDER from the laser"
    if any(rate.fault for rate in received["range"]):
        remedy = "let the laser look at something within its reach"
    return _rate_check(config, "range", received["range"], remedy), gimbal


def _is_usable(config: Config, rate: SourceRate) -> bool:
    return rate.rate_hz >= _MIN_RATE_HZ and not rate.fault and not why_unused(config, rate.kind, rate.source)


def _rate_check(config: Config, kind: str, rates: list[SourceRate], remedy: str) -> Check:
    usable = [str(rate) for rate in rates if _is_usable(config, rate)]
    others = [
        f"{rate}, not used: {why}" if (why := why_unused(config, kind, rate.source)) else f"received: {rate}"
        for rate in rates
    ]
    return Check(f"{kind} source", bool(usable), "; ".join(usable or others) or "none received", remedy, True)


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:g}"
