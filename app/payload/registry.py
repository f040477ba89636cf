"""The payloads that have a driver: a new one is a module in this folder and a line here.

Other distributions add theirs by the entry point group ``sidelong.payloads``, each a ``PayloadKind``.
"""

from __future__ import annotations

from sidelong.app.payload.driver import DriverSettings, PayloadDriver, PayloadKind
from sidelong.app.payload.siyi import SiyiDriver
from sidelong.app.payload.topotek import TopotekDriver
from sidelong.app.payload.viewpro import ViewproDriver
from sidelong.app.plugins import with_plugins


def _gremsy(settings: DriverSettings) -> PayloadDriver:
    from sidelong.app.payload.gremsy import GremsyDriver  # noqa: PLC0415  # a configuration is read without MAVLink

    return GremsyDriver(settings)


MAVLINK = "mavlink"
"""The value of ``payload.kind`` for a payload that speaks MAVLink itself, or through the autopilot: no driver."""

_OWN = (
    PayloadKind("siyi", "SIYI gimbal cameras (ZT30, ZT6, ZR10, A8 mini)", "udp://192.168.144.25:37260", SiyiDriver),
    PayloadKind("viewpro", "Viewpro gimbal cameras (ViewLink)", "tcp://192.168.2.119:2000", ViewproDriver),
    PayloadKind("gremsy", "Gremsy payloads with a laser (VIO, Orus-L)", "udp://192.168.55.1:14566", _gremsy),
    PayloadKind("topotek", "Topotek gimbal cameras", "udp://192.168.144.108:9003", TopotekDriver),
)
PAYLOADS = with_plugins("sidelong.payloads", _OWN, ("about", "url", "make"), [MAVLINK])
KIND_NAMES = (MAVLINK, *(kind.name for kind in PAYLOADS))


def kind_by_name(name: str) -> PayloadKind:
    """Return the protocol of a name. Raises KeyError for one without a driver."""
    return {kind.name: kind for kind in PAYLOADS}[name]
