"""The configuration file: every field with its unit, its limits and what it is for."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from sidelong.app.errors import InputError
from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM
from sidelong.app.network import NetworkAddress
from sidelong.app.payload.registry import KIND_NAMES, MAVLINK, checked_payload_url
from sidelong.app.planners.registry import PLANNER_NAMES, PLANNERS, planner_by_name
from sidelong.app.records.text_file import read_toml
from sidelong.mission.core.feasibility import in_words
from sidelong.mission.core.plan import ClimbRates
from sidelong.mission.core.requirement import PAN_LIMIT_MIN_DEG, Aircraft, Requirement, Side, widest_radius_m
from sidelong.mission.viewpoint.watch_course import watching_from

if TYPE_CHECKING:
    PlannerName = str
    PayloadName = str
else:
    PlannerName, PayloadName = Literal[PLANNER_NAMES], Literal[KIND_NAMES]


_SHOWN_CHARACTERS = 80  # of a wrong value

Model = TypeVar("Model", bound=BaseModel)


class Section(BaseModel):
    """A table of a file: no key but its own, no value that is not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _is_no_switch(cls, value: Any, info: ValidationInfo) -> Any:
        kind = cls.model_fields[info.field_name or ""].annotation
        if isinstance(value, bool) and bool not in (kind, *get_args(kind)):
            raise ValueError(f"{str(value).lower()} is not allowed here; true and false are for switches")
        return value


def validated(kind: type[Model], values: Any, name: str) -> Model:
    """Return the model of plain values. Raises InputError that begins with ``name`` and names the field."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{name}: {_sentence(error, kind)}") from error


def _sentence(error: ValidationError, kind: type[BaseModel]) -> str:
    """Return the first problem as one sentence that names the field and what is wrong."""
    problem = error.errors()[0]
    where = ".".join(f"{part!s:.40}" for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        return f"unknown key {where}; known there: {', '.join(_known_keys(kind, problem['loc']))}."
    if problem["type"] == "value_error":
        return f"{where + ': ' if where else ''}{_cut(str(problem['ctx']['error']))}."
    if problem["type"] == "missing":
        return f"{where} is missing; give it."
    given = f"{where} = {_cut(repr(problem['input']), _SHOWN_CHARACTERS)}"
    if problem["type"] in ("model_type", "dict_type"):
        return f"{given}: a table belongs there; write [{where}], and its keys below."
    message = problem["msg"][0].lower() + problem["msg"][1:]
    return f"{given}: {message}."


def _cut(text: str, longest: int = 400) -> str:
    return text if len(text) <= longest else text[:longest] + "..."


def _known_keys(kind: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    model: Any = kind
    for part in location[:-1]:
        found = model.model_fields[part].annotation if isinstance(part, str) else model
        of_many = get_args(found)  # a list of sections, or a section that may be missing
        model = of_many[0] if of_many else found
    return list(getattr(model, "model_fields", ()))


DEMONSTRATION = "demo"  # the target of a launch without a configuration
MAX_AIRCRAFT = 8  # of a fleet
_CONTACT = re.compile(r"adsb:[0-9a-f]{6}|ais:[0-9]{9}", re.IGNORECASE)
_COT_TYPE = r"^[a-z](-[A-Za-z0-9.]+)+$"
# The automatic radius gives a 22 s orbit, the best value for recorded targets, if the range band has room for it.
# _BANK_RESERVE is the margin to the bank limit.
_AUTO_RADIUS_S, _BANK_RESERVE = 3.5, 1.1
_DISTANCE_SENSOR_MAX_M = DISTANCE_SENSOR_MAX_CM / 100
_RADIUS_MIN_M, _HEIGHT_MIN_M = 10.0, 20.0

LatLon = tuple[Annotated[float, Field(ge=-90, le=90)], Annotated[float, Field(ge=-180, le=180)]]
Polygon = Annotated[list[LatLon], Field(min_length=3, max_length=500)]


Polygons = Annotated[list[Polygon], Field(max_length=100)]


def _known_side(words: str) -> str:
    watching_from(Requirement(100.0, 500.0, Side.LEFT, 0.0), words)
    return words


class AircraftSection(Section):
    """The aircraft and its limits for this mission."""

    airspeed_m_s: float = Field(15.0, gt=3, le=80)
    """Airspeed while circling, m/s."""
    radius_m: float = Field(50.0, ge=_RADIUS_MIN_M, le=2000)
    """Radius of the circle next to the target, m; "auto": 3.5 s of flight, with room in the range band."""
    bank_max_deg: float = Field(45.0, ge=10, le=70)
    """Bank limit of the autopilot (ArduPlane ROLL_LIMIT_DEG, PX4 FW_R_LIM), degrees."""
    roll_rate_max_deg_s: float = Field(30.0, ge=2, le=180)
    """Roll rate the aircraft reaches in its ordinary turns, degrees/s."""
    pan_limit_deg: float | None = Field(None, ge=PAN_LIMIT_MIN_DEG, le=180, examples=[135.0])
    """Pan limit of the gimbal to each side of the nose; below 180, figures of eight are flown; none: as reported."""
    height_m: float = Field(100.0, ge=_HEIGHT_MIN_M, le=3000)
    """Height of the circle above the reference in height_above, m."""
    height_above: Literal["home", "ground"] = "home"
    """home: above home; ground: above the ground under the target, which requires [terrain]."""
    clearance_m: float = Field(50.0, ge=0, le=1000)
    """Minimum height above the ground along the whole path, if [terrain] is configured, m."""
    climb_m_s: float = Field(3.0, gt=0, le=30)
    """Climb rate of the aircraft in normal operation, m/s."""
    descent_m_s: float = Field(2.0, gt=0, le=30)
    """Descent rate it reaches, m/s."""

    def aircraft(self) -> Aircraft:
        return Aircraft(
            self.airspeed_m_s,
            self.radius_m,
            math.radians(self.bank_max_deg),
            math.radians(self.roll_rate_max_deg_s),
            math.radians(180.0 if self.pan_limit_deg is None else self.pan_limit_deg),
        )

    def rates(self) -> ClimbRates:
        return ClimbRates(self.airspeed_m_s, self.climb_m_s, self.descent_m_s)


class RequirementSection(Section):
    """The requirement: the range band and the side."""

    range_min_m: float = Field(100.0, ge=20, le=5000)
    """Minimum horizontal range to the target (Dmin), m."""
    range_max_m: float = Field(500.0, ge=50, le=20000)
    """Maximum horizontal range to the target (Dmax), m."""
    side: Annotated[str, AfterValidator(_known_side)] = "left"
    """Side of the target's motion to fly on: left, right, either, or compass bearings from it, like 120-200."""
    target_speed_max_m_s: float = Field(3.0, ge=0, le=50)
    """Highest speed expected of the target, m/s."""
    threshold: float = Field(0.9, gt=0, le=2)
    """Factor C on range_max_m at which the paper's planner moves the circle."""
    course_horizon_s: float = Field(20.0, ge=0, le=60)
    """The predictive planner keeps to the side of the course made good over this long, s; 0: the present course."""
    fleet_size: int = Field(1, ge=1, le=MAX_AIRCRAFT)
    """Number of aircraft that watch together: 1, or counted from the [[aircraft]] of a fleet file."""

    @model_validator(mode="after")
    def _band_not_empty(self) -> RequirementSection:
        if self.range_min_m >= self.range_max_m:
            near_m, far_m = self.range_min_m, self.range_max_m
            raise ValueError(f"range_min_m = {near_m:g} is not below range_max_m = {far_m:g}; change one")
        return self

    def requirement(self) -> Requirement:
        plain = Requirement(
            self.range_min_m,
            self.range_max_m,
            Side.LEFT,
            self.target_speed_max_m_s,
            self.threshold,
            course_horizon_s=self.course_horizon_s,
        )
        return watching_from(plain, self.side)


class PlannerSection(Section):
    """How the next circle is chosen."""

    name: PlannerName = Field(
        PLANNER_NAMES[0], description="; ".join(f"{kind.name}: {kind.about}" for kind in PLANNERS) + "."
    )
    guidance: Literal["mission", "command"] = "mission"
    """mission: plans are uploaded as mission items; command (not on PX4): the circle is moved by single commands."""
    tolerance_m: float = Field(15.0, ge=1, le=200)
    """How far the flown line of a transition may leave the planned one, m."""
    winds_m_s: list[Annotated[float, Field(gt=0, le=30)]] = Field(
        default_factory=list, max_length=8, examples=[[4.0, 8.0]]
    )
    """Steady winds to be prepared for with value tables of their own, m/s; the nearest one is used."""
    lost_after_s: float = Field(60.0, ge=1, le=3600)
    """The circle is held when the target has been unseen for this long, s."""
    give_up_after_s: float = Field(300.0, ge=5, le=36000)
    """The mission ends when the target has been unseen for this long, s."""
    at_end: Literal["hold", "return"] = "return"
    """What to do then: hold the circle or fly home."""
    at_low_battery: Literal["return", "warn"] = "return"
    """When the flight time left is below 120 % of the time to fly home: fly home, or only raise an alarm."""
    at_breach: Literal["recover", "return"] = "recover"
    """When the aircraft flies below the floor or outside the fences: command it back, or fly home."""
    battery_reserve_percent: float = Field(20.0, ge=0, le=80)
    """Charge that is to be left in the battery after the flight home, %."""


class SensorsSection(Section):
    """Laser and gimbal."""

    range_sigma_m: float = Field(0.8, gt=0, le=100)
    """Standard deviation of the slant range if the sensor does not report it, m."""
    angle_sigma_deg: float = Field(0.35, gt=0, le=20)
    """Standard deviation of the gimbal's yaw and pitch, degrees."""
    latency_s: float = Field(0.0, ge=0, le=5)
    """Delay between a measurement and its time stamp by the payload, as far as it is known, s."""
    gimbal_latency_s: float | None = Field(None, ge=-1, le=5, examples=[0.5])
    """The same for the gimbal alone, as an earlier flight's summary states it; none: latency_s, s."""
    range_latency_s: float | None = Field(None, ge=-1, le=5, examples=[0.1])
    """The same for the laser alone; none: latency_s, s."""
    latency_sigma_s: float = Field(0.7, ge=0, le=3)
    """1-sigma prior of a further delay of gimbal and laser, estimated in flight; 0: none is estimated, s."""
    range_component: int | None = Field(None, ge=0, le=255, examples=[154])
    """MAVLink component of the laser; detected automatically if not given."""
    gimbal_component: int | None = Field(None, ge=0, le=255, examples=[154])
    """MAVLink component of the gimbal; detected automatically if not given."""
    gimbal_frame: Literal["earth", "vehicle", "body"] | None = Field(None, examples=["earth"])
    """Reference of the gimbal's angles if its frame flags are wrong: north, heading or airframe."""
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the gimbal relative to the autopilot: forward, right, down, m."""
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Mounting angles of a gimbal fixed to the airframe: roll, pitch, yaw, degrees."""
    yaw_bias_sigma_deg: float = Field(1.0, ge=0, le=20)
    """1-sigma prior of the gimbal's yaw bias; 0: no bias is estimated, degrees."""
    pitch_bias_sigma_deg: float = Field(0.5, ge=0, le=20)
    """1-sigma prior of the gimbal's pitch bias; 0: no bias is estimated, degrees."""
    range_bias_sigma_m: float = Field(0.3, ge=0, le=50)
    """1-sigma prior of the laser's range bias; 0: no bias is estimated, m."""
    filter: Literal["imm", "ekf"] = "imm"
    """Motion model of the target filter."""
    target_kind: Literal["unknown", "walker", "cyclist", "car", "boat", "animal"] = "unknown"
    """Kind of target, if known: sets the process noise of the filter."""
    angles_alone: bool = True
    """If the laser sends no range, estimate from line of sight and ground (terrain.folder, or terrain.flat)."""


class PayloadSection(Section):
    """The payload, where the autopilot does not forward its laser range and gimbal angles."""

    kind: PayloadName = MAVLINK
    """Protocol of the payload; mavlink: it sends MAVLink itself, or the autopilot forwards its messages."""
    url: Annotated[str, AfterValidator(checked_payload_url)] | None = Field(
        None, examples=["udp://192.168.144.25:37260"]
    )
    """Its address (udp://HOST:PORT, tcp://HOST:PORT, serial:///dev/NAME:BAUD); none: its factory address."""
    range_unit_m: float | None = Field(None, gt=0, le=10, examples=[0.1])
    """Unit of the range it sends, m; none: the unit in its manual."""
    flip_yaw: bool = False
    """Whether its yaw has the opposite sign to its manual."""
    flip_pitch: bool = False
    """Whether its pitch has the opposite sign to its manual."""
    range_delay_s: float = Field(0.05, ge=0, le=2)
    """Age of a range when the payload sends it, s; the default is half the period of a laser of 10 Hz."""
    angles_delay_s: float = Field(0.0, ge=0, le=2)
    """Age of the angles when the payload sends them, s."""
    angles_relative_to: Literal["vehicle", "body", "earth"] | None = Field(None, examples=["vehicle"])
    """Frame of its angles: heading and horizon (vehicle), airframe (body), north (earth); none: as it reports."""
    point_gimbal: bool = False
    """Whether sidelong points the gimbal at the target: by the vehicle, or by the payload's own protocol."""


SIMULATED_VIDEO = "video://"
"""The ``camera.source`` of a simulated vehicle."""


class CameraSection(Section):
    """A gimbal camera without a laser, whose picture sidelong tracks itself (package extra video)."""

    source: str | None = Field(None, examples=["rtsp://192.168.144.25:8554/main.264"])
    """Video: rtsp://HOST/PATH, udp://HOST:PORT, /dev/videoN, a file; video://: simulated; none: no camera."""
    view_deg: float = Field(60.0, gt=1, lt=170)
    """Horizontal field of view without zoom, degrees."""
    tracker: Literal["kcf", "csrt"] = "kcf"
    """Tracker of OpenCV; csrt takes ten times the processor time."""
    delay_s: float = Field(0.15, ge=0, le=5)
    """Age of a picture when it is decoded, s."""
    lead_s: float = Field(0.15, ge=0, le=2)
    """Time by which commands to the gimbal look ahead: delay of its link and lag, s."""
    rate_hz: float = Field(15.0, gt=0, le=60)
    """Pictures per second that are recorded and sent on."""
    stream: Annotated[str, Field(pattern=r"^(udp://[^:/\s]+:\d{1,5})?$")] = ""
    """Send the video there as MPEG-TS (udp://HOST:PORT)."""
    record_mb: float = Field(2000.0, ge=0)
    """Largest size of video.ts in the run folder, MB; 0: it is not recorded."""

    @property
    def video_uri(self) -> str:
        """Where other systems get the video; '' where they cannot."""
        source = self.source or ""
        return self.stream or (source if "://" in source and not source.startswith("video:") else "")

    def view_rad(self, aspect: float = 9.0 / 16.0) -> tuple[float, float]:
        """Return the horizontal and vertical field of view. aspect: height of a picture in shares of its width."""
        across_rad = math.radians(self.view_deg)
        return across_rad, 2.0 * math.atan(aspect * math.tan(0.5 * across_rad))


class LinkSection(Section):
    """The link to the autopilot."""

    url: str | None = Field(None, examples=["udpin://0.0.0.0:14540"])
    """MAVSDK URL (udpin://0.0.0.0:14540, tcpout://host:port, serial:///dev/ttyUSB0:57600); none: simulate."""
    urls: list[str] = Field(default_factory=list, examples=[["serial:///dev/ttyUSB0:57600", "udpin://0.0.0.0:14550"]])
    """Several links to one vehicle, instead of url: the better one is used, another when that fails."""
    system_id: int | None = Field(None, ge=1, le=255, examples=[1])
    """MAVLink system id of the vehicle, if several share the link; none: the only one."""
    signing_key_file: Path | None = Field(None, examples=["vehicle.key"])
    """Key of MAVLink signing, a file only you can read (sidelong sign makes one); none: nothing is signed."""
    heartbeat_timeout_s: float = Field(10.0, ge=1, le=600)
    """How long to wait for the autopilot's first heartbeat, s."""
    few_messages: bool | None = Field(None, examples=[True])
    """Request only the messages that the mission needs; none: on a serial line of 57,600 baud or less."""
    take_over_from: list[str] = Field(default_factory=list, examples=[["RTL"]])
    """Further modes from which sidelong may take over a flying aircraft: RTL, LAND and so on, failsafe."""
    role: Literal["companion", "ground"] | None = Field(None, examples=["companion"])
    """What sidelong is on the link; none: companion for serve, else ground station unless one is received locally."""
    set_parameters: bool = False
    """Temporarily change conflicting autopilot parameters; restore them at the end."""

    @property
    def connections(self) -> tuple[str, ...]:
        """The URLs that count; none: simulate."""
        return tuple(self.urls) or ((self.url,) if self.url is not None else ())


class FencesSection(Section):
    """Where the aircraft may fly: polygons of [latitude, longitude] in degrees, heights above home in m."""

    keep_in: Polygons = Field(
        default_factory=list, examples=[[[[47.4, 8.5], [47.42, 8.5], [47.42, 8.53], [47.4, 8.53]]]]
    )
    """The aircraft stays inside the union of these."""
    keep_out: Polygons = Field(default_factory=list, examples=[[[[47.405, 8.51], [47.41, 8.51], [47.41, 8.52]]]])
    """The aircraft stays outside each of these."""
    rally: list[LatLon] = Field(default_factory=list, max_length=100, examples=[[[47.41, 8.52]]])
    """Rally points, [latitude, longitude] in degrees, drawn on the live map with those that the vehicle stores."""
    floor_m: float | None = Field(None, ge=0, examples=[60.0])
    """Least height above home, m."""
    ceiling_m: float | None = Field(None, ge=0, examples=[150.0])
    """Greatest height above home, m."""
    margin_m: float = Field(20.0, ge=0, le=500)
    """Kept from every fence, for the error of the flown line, m."""

    @model_validator(mode="after")
    def _floor_below_ceiling(self) -> FencesSection:
        if self.floor_m is not None and self.ceiling_m is not None and self.floor_m >= self.ceiling_m:
            raise ValueError(f"floor_m = {self.floor_m:g} is not below ceiling_m = {self.ceiling_m:g}; change one")
        return self


class TerrainSection(Section):
    """The ground. Without elevation data it is taken as flat and at the height of home."""

    folder: str | None = Field(None, examples=["dem"])
    """Folder of SRTM .hgt tiles or GeoTIFF files, or one such file."""
    sigma_m: float = Field(4.0, gt=0, le=100)
    """Standard deviation of its heights against that at home, m."""
    flat: bool = False
    """Without elevation data: whether the ground is flat enough for sensors.angles_alone."""

    @property
    def is_known(self) -> bool:
        """Whether a line of sight can be cut with the ground."""
        return self.flat or self.folder is not None


def _address(*schemes: str) -> AfterValidator:
    def check(text: str) -> str:
        NetworkAddress.read(text, schemes)
        return text

    return AfterValidator(check)


def is_contact(beacon: str) -> bool:
    """Return whether a beacon is a contact of the vehicle's own ADS-B or AIS receiver."""
    return beacon.lower().startswith(("adsb:", "ais:"))


def _beacon(text: str) -> str:
    if not is_contact(text):
        NetworkAddress.read(text, ("udp",))
    elif not _CONTACT.fullmatch(text):
        raise ValueError(f"{text!r:.80} is not a contact; give one like adsb:4B1234 or ais:211234560")
    return text


class RouteSection(Section):
    """The route that the target is expected to follow. Off the route, sidelong plans as without one."""

    file: Path | None = Field(None, examples=["ferry.gpx"])
    """Route file: .gpx, .geojson, .kml, .cot, or .csv with lat,lon."""
    system_id: int | None = Field(None, ge=1, le=255, examples=[7])
    """MAVLink system id of the target: its mission, once read, takes the place of the file; left out: none."""
    lap: bool = False
    """Whether the last way point connects to the first one."""
    tolerance_m: float = Field(10.0, ge=1, le=200)
    """One standard deviation of the target's lateral offset from the route, m."""
    speed_m_s: float | None = Field(None, gt=0, le=50, examples=[5.0])
    """Expected speed along the route, m/s; left out: unknown."""
    direction: Literal["forward", "backward", "either"] = "either"
    """Direction in which the target follows the way points."""

    @property
    def is_known(self) -> bool:
        """Whether a file or a system id names the target's route."""
        return self.file is not None or self.system_id is not None


class SharingSection(Section):
    """External outputs (CoT, FOLLOW_TARGET, NMEA), and a beacon that the target carries."""

    cot: Annotated[str, _address("udp", "tcp", "tls")] | None = Field(None, examples=["tls://tak.example.org:8089"])
    """Cursor on target (CoT), target and aircraft, to udp://, tcp:// or tls://HOST:PORT; none: not sent."""
    cot_certificate_file: Path | None = Field(None, examples=["client.pem"])
    """For TLS: client certificate (PEM); none: the server requires none."""
    cot_key_file: Path | None = Field(None, examples=["client.key"])
    """For TLS: its key (PEM, without a password); none: in the certificate's file."""
    cot_authority_file: Path | None = Field(None, examples=["authority.pem"])
    """For TLS: certificate authority of the server (PEM); none: the authorities the system trusts."""
    cot_server_name: str | None = Field(None, examples=["takserver"])
    """For TLS: the name in the server's certificate; none: the host's."""
    cot_type: str = Field("a-n-G", pattern=_COT_TYPE)
    """Type of the target in the CoT schema: a-n-G is a neutral thing on the ground."""
    cot_callsign: str = Field("target", min_length=1, max_length=40)
    """Call sign of the target."""
    cot_own_type: str = Field("a-f-A-C-F", pattern=_COT_TYPE)
    """Type of the aircraft: a-f-A-C-F is a civil aeroplane of the own side."""
    cot_own_callsign: str = Field("sidelong", min_length=1, max_length=40)
    """Call sign of the aircraft."""
    cot_team: str = Field("Cyan", min_length=1, max_length=40)
    """Team of the aircraft, by its colour."""
    follow_target: Annotated[str, _address("udp")] | None = Field(None, examples=["udp://192.168.1.20:14555"])
    """FOLLOW_TARGET of the target, for another autopilot's follow mode, to udp://HOST:PORT; none: not sent."""
    follow_target_system_id: int = Field(240, ge=1, le=255)
    """MAVLink system id that FOLLOW_TARGET is sent with (ArduPilot: FOLL_SYSID)."""
    nmea: Annotated[str, _address("udp")] | None = Field(None, examples=["udp://192.168.1.30:14401"])
    """The target as a GPS receiver's NMEA sentences (RMC, GGA), to udp://HOST:PORT; none: not sent."""
    beacon: Annotated[str, AfterValidator(_beacon)] | None = Field(None, examples=["udp://0.0.0.0:6969"])
    """A beacon: udp://ADDRESS:PORT (MAVLink, CoT, NMEA), or a contact, adsb:ICAO or ais:MMSI; none: no beacon."""
    beacon_name: str | None = Field(None, examples=["ranger 7"])
    """Its system id, uid, call sign or, for NMEA, address; none: the only one received."""
    beacon_sigma_m: float = Field(5.0, gt=0, le=200)
    """Standard deviation of its position, each axis, if it does not report it, m."""


class ControlSection(Section):
    """What starts, resumes and ends a watch of sidelong serve, besides its commands."""

    rc_channel: int | None = Field(None, ge=1, le=18, examples=[9])
    """RC channel of a switch (RC_CHANNELS): up watches or resumes, down releases; none: no switch."""
    flight_mode: str | None = Field(None, min_length=1, max_length=20, examples=["LOITER"])
    """Flight mode by name (LOITER, CIRCLE) whose selection starts or resumes a watch; none: no mode does."""
    aux_function: int | None = Field(None, ge=1, le=65535, examples=[300])
    """Function number of MAV_CMD_DO_AUX_FUNCTION (ArduPilot: 300, Scripting1): high watches, low releases; none."""
    disk_budget_mb: float = Field(4000.0, ge=10, le=10_000_000)
    """Space for run folders, MB; before a watch and while it lasts the oldest other ones are deleted beyond it."""
    keep_days: float = Field(90.0, gt=0, le=10_000)
    """Run folders older than this are deleted, days."""


class DisplaySection(Section):
    """The live map: where it is served, what lies under it, and how it shows values; a page can choose others."""

    host: str = "127.0.0.1"
    """Address that it is served at; any other than loopback asks for a token."""
    port: int = Field(8420, ge=0, le=65535)
    """Its port; 0: any free one."""
    certificate_file: Path | None = Field(None, examples=["cert.pem"])
    """Certificate (PEM) to serve it over TLS; none: without."""
    key_file: Path | None = Field(None, examples=["key.pem"])
    """Key of that certificate (PEM)."""
    map_file: Path | None = Field(None, examples=["area.mbtiles"])
    """Map below the tracks: raster tiles (.mbtiles, .pmtiles), or a picture with map_bounds."""
    map_bounds: tuple[float, float, float, float] | None = Field(None, examples=[[47.3, 8.4, 47.5, 8.6]])
    """Bounds of that picture: south, west, north, east, degrees."""

    units: Literal["metric", "nautical", "imperial"] = "metric"
    """metric: m, m/s; nautical: feet, nautical miles, knots; imperial: feet, miles, miles per hour."""
    coordinates: Literal["degrees", "dms", "utm", "mgrs"] = "degrees"
    """Positions in decimal degrees, in degrees, minutes and seconds, or in the UTM or MGRS grid."""
    times: Literal["local", "utc"] = "local"
    """Time of day."""


class SimulationSection(Section):
    """The simulated vehicle that is flown when no link is given."""

    autopilot: Literal["arduplane", "px4"] = "arduplane"
    """Which autopilot it behaves like."""
    target: str = "walk"
    """A built-in motion, or a .gpx or .csv track."""
    speed: float = Field(10.0, ge=0.1, le=100)
    """Simulated time over wall time."""
    seed: int = Field(1, ge=0)
    """Random seed of all noise."""
    laser: bool = True
    """Whether the simulated payload has a laser."""
    wind_speed_m_s: float = Field(0.0, ge=0, le=30)
    """Steady wind, m/s."""
    wind_from_deg: float = Field(270.0, ge=0, le=360)
    """Where the wind comes from, degrees clockwise from north."""
    turbulence: Literal["none", "light", "moderate", "severe"] = "none"
    """Dryden gusts on top of the wind, by MIL-F-8785C."""
    home: LatLon | None = Field(None, examples=[[36.59, -84.24]])
    """Home position, [latitude, longitude] in degrees; none: that of the autopilot's own simulator."""


class Config(Section):
    """Everything a mission needs; every key may be left out."""

    aircraft: AircraftSection = AircraftSection()  # type: ignore[call-arg]  # every field has a default
    requirement: RequirementSection = RequirementSection()  # type: ignore[call-arg]
    planner: PlannerSection = PlannerSection()  # type: ignore[call-arg]
    sensors: SensorsSection = SensorsSection()  # type: ignore[call-arg]
    payload: PayloadSection = PayloadSection()  # type: ignore[call-arg]
    camera: CameraSection = CameraSection()  # type: ignore[call-arg]
    link: LinkSection = LinkSection()  # type: ignore[call-arg]
    fences: FencesSection = FencesSection()  # type: ignore[call-arg]
    terrain: TerrainSection = TerrainSection()  # type: ignore[call-arg]
    route: RouteSection = RouteSection()  # type: ignore[call-arg]
    sharing: SharingSection = SharingSection()  # type: ignore[call-arg]
    control: ControlSection = ControlSection()  # type: ignore[call-arg]
    display: DisplaySection = DisplaySection()  # type: ignore[call-arg]
    simulation: SimulationSection = SimulationSection()  # type: ignore[call-arg]

    _radius_fits: bool = PrivateAttr(False)

    @property
    def is_simulated(self) -> bool:
        return not self.link.connections

    @property
    def radius_words(self) -> float | str:
        """The radius m, or 'auto' where it follows from airspeed and bank."""
        return "auto" if self._radius_fits else self.aircraft.radius_m

    def wind_problem(self, airspeed_m_s: float) -> str:
        """Return which configured wind an aircraft of this airspeed cannot fly in, '' where there is none."""
        simulated_m_s, prepared_m_s = self.simulation.wind_speed_m_s, max(self.planner.winds_m_s, default=0.0)
        for name, wind_m_s in (("simulation.wind_speed_m_s", simulated_m_s), ("planner.winds_m_s", prepared_m_s)):
            if wind_m_s >= airspeed_m_s:
                return f"{name}: {wind_m_s:g} m/s is not below aircraft.airspeed_m_s = {airspeed_m_s:g}; change one"
        return ""

    @model_validator(mode="wrap")
    @classmethod
    def _radius_fitted(cls, values: Any, validated: ModelWrapValidatorHandler[Config]) -> Config:
        """Put a number for aircraft.radius_m = "auto": all that flies needs one."""
        match values:
            case {"aircraft": {"radius_m": "auto", **others}}:
                config = validated({**values, "aircraft": others})
                radius_m = _fitting_radius_m(config.aircraft, config.requirement)
                aircraft = config.aircraft.model_copy(update={"radius_m": radius_m})
                fitted = config.model_copy(update={"aircraft": aircraft})
                fitted._radius_fits = True
                return fitted
        return validated(values)

    @model_validator(mode="after")
    def _sections_agree(self) -> Config:
        if problem := self.wind_problem(self.aircraft.airspeed_m_s):
            raise ValueError(problem)
        if self.aircraft.height_above == "ground" and self.terrain.folder is None:
            raise ValueError('aircraft.height_above = "ground" needs elevation data; give terrain.folder, or "home"')
        return self


def _fitting_radius_m(aircraft: AircraftSection, requirement: RequirementSection) -> float:
    best_m = _AUTO_RADIUS_S * aircraft.airspeed_m_s
    widest_m = widest_radius_m(requirement.range_min_m, requirement.range_max_m)
    tightest_m = _BANK_RESERVE * aircraft.aircraft().min_radius_m
    return float(min(max(math.floor(min(best_m, widest_m)), math.ceil(tightest_m), _RADIUS_MIN_M), 2000))


def room_warning(config: Config) -> str | None:
    """Return in a sentence that the circle leaves too little room in the band, None where it does not."""
    radius_m, near_m, far_m = config.aircraft.radius_m, config.requirement.range_min_m, config.requirement.range_max_m
    widest_m = widest_radius_m(near_m, far_m)
    if radius_m <= 1.05 * widest_m or unflyable(config):
        return None
    advice = f"requirement.range_max_m {near_m + (far_m - near_m) * radius_m / widest_m:.0f} m at least"
    if round(widest_m) >= max(config.aircraft.aircraft().min_radius_m, _RADIUS_MIN_M):
        advice = f"it {widest_m:.0f} m at most, or {advice}"
    else:
        advice += "; a smaller circle needs a lower aircraft.airspeed_m_s or a higher bank_max_deg"
    return (
        f"aircraft.radius_m = {radius_m:g} leaves little room to move the circle between {near_m:g} and {far_m:g} m, "
        f"and the side is kept for less of the time; make {advice}"
    )


def reach_warning(config: Config) -> str | None:
    """Return in a sentence that the band reaches beyond what DISTANCE_SENSOR can report, None where it does not."""
    near_m, far_m, height_m = config.requirement.range_min_m, config.requirement.range_max_m, config.aircraft.height_m
    if config.payload.kind != MAVLINK or math.hypot(far_m, height_m) <= _DISTANCE_SENSOR_MAX_M:
        return None
    if _reached_m(height_m) > near_m + 2.0 * config.aircraft.radius_m:
        advice = f"make requirement.range_max_m {_reached_m(height_m):.0f} m at most"
    elif _reached_m(far_m) >= _HEIGHT_MIN_M:
        advice = f"make aircraft.height_m {_reached_m(far_m):.0f} m at most"
    else:
        advice = "lower both"
    return (
        f"requirement.range_max_m = {far_m:g} at aircraft.height_m = {height_m:g} is farther than a laser behind "
        f"DISTANCE_SENSOR can report ({_DISTANCE_SENSOR_MAX_M:.0f} m along the line of sight), so the target may be "
        f"lost; {advice}, unless the laser sends RANGEFINDER or the payload has a driver"
    )


def _reached_m(other_m: float) -> int:
    """Return how far DISTANCE_SENSOR reaches over the ground from a height, or upwards at a horizontal range, m."""
    return math.floor(math.sqrt(max(_DISTANCE_SENSOR_MAX_M**2 - other_m**2, 0.0)))


def setting_notes(config: Config) -> tuple[str, ...]:
    """Return a sentence for each key that has no effect, or that contradicts another one."""
    payload, route, planner = config.payload, config.route, config.planner
    speed_m_s, speed_max_m_s = route.speed_m_s or 0.0, config.requirement.target_speed_max_m_s
    notes = []
    if payload.kind == MAVLINK:
        unused = (key for key in _changed_keys(payload) if key != "point_gimbal")
        notes += [f'payload.{key} has no effect while payload.kind is "mavlink"' for key in unused]
    if not route.is_known:
        notes += [f"route.{key} has no effect without route.file or route.system_id" for key in _changed_keys(route)]
    elif speed_m_s > speed_max_m_s:
        notes.append(
            f"route.speed_m_s = {speed_m_s:g} is above requirement.target_speed_max_m_s = {speed_max_m_s:g}; "
            "change one"
        )
    if planner.lost_after_s > planner.give_up_after_s:
        notes.append(
            f"planner.lost_after_s = {planner.lost_after_s:g} has no effect above planner.give_up_after_s = "
            f"{planner.give_up_after_s:g}, when the mission ends"
        )
    return tuple(notes)


def _changed_keys(section: Section) -> list[str]:
    return [key for key, value in section if value != type(section).model_fields[key].default]


def height_outside(aircraft: AircraftSection, fences: FencesSection) -> str:
    """Return which fence a height above home lies outside of, '' if it lies outside of none."""
    height_m, floor_m, ceiling_m = aircraft.height_m, fences.floor_m, fences.ceiling_m
    if aircraft.height_above != "home":
        return ""
    if floor_m is not None and height_m < floor_m:
        return f"aircraft.height_m = {height_m:g} is below fences.floor_m = {floor_m:g}; change one"
    if ceiling_m is not None and height_m > ceiling_m:
        return f"aircraft.height_m = {height_m:g} is above fences.ceiling_m = {ceiling_m:g}; change one"
    return ""


def unflyable(config: Config) -> str:
    """Return why the mission cannot be flown and which number to change, '' if it can."""
    aircraft, requirement = config.aircraft.aircraft(), config.requirement.requirement()
    reasons = in_words(planner_by_name(config.planner.name).unflyable(aircraft, requirement))
    return "; ".join(filter(None, (reasons, height_outside(config.aircraft, config.fences))))


def check_flyable(config: Config) -> None:
    """Raise InputError if the configured planner cannot keep the requirement; it names what to change."""
    if reasons := unflyable(config):
        raise InputError(f"infeasible: {reasons}.")


def check_alone(config: Config) -> None:
    """Raise InputError if the configuration is one of a fleet."""
    if (size := config.requirement.fleet_size) > 1:
        raise InputError(f"requirement.fleet_size = {size} with one aircraft; leave it out, or give a fleet file.")


def load_config(path: Path | None, overrides: dict[str, dict[str, Any]] | None = None) -> Config:
    """Return the configuration of a TOML file (or the defaults), with ``overrides`` on top, but for those of None.

    Raises InputError naming the file and the field.
    """
    name, values = ("command line", {}) if path is None else (str(path), read_toml(path))
    return _validated(values, overrides or {}, name)


def with_values(config: Config, overrides: dict[str, dict[str, Any]], name: str) -> Config:
    """Return a validated copy with other values, by section and key. InputError names ``name`` as their origin."""
    return _validated(config.model_dump(), overrides, name)


def config_from(values: Mapping[str, Any], name: str) -> Config:
    """Return the configuration of a journal's plain values. Raises InputError that begins with ``name``."""
    return validated(Config, dict(values), name)


def _validated(values: dict[str, Any], overrides: dict[str, dict[str, Any]], name: str) -> Config:
    for section, keys in overrides.items():
        given = {key: value for key, value in keys.items() if value is not None}
        if given and isinstance(values.setdefault(section, {}), dict):
            values[section] |= given
    return validated(Config, values, name)
