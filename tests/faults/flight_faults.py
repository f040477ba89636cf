"""What goes wrong between a vehicle and us, drawn from a seed: each fault for a while of a flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sidelong.app.link.message import Message

Arriving = Iterator[tuple[float, Message]]
Change = Callable[[Message, float, np.random.Generator], Arriving]
"""What becomes of a message this long after the fault began: copies, each with its delay."""

EXPECTED_YIELDS = {"reboot": "has restarted", "second vehicle": "two vehicles", "pilot": "flight mode"}
BLINDING = frozenset({"silence", "gps lost", "vehicle clock", "position silent", "heartbeat gone"})
"""Faults that leave nothing to decide on."""
MISLEADING = frozenset({"stuck laser", "wrong flags", "wrong unit", "frozen gimbal", "second gimbal", "second laser"})
"""Faults by which the payload reports another target than the actual one."""
VEHICLE = ("GLOBAL_POSITION_INT", "ATTITUDE")
PAYLOAD = ("DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS")
_STATUS = ("GPS_RAW_INT", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
_M_PER_E7 = 0.0111319


@dataclass(frozen=True, slots=True)
class Fault:
    name: str
    begin_s: float
    end_s: float
    change: Change
    what: str = ""


def with_fields(message: Message, **fields: object) -> Message:
    return message._replace(fields=message.fields | fields)


def later(message: Message, seconds: float) -> Message:
    """Return the message with another stamp, as 32 bits of milliseconds hold it."""
    stamp_ms = (message.fields["time_boot_ms"] + round(seconds * 1000.0)) % 2**32
    return with_fields(message, time_boot_ms=stamp_ms)


def moved(message: Message, east_m: float, north_m: float) -> Message:
    fields = message.fields
    lon = round(fields["lon"] + east_m / _M_PER_E7 / math.cos(math.radians(fields["lat"] * 1e-7)))
    return with_fields(message, lat=round(fields["lat"] + north_m / _M_PER_E7), lon=lon)


def only(names: tuple[str, ...], by: Callable[[Message, float, np.random.Generator], Message | None]) -> Change:
    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        one = by(message, since_s, rng) if message.name in names else message
        if one is not None:
            yield 0.0, one

    return change


def _way(rng: np.random.Generator) -> tuple[float, float]:
    course_rad = rng.uniform(-math.pi, math.pi)
    return math.sin(course_rad), math.cos(course_rad)


def _hours(rng: np.random.Generator) -> float:
    """Return anything from a second to an hour, either way, each order of magnitude alike."""
    return float(rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(0.0, math.log10(3600.0)))


def gps_jump(rng: np.random.Generator, begin_s: float) -> Fault:
    jump_m, (east, north) = 10.0 ** rng.uniform(2.0, 4.0), _way(rng)
    length_s = float(rng.uniform(1.0, 10.0))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        return moved(message, jump_m * east, jump_m * north)

    what = f"{jump_m:.0f} m for {length_s:.1f} s"
    return Fault("gps jump", begin_s, begin_s + length_s, only(("GLOBAL_POSITION_INT",), change), what)


def gps_lost(rng: np.random.Generator, begin_s: float) -> Fault:
    length_s, (east, north) = float(rng.uniform(5.0, 20.0)), _way(rng)

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        if message.name == "GPS_RAW_INT":
            return with_fields(message, fix_type=1)
        if message.name in _STATUS:
            return with_fields(message, flags=167)
        return moved(message, 6.0 * since_s * east, 6.0 * since_s * north)

    names = ("GLOBAL_POSITION_INT", *_STATUS)
    return Fault("gps lost", begin_s, begin_s + length_s, only(names, change), f"for {length_s:.1f} s")


def payload_clock(rng: np.random.Generator, begin_s: float) -> Fault:
    off_s = _hours(rng)
    names = PAYLOAD if rng.random() < 0.6 else (str(rng.choice(PAYLOAD)),)
    change = only(names, lambda message, _since_s, _rng: later(message, off_s))
    return Fault("payload clock", begin_s, math.inf, change, f"{off_s:+.1f} s of {', '.join(names)}")


def payload_stamps(rng: np.random.Generator, begin_s: float) -> Fault:
    share = rng.uniform(0.01, 0.3)

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        if rng.random() >= share:
            return message
        return with_fields(message, time_boot_ms=int(rng.integers(0, 2**32)))

    return Fault("payload stamps", begin_s, math.inf, only(PAYLOAD, change), f"{share:.0%} at random")


def payload_drift(rng: np.random.Generator, begin_s: float) -> Fault:
    """Let the payload's clock go wrong by up to a hundredth."""
    drift = rng.uniform(-0.01, 0.01)

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        return later(message, drift * since_s)

    return Fault("payload drift", begin_s, math.inf, only(PAYLOAD, change), f"{drift:+.2%}")


_EXTREMES = {
    "time_boot_ms": (0, 2**32 - 1),
    "current_distance": (0, 65_535),
    "min_distance": (0, 65_535),
    "max_distance": (0, 65_535),
    "covariance": (0, 255),
    "signal_quality": (0, 1, 100, 255),
    "orientation": (0, 255),
    "id": (0, 255),
    "type": (0, 255),
    "quaternion": ([math.nan] * 4, [3.4e38] * 4, [0.0] * 4, [None] * 4),
    "q": ([math.nan] * 4, [3.4e38] * 4, [0.0] * 4, [None] * 4),
    "angular_velocity_x": (None, 3.4e38, -3.4e38),
    "flags": (0, 65_535),
    "failure_flags": (2**32 - 1,),
    "delta_yaw": (None, 3.4e38),
    "gimbal_device_id": (0, 255),
}


def payload_extremes(rng: np.random.Generator, begin_s: float) -> Fault:
    """Set each field of the payload's messages to an end of its range, one a message."""
    share = rng.uniform(0.01, 0.3)

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        names = [name for name in message.fields if name in _EXTREMES]
        if rng.random() >= share:
            return message
        name = names[rng.integers(len(names))]
        return with_fields(message, **{name: _EXTREMES[name][rng.integers(len(_EXTREMES[name]))]})

    return Fault("payload extremes", begin_s, math.inf, only(PAYLOAD, change), f"{share:.0%} of them")


def payload_restart(rng: np.random.Generator, begin_s: float) -> Fault:
    silent_s = float(rng.uniform(2.0, 8.0))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message | None:
        return with_fields(message, time_boot_ms=round(since_s * 1000.0)) if since_s > silent_s else None

    return Fault("payload restart", begin_s, math.inf, only(PAYLOAD, change))


def vehicle_clock(rng: np.random.Generator, begin_s: float) -> Fault:
    off_s = _hours(rng) + float(rng.choice((-6.0, 6.0)))
    length_s = 0.1 if rng.random() < 0.4 else float(rng.uniform(0.5, 10.0))
    change = only(VEHICLE, lambda message, _since_s, _rng: later(message, off_s))
    return Fault("vehicle clock", begin_s, begin_s + length_s, change, f"{off_s:+.1f} s for {length_s:.1f} s")


def nonsense(rng: np.random.Generator, begin_s: float) -> Fault:
    """Break fields of any message, each now and then."""
    share = rng.uniform(0.005, 0.05)
    numbers = (math.nan, None, math.inf, -math.inf, 1e30, -1e30, 0.0)
    integers = (0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 65_535)
    kept = ("autopilot", "type", "base_mode", "custom_mode", "id", "orientation", "flags", "gimbal_device_id")

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        if rng.random() >= share:
            yield 0.0, message
            return
        name = str(rng.choice([name for name in message.fields if name not in kept] or ["-"]))
        value = message.fields.get(name)
        if isinstance(value, list):
            value = [numbers[rng.integers(len(numbers))], *value[1:]]
        elif isinstance(value, float):
            value = numbers[rng.integers(len(numbers))]
        elif isinstance(value, int):
            value = integers[rng.integers(len(integers))]
        yield 0.0, with_fields(message, **{name: value}) if name in message.fields else message

    return Fault("nonsense", begin_s, math.inf, change, f"{share:.1%} of the messages")


def strangers(rng: np.random.Generator, begin_s: float) -> Fault:
    """Let other components and systems say anything not theirs to say."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        yield 0.0, message
        if rng.random() >= 0.05:
            return
        component, system = int(rng.integers(2, 250)), int(rng.choice((1, 2, 7, 255)))
        if message.name == "GLOBAL_POSITION_INT":
            yield 0.0, moved(message, 900.0, 0.0)._replace(component_id=component)
            yield 0.0, later(moved(message, 0.0, 5000.0), 500.0)._replace(system_id=2)
            fix = {"tracking_status": 1, "lat": message.fields["lat"] + 400_000, "lon": message.fields["lon"]}
            stranger = 1 if rng.random() < 0.5 else 99
            yield 0.0, Message("CAMERA_TRACKING_GEO_STATUS", 1, stranger, fix | {"h_acc": 1.0}, 0.0)
        elif message.name == "HEARTBEAT":
            yield 0.0, with_fields(message, custom_mode=5)._replace(component_id=component)
            yield 0.0, with_fields(message, custom_mode=5)._replace(system_id=2)
        else:
            yield 0.0, message._replace(system_id=7 if system == 1 else system)
        wind = {"direction": 90.0, "speed": 14.0, "speed_z": 0.0}
        yield 0.0, Message("WIND", 1, component, wind, 0.0)
        yield 0.0, Message("WIND", 1, 1, wind | {"speed": 300.0}, 0.0)

    return Fault("strangers", begin_s, math.inf, change)


def poor_link(rng: np.random.Generator, begin_s: float) -> Fault:
    loss, double, delay_s, jitter_s = (float(rng.uniform(0.0, most)) for most in (0.3, 0.2, 1.2, 0.6))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        for _ in range(1 + (rng.random() < double)):
            if rng.random() >= loss:
                yield delay_s + jitter_s * rng.random(), message

    what = f"loss {loss:.0%}, doubled {double:.0%}, delay {delay_s:.1f} to {delay_s + jitter_s:.1f} s"
    return Fault("poor link", begin_s, math.inf, change, what)


def silence(rng: np.random.Generator, begin_s: float) -> Fault:
    length_s = float(rng.uniform(2.5, 30.0))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        yield from ()

    return Fault("silence", begin_s, begin_s + length_s, change, f"{length_s:.0f} s")


def reboot(rng: np.random.Generator, begin_s: float) -> Fault:
    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        if since_s > 2.0 or message.name in PAYLOAD:
            stamped = message.name in VEHICLE
            yield 0.0, with_fields(message, time_boot_ms=round((since_s - 1.5) * 1000.0)) if stamped else message

    return Fault("reboot", begin_s, math.inf, change)


def second_vehicle(rng: np.random.Generator, begin_s: float) -> Fault:
    off_s, far_m, (east, north) = _hours(rng) * 0.5, float(rng.uniform(100.0, 5000.0)), _way(rng)
    off_s += math.copysign(10.0, off_s)
    behind_s = float(rng.uniform(0.0, 0.09))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        yield 0.0, message
        if message.name in VEHICLE:
            other = later(message, off_s)
            yield behind_s, moved(other, far_m * east, far_m * north) if "lat" in other.fields else other

    return Fault("second vehicle", begin_s, math.inf, change, f"{off_s:+.0f} s, {far_m:.0f} m")


LASER, GIMBAL = ("DISTANCE_SENSOR",), ("GIMBAL_DEVICE_ATTITUDE_STATUS",)
_OTHER = 171  # the component of a second device


def repeated(names: tuple[str, ...], field: str, noise: int = 0) -> Change:
    """Repeat the first value of a field, with noise of this many units."""
    first: dict[str, object] = {}

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        value = first.setdefault(message.name, message.fields[field])
        return with_fields(message, **{field: value + int(rng.integers(-noise, noise + 1)) if noise else value})

    return only(names, change)


def scaled(factor: float, more_m: float = 0.0) -> Change:
    """Multiply the laser's range, and add to it."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        distance_cm = message.fields["current_distance"] * factor + 100.0 * more_m
        return with_fields(message, current_distance=max(round(distance_cm), 0))

    return only(LASER, change)


def turned(degrees: float) -> Change:
    """Turn the gimbal's orientation about the vertical, to the right."""
    return turning(math.inf, degrees)


def turning(degrees_s: float, until_degrees: float) -> Change:
    """Turn the gimbal's orientation about the vertical, at this rate to the right up to this angle."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        angle_rad = math.radians(_ramp(degrees_s, until_degrees, since_s))
        cos, sin = math.cos(angle_rad / 2.0), math.sin(angle_rad / 2.0)
        w, x, y, z = message.fields["q"]
        return with_fields(message, q=[cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w])

    return only(GIMBAL, change)


def _ramp(rate_s: float, until: float, since_s: float) -> float:
    return math.copysign(min(abs(rate_s) * since_s, abs(until)), until) if since_s > 0.0 else 0.0


def pitching(degrees_s: float, until_degrees: float) -> Change:
    """Raise the gimbal's orientation at this rate up to this angle."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        angle_rad = math.radians(_ramp(degrees_s, until_degrees, since_s))
        cos, sin = math.cos(angle_rad / 2.0), math.sin(angle_rad / 2.0)
        w, x, y, z = message.fields["q"]
        return with_fields(message, q=[cos * w - sin * y, cos * x - sin * z, cos * y + sin * w, cos * z + sin * x])

    return only(GIMBAL, change)


def lengthening(m_s: float, until_m: float) -> Change:
    """Add an error to the laser's range that grows at this rate up to this length."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        distance_cm = message.fields["current_distance"] + 100.0 * _ramp(m_s, until_m, since_s)
        return with_fields(message, current_distance=max(round(distance_cm), 0))

    return only(LASER, change)


def rising(m_s: float, until_m: float) -> Change:
    """Let the barometric height drift at this rate up to this difference."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        off_mm = round(1000.0 * _ramp(m_s, until_m, since_s))
        return with_fields(message, **{key: message.fields[key] + off_mm for key in ("alt", "relative_alt")})

    return only(VEHICLE[:1], change)


def wrong_at(centre_deg: float, width_deg: float, factor: float, of_nose: bool) -> Change:
    """Multiply ranges where the line of sight is at some bearings, counted from the nose or from north."""
    seen = {"nose": 0.0, "sight": 0.0}

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message:
        if message.name == "ATTITUDE":
            seen["nose"] = message.fields["yaw"]
        elif message.name in GIMBAL:
            w, x, y, z = message.fields["q"]
            seen["sight"] = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        else:
            off_deg = math.degrees(seen["sight"] - of_nose * seen["nose"]) - centre_deg
            if abs(math.remainder(off_deg, 360.0)) < width_deg / 2.0:
                return with_fields(message, current_distance=round(message.fields["current_distance"] * factor))
        return message

    return only(("ATTITUDE", *GIMBAL, *LASER), change)


def delayed(names: tuple[str, ...], seconds: float) -> Change:
    """Report values this much later, with the stamp of the report."""

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Arriving:
        yield (seconds, later(message, seconds)) if message.name in names else (0.0, message)

    return change


def flagged(flags: int) -> Change:
    """Replace the gimbal's flags."""
    return only(GIMBAL, lambda m, _s, _r: with_fields(m, flags=flags))


def other_device(names: tuple[str, ...], **fields: object) -> Change:
    """Silence a device, and let another one report these values."""
    return only(names, lambda m, _s, _r: with_fields(m, **fields)._replace(component_id=_OTHER))


def silent(names: tuple[str, ...]) -> Change:
    """Drop messages."""
    return only(names, lambda _m, _s, _r: None)


def stuck_laser(rng: np.random.Generator, begin_s: float) -> Fault:
    noise = int(rng.integers(0, 3))
    return Fault("stuck laser", begin_s, math.inf, repeated(LASER, "current_distance", noise), f"+-{noise} cm")


def wrong_flags(rng: np.random.Generator, begin_s: float) -> Fault:
    flags = int(rng.choice((44, 32)))
    return Fault("wrong flags", begin_s, math.inf, flagged(flags), str(flags))


def wrong_unit(rng: np.random.Generator, begin_s: float) -> Fault:
    factor = float(rng.choice((0.1, 0.3048)))
    return Fault("wrong unit", begin_s, math.inf, scaled(factor), f"times {factor}")


def frozen_gimbal(rng: np.random.Generator, begin_s: float) -> Fault:
    return Fault("frozen gimbal", begin_s, math.inf, repeated(GIMBAL, "q"))


def second_gimbal(rng: np.random.Generator, begin_s: float) -> Fault:
    yaw_rad = float(rng.uniform(-math.pi, math.pi))
    q = [math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]
    change = other_device(GIMBAL, q=q)
    return Fault("second gimbal", begin_s, math.inf, change, f"points to {math.degrees(yaw_rad):.0f} degrees")


def second_laser(rng: np.random.Generator, begin_s: float) -> Fault:
    range_m = float(rng.uniform(20.0, 600.0))
    change = other_device(LASER, current_distance=round(100.0 * range_m))
    return Fault("second laser", begin_s, math.inf, change, f"measures {range_m:.0f} m")


def position_silent(rng: np.random.Generator, begin_s: float) -> Fault:
    names = VEHICLE if rng.random() < 0.5 else VEHICLE[:1]
    length_s = float(rng.uniform(2.0, 30.0))
    what = f"{', '.join(names)} for {length_s:.0f} s"
    return Fault("position silent", begin_s, begin_s + length_s, silent(names), what)


def heartbeat_gone(rng: np.random.Generator, begin_s: float) -> Fault:
    length_s = float(rng.uniform(3.0, 40.0))
    return Fault("heartbeat gone", begin_s, begin_s + length_s, silent(("HEARTBEAT",)), f"for {length_s:.0f} s")


def slow_streams(rng: np.random.Generator, begin_s: float) -> Fault:
    """Let another station lower the rates of position and attitude."""
    every, sent = int(rng.integers(3, 21)), dict.fromkeys(VEHICLE, 0)
    length_s = float(rng.uniform(10.0, 60.0))

    def change(message: Message, since_s: float, rng: np.random.Generator) -> Message | None:
        sent[message.name] += 1
        return message if sent[message.name] % every == 0 else None

    what = f"to {10.0 / every:.1f} Hz for {length_s:.0f} s"
    return Fault("slow streams", begin_s, begin_s + length_s, only(VEHICLE, change), what)


INPUTS = (
    stuck_laser,
    wrong_flags,
    wrong_unit,
    frozen_gimbal,
    second_gimbal,
    second_laser,
    position_silent,
    heartbeat_gone,
    slow_streams,
)


HARMLESS = (
    gps_jump,
    gps_lost,
    payload_clock,
    payload_stamps,
    payload_restart,
    vehicle_clock,
    nonsense,
    strangers,
    poor_link,
    silence,
)


ALONGSIDE = (payload_drift, payload_extremes)


def yielding(ending: str | None, ending_s: float) -> list[Fault]:
    """Return the faults by which a flight ends as it is to."""
    makers = {"reboot": reboot, "second vehicle": second_vehicle}
    return [makers[ending](np.random.default_rng(round(ending_s)), ending_s)] if ending in makers else []


def drawn(seed: int, duration_s: float) -> tuple[list[Fault], tuple[str | None, float]]:
    """Return the faults of a flight, and who else is to fly from when on, in some of them."""
    rng = np.random.default_rng((seed, 5))
    number = int(rng.choice((1, 2, 3), p=(0.5, 0.3, 0.2)))
    makers = [HARMLESS[at] for at in rng.choice(len(HARMLESS), number, replace=False)]
    faults = [make(rng, float(rng.uniform(20.0, 0.6 * duration_s))) for make in makers]
    # A place that comes right after a reported fault of the GPS is taken for the end of its drift: a jump that begins
    # just then cannot be distinguished from that.
    lost = next((one for one in faults if one.name == "gps lost"), None)
    faults = [
        replace(one, begin_s=lost.begin_s + 40.0, end_s=lost.begin_s + 40.0 + one.end_s - one.begin_s)
        if lost and one.name == "gps jump" and abs(one.begin_s - lost.begin_s) < 40.0
        else one
        for one in faults
    ]
    alongside = np.random.default_rng((seed, 6))  # apart: what was drawn before stays as it was
    if alongside.random() < 0.25:
        make = ALONGSIDE[alongside.integers(len(ALONGSIDE))]
        faults.append(make(alongside, float(alongside.uniform(20.0, 0.6 * duration_s))))
    inputs = np.random.default_rng((seed, 9))
    if inputs.random() < 0.35:
        make = INPUTS[inputs.integers(len(INPUTS))]
        one = make(inputs, float(inputs.uniform(30.0, 0.6 * duration_s)))
        faults = [one] if inputs.random() < 0.5 else [*faults, one]
    if rng.random() < 0.15:
        return faults, (str(rng.choice(list(EXPECTED_YIELDS))), float(rng.uniform(0.75, 0.85)) * duration_s)
    return faults, (None, math.inf)
