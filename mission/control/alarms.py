"""Alarms for the operator, and how long the battery lasts. Source: docs/health.md#alarms."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sidelong.mission.control.present import Alarm, Phase, Present, VehicleStatus
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind

_WINDOW_S = 900.0
_LEAST_STEPS = 3
_ROUNDING = 0.5  # when N percent are first reported, the charge is N + 0.5 or, if it is cut off, N + 1
_LEAST_GROUND_SPEED_M_S = 1.0
_FASTEST_PERCENT_PER_S = 100.0 / 240.0  # the smallest aircraft with a laser and a gimbal fly for longer
_STEP_PERCENT = 3.0  # by this share a charge that is estimated from the voltage may change at once
_CONFIRMED_SHARE = 0.9  # of the highest voltage: that of a lithium cell at less than half of its charge


class Charge:
    """The battery's charge as far as it is plausible: no aircraft uses it up in less than four minutes.

    A report that falls faster is followed at that pace, or at once when the voltage has fallen by a tenth as well. It
    stays in doubt while a voltage contradicts it and it does not go on falling as a battery in use does.
    """

    def __init__(self) -> None:
        self.percent: float | None = None  # plausible, 0 to 100
        self.doubt = ""  # why the reported charge is not acted on, in words; '' if it is
        self._least = math.inf  # the charge if it was used up at the fastest pace
        self._time_s = self._most_v = 0.0
        self._good = self._doubted = (0.0, 0.0)  # time and charge of the last accepted report, and of the lowest one

    def take(self, time_s: float, percent: float, volts: float | None = None) -> None:
        """Process the reported charge, 0 to 100, at a time on the vehicle's clock no earlier than the last one."""
        self._most_v = max(self._most_v, volts or 0.0)
        confirmed = self.percent is None or (volts is not None and volts <= _CONFIRMED_SHARE * self._most_v)
        fallen = _FASTEST_PERCENT_PER_S * (time_s - self._time_s)
        self._least = percent if confirmed else max(percent, self._least - fallen)
        self._time_s = time_s
        credible = percent >= self._least - _STEP_PERCENT
        self.percent = percent if credible else self._least
        goes_on = volts is None or abs(percent - self._doubted[1]) >= _STEP_PERCENT
        if credible and (not self.doubt or confirmed or goes_on):
            self._good, self.doubt = (time_s, percent), ""
        elif not credible and (not self.doubt or percent < self._doubted[1]):
            (good_s, good), self._doubted = self._good, (time_s, percent)
            self.doubt = f"the reported charge fell from {good:.0f} to {percent:.0f} % within "
            self.doubt += f"{max(time_s - good_s, 1.0):.0f} s, faster than any aircraft uses it"
            self.doubt += "" if volts is None else f", and the battery still has {volts:.1f} V"


class Endurance:
    """Estimates the consumption from the charge that the autopilot reports in whole percent.

    The moments at which the charge falls by a percent are exact where the charge itself is not: a line through those
    of the last 15 minutes is the consumption. A charge that has not fallen for longer than the line predicts is a
    point of it, too.
    """

    def __init__(self, reserve_percent: float) -> None:
        self._reserve_percent = reserve_percent
        self.charge = Charge()
        self._steps: deque[tuple[float, float]] = deque()  # time and charge of each fall
        self._lowest = math.nan

    def take(self, time_s: float, percent: float, volts: float | None = None) -> None:
        """Process the reported charge, as :meth:`Charge.take`."""
        self.charge.take(time_s, percent, volts)
        charge = self.charge.percent
        assert charge is not None
        if not charge < self._lowest + _STEP_PERCENT:  # the first, another battery, or a correction
            self._steps.clear()
            self._lowest = charge
        elif charge <= self._lowest - 1.0:
            self._steps.append((time_s, charge + _ROUNDING))
            self._lowest = charge
        while len(self._steps) > _LEAST_STEPS and self._steps[0][0] < time_s - _WINDOW_S:
            self._steps.popleft()

    def percent_per_s(self, time_s: float) -> float | None:
        """Return the consumption at a time; None until the charge has fallen often enough."""
        rate = self._slope(self._steps)
        if rate is None or self._lowest - _ROUNDING <= self._steps[-1][1] - rate * (time_s - self._steps[-1][0]):
            return rate
        return self._slope([*self._steps, (time_s, self._lowest - _ROUNDING)])

    @staticmethod
    def _slope(steps: Sequence[tuple[float, float]]) -> float | None:
        if len(steps) < _LEAST_STEPS:
            return None
        time_s, percent = np.array(steps).T
        since_s = time_s - time_s.mean()
        spread_s2 = float((since_s**2).sum())
        if spread_s2 == 0.0:  # all reported at one time, as by a clock that stands still
            return None
        falling = -float((since_s * percent).sum()) / spread_s2
        return falling if falling > 0.0 else None

    def left_s(self, time_s: float) -> float | None:
        """Return the flight time left until the reserve; None while the consumption is unknown."""
        rate = self.percent_per_s(time_s)
        if rate is None:
            return None
        fallen_s, percent = self._steps[-1]
        percent = max(percent - rate * (time_s - fallen_s), self._lowest - _ROUNDING)
        return (percent - self._reserve_percent) / rate


def time_to_s(aircraft: AircraftState, place_m: tuple[float, float], airspeed_m_s: float, wind: Wind) -> float:
    """Return the time of a straight flight to a position (east, north); infinite if the wind prevents the flight."""
    east_m, north_m = place_m[0] - aircraft.east_m, place_m[1] - aircraft.north_m
    distance_m = math.hypot(east_m, north_m)
    if distance_m == 0.0:
        return 0.0
    along_m_s = (wind.east_m_s * east_m + wind.north_m_s * north_m) / distance_m
    across_m_s = (wind.east_m_s * north_m - wind.north_m_s * east_m) / distance_m
    if abs(across_m_s) >= airspeed_m_s:
        return math.inf
    ground_m_s = along_m_s + math.sqrt(airspeed_m_s**2 - across_m_s**2)
    return distance_m / ground_m_s if ground_m_s > _LEAST_GROUND_SPEED_M_S else math.inf


_SETTLED_AFTER_S = 120.0  # an aircraft that has not reached band and side by then will be late
_UNSEEN_S = 10.0  # lasers miss for up to 8 s all the time
_RESERVE_PERCENT_WARNED = 25  # where the consumption is not known yet
LOW_BATTERY = 1.2  # the battery is low when the flight time left is below this many times the time to fly home


@dataclass(frozen=True, slots=True)
class _Rule:
    """An alarm: raised after ``after_s`` of its fault, and cleared ``clear_s`` after it."""

    advice: str
    held: str = ""  # the advice while the circle is held, if another one
    after_s: float = 0.0
    clear_s: float = 2.0


class Alarms:
    """The alarms of one aircraft."""

    def __init__(self) -> None:
        self.active: tuple[Alarm, ...] = ()  # in the order of their rules
        self._begun_s: float | None = None
        self._was_in_band = self._was_on_side = False
        self._wrong_since_s: dict[str, float] = {}
        self._right_since_s: dict[str, float] = {}

    def update(self, now: Present) -> tuple[tuple[Alarm, ...], tuple[Alarm, ...]]:
        """Process a state with the vehicle's status; return the alarms that it raises, and those that it clears."""
        if now.phase.in_control and self._begun_s is None:
            self._begun_s = now.time_s
        self._was_in_band |= now.in_band is True
        self._was_on_side |= now.on_side is True
        texts, before = self._texts(now), {alarm.key: alarm for alarm in self.active}
        after = {key: self._judged(key, texts.get(key, ""), before.get(key), now) for key in ALARM_KEYS}
        self.active = tuple(alarm for alarm in after.values() if alarm is not None)
        raised = tuple(alarm for alarm in self.active if alarm.key not in before)
        return raised, tuple(alarm for key, alarm in before.items() if after[key] is None)

    def acknowledge(self, key: str) -> bool:
        """Mark an alarm as seen; return whether it was active and not seen before."""
        known = any(alarm.key == key and not alarm.acknowledged for alarm in self.active)
        self.active = tuple(replace(alarm, acknowledged=True) if alarm.key == key else alarm for alarm in self.active)
        return known

    def _judged(self, key: str, text: str, before: Alarm | None, now: Present) -> Alarm | None:
        if not now.connected and key not in ("link", "yield"):
            return before  # nothing new is known of it
        rule, countdown_s = _RULES[key], now.gives_up_in_s if key == "target" else None
        if text:
            advice = rule.held if rule.held and now.phase is Phase.HOLDING else rule.advice
            self._right_since_s.pop(key, None)
            wrong_since_s = self._wrong_since_s.setdefault(key, now.time_s)
            if before is not None:
                return replace(before, text=text, advice=advice, countdown_s=countdown_s)
            is_due = now.time_s - wrong_since_s >= rule.after_s
            return Alarm(key, text, advice, now.time_s, countdown_s) if is_due else None
        self._wrong_since_s.pop(key, None)
        right_since_s = self._right_since_s.setdefault(key, now.time_s)
        settled = not now.phase.in_control or now.time_s - right_since_s >= rule.clear_s
        return None if settled else before

    def _texts(self, now: Present) -> dict[str, str]:
        """Return the present faults in words, by the key of their alarms."""
        status, unseen_s, texts = now.vehicle, now.unseen_s, {"separation": now.separation}
        if not now.connected:
            silent = _duration(0.0 if status is None else status.silent_s)
            texts["link"] = f"nothing received from the aircraft for {silent}; it keeps circling"
        if now.phase is Phase.YIELDED and now.over:
            texts["yield"] = f"control was given up: {now.over}"
        if not now.phase.in_control:
            return texts
        if unseen_s is not None and (now.is_lost or unseen_s >= _UNSEEN_S):
            texts["target"] = f"the target has not been seen for {_duration(unseen_s)}"
            if now.gives_up_in_s is not None:
                home = now.give_up_action == "return"
                does = "flies home" if home else "stays on its circle and the mission ends"
                texts["target"] += f"; the aircraft {does} in {_duration(now.gives_up_in_s)}"
        is_late = self._begun_s is not None and now.time_s - self._begun_s >= _SETTLED_AFTER_S
        if not now.breach and now.in_band is False and (self._was_in_band or is_late):
            texts["band"] = f"the range of {now.range_m:.0f} m is outside the required band"
        if not now.breach and now.on_side is False and (self._was_on_side or is_late):
            texts["side"] = "the aircraft is not on the required side"
        if not now.turn_payload:
            bad = (one for one in now.health if one.input in _INPUTS and one.state in _BAD)
            texts |= {"object": now.other_object, **{one.input.value: one.text for one in bad}}
        if status is not None:
            gps = f"GPS: {status.gps}" if status.gps_good is False else ""
            texts |= {"gps": gps, "charge": status.battery_doubt, "battery": _low_battery(status)}
        return texts


def _low_battery(status: VehicleStatus) -> str:
    if status.battery_percent is None:
        return ""
    if status.endurance_s is None or status.home_s is None:
        low = status.battery_percent < _RESERVE_PERCENT_WARNED and not status.battery_doubt
        return f"the battery is at {status.battery_percent:.0f} %" if low else ""
    return describe_battery(status) if battery_is_low(status.endurance_s, status.home_s) else ""


def _duration(time_s: float) -> str:
    """Return a time in words: seconds, or m:ss from a minute and a half on."""
    whole_s = round(max(time_s, 0.0))
    return f"{whole_s} s" if whole_s < 90 else f"{whole_s // 60}:{whole_s % 60:02d} min"


def describe_battery(status: VehicleStatus) -> str:
    """Return all that is known of a battery that is ending, in words; its endurance is known."""
    percent, reserve, home_s = status.battery_percent or 0, status.reserve_percent, status.home_s or 0.0
    text = f"the battery is ending: {percent} % left"
    if reserve is not None:
        above = percent - reserve
        text += f", {abs(above):.0f} % {'above' if above >= 0.0 else 'below'} the reserve of {reserve:.0f} %"
    text += f"; about {max(status.endurance_s or 0.0, 0.0):.0f} s"
    text += f" at {status.battery_a:.0f} A" if status.battery_a else ""
    return f"{text}; home is {home_s:.0f} s away"


def battery_is_low(left_s: float, home_s: float) -> bool:
    """Return whether the flight time left until the battery's reserve requires to fly home."""
    return left_s <= LOW_BATTERY * home_s


_BAD = (InputState.STALE, InputState.INCONSISTENT)
_INPUTS = {
    Input.POSITION: "be ready to take over by the transmitter",
    Input.ATTITUDE: "check the autopilot; be ready to take over",
    Input.HEARTBEAT: "check the autopilot; be ready to take over by the transmitter",
    Input.LASER: "the track coasts without it",
    Input.GIMBAL: "the track coasts without it",
    Input.SIGHTINGS: "check the gimbal's mount and flags, the laser's unit, and the camera's field of view",
    Input.CLOCK: "check the autopilot; be ready to take over",
    Input.TERRAIN: "fly higher, or check the elevation data",
    Input.NEIGHBOURS: "watch the separation from the other aircraft",
    Input.HEIGHT: "take over, or switch to RTL, if the aircraft does not come back to its height",
    Input.FENCE: "take over, or switch to RTL, if the aircraft does not turn back",
    Input.PATH: "be ready to take over by the transmitter",
    Input.AIRCRAFT: "check the autopilot's limits and whether another station changed them; be ready to take over",
    Input.SPEED: "check what the payload follows, or raise requirement.target_speed_max_m_s",
    Input.HOME: "check where home is now: the autopilot flies there when it returns",
    Input.ORDERS: "take over to move the aircraft, or press Hold to keep it circling here",
}
_HELD = "press Resume: while you hold the circle it is not relocated"
_RULES = {
    "yield": _Rule("you, or another station, fly the aircraft; resume to let sidelong watch on"),
    "separation": _Rule("change the height of one of the two, or take over", clear_s=0.0),
    "link": _Rule("check radio and antenna; to act now use the transmitter", clear_s=0.0),
    "battery": _Rule("let it fly home now, or switch to RTL", after_s=2.0),
    "charge": _Rule("check the battery's sensor, and watch its voltage", after_s=2.0),
    "object": _Rule("look at it: press This is it, or point the payload at the target", clear_s=0.0),
    "target": _Rule(
        "point the camera at the target, or press Hold to keep circling here",
        "point the camera at the target; the aircraft keeps circling here until you press Resume",
    ),
    **{watched.value: _Rule(advice, clear_s=0.0) for watched, advice in _INPUTS.items()},
    "gps": _Rule("the positions are uncertain: be ready to take over", after_s=2.0),
    "band": _Rule("wait for the next relocation, or change the band or the circle", _HELD, after_s=2.0),
    "side": _Rule("wait for the next relocation, or change the side", _HELD, after_s=20.0),
}
ALARM_KEYS = tuple(_RULES)
