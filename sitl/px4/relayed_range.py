"""How PX4 relays a range that another component measures: as a sensor of its own, stamped with its arrival."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as mavlink


class RelayedRange:
    """Holds the latest range until it is sent."""

    def __init__(self) -> None:
        self._message: Any = None

    def put(self, message: Any, boot_ms: int) -> None:
        self._message = mavlink.MAVLink_distance_sensor_message(
            boot_ms,
            message.min_distance,
            message.max_distance,
            message.current_distance,
            message.type,
            message.id,
            message.orientation,
            message.covariance,
            message.horizontal_fov,
            message.vertical_fov,
            message.quaternion,
            max(0, message.signal_quality - 1),
        )

    def take(self) -> Any:
        message, self._message = self._message, None
        return message
