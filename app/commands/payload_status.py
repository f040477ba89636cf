"""What a payload delivers, as lines for a person and as plain values."""

from __future__ import annotations

import math
from typing import Any

from sidelong.app.payload.pan_limits import pan_words
from sidelong.app.payload.session import PayloadStatus
from sidelong.estimators.rotations import sight_direction


def payload_values(status: PayloadStatus) -> dict[str, Any]:
    """Return the status as plain values, angles in degrees; None where something is not known."""
    direction = None if status.angles is None else sight_direction(status.angles.quaternion_wxyz)
    return {
        "model": status.identity.model or None,
        "firmware": status.identity.firmware or None,
        "has_laser": status.identity.has_laser,
        "pan_limits_deg": degrees_of(status.identity.pan_limits_rad),
        "range_hz": status.range_hz,
        "angles_hz": status.angles_hz,
        "round_trip_s": status.round_trip_s,
        "damaged_frames": status.damaged,
        "range_m": None if status.range is None else status.range.slant_range_m,
        "yaw_deg": None if direction is None else math.degrees(math.atan2(direction[1], direction[0])),
        "pitch_deg": None if direction is None else math.degrees(-math.asin(max(-1.0, min(1.0, direction[2])))),
        "angles_relative_to": None if status.angles is None else status.angles.frame,
        "height_ratio": status.height_ratio,
        "missing": list(status.missing),
    }


def payload_lines(name: str, status: PayloadStatus) -> list[str]:
    """Return lines that begin with the payload's name."""
    values = payload_values(status)
    model = values["model"] or "model unknown"
    firmware = f", firmware {values['firmware']}" if values["firmware"] else ""
    delay = "" if status.round_trip_s is None else f", round trip {1000.0 * status.round_trip_s:.0f} ms"
    damaged = f", {status.damaged} damaged frames" if status.damaged else ""
    lines = [
        f"payload {name}: {model}{firmware}",
        f"  range at {status.range_hz:.1f} Hz, angles at {status.angles_hz:.1f} Hz{delay}{damaged}",
    ]
    now = []
    if status.range is not None and status.range_hz:
        now.append(f"range {values['range_m']:.1f} m")
    if status.angles is not None and status.angles_hz:
        frame = {"vehicle": "heading", "body": "airframe", "earth": "north"}[status.angles.frame]
        now.append(f"yaw {values['yaw_deg']:.1f}, pitch {values['pitch_deg']:.1f} degrees, relative to {frame}")
    if now:
        lines.append(f"  now: {', '.join(now)}")
    if status.height_ratio is None:
        lines.append("  height by range and angles: not compared (on the ground, or too few ranges)")
    else:
        lines.append(
            f"  height by range and angles: {status.height_ratio:.2f} times the autopilot's height above home"
        )
    lines += [f"  {words}" for words in pan_words(status.identity.pan_limits_rad)]
    return lines + [f"  missing: {what}" for what in status.missing]


def degrees_of(limits_rad: tuple[float, float] | None) -> list[float] | None:
    """Return limits in degrees."""
    return None if limits_rad is None else [round(math.degrees(limit_rad), 1) for limit_rad in limits_rad]
