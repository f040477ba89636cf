"""Frames from manuals and from public programs, as they go over the wire."""

from __future__ import annotations

# SIYI A8 mini user manual v1.5, section 3.3.3 (examples of communication), and the same frames in public programs
# (mzahana/siyi_sdk, tests/test_crc.py): name, command, data, sequence number, frame.
SIYI_REQUESTS = (
    ("firmware version", 0x01, "", 0, "55 66 01 00 00 00 00 01 64 c4"),
    ("hardware id", 0x02, "", 0, "55 66 01 00 00 00 00 02 07 f4"),
    ("auto focus", 0x04, "01", 0, "55 66 01 01 00 00 00 04 01 bc 57"),
    ("zoom in", 0x05, "01", 0, "55 66 01 01 00 00 00 05 01 8d 64"),
    ("zoom out", 0x05, "ff", 0, "55 66 01 01 00 00 00 05 ff 5c 6a"),
    ("turn at full speed", 0x07, "64 64", 0, "55 66 01 02 00 00 00 07 64 64 3d cf"),
    ("centre", 0x08, "01", 0, "55 66 01 01 00 00 00 08 01 d1 12"),
    ("configuration", 0x0A, "", 0, "55 66 01 00 00 00 00 0a 0f 75"),
    ("photo", 0x0C, "00", 0, "55 66 01 01 00 00 00 0c 00 34 ce"),
    ("lock mode", 0x0C, "03", 0, "55 66 01 01 00 00 00 0c 03 57 fe"),
    ("follow mode", 0x0C, "04", 0, "55 66 01 01 00 00 00 0c 04 b0 8e"),
    ("FPV mode", 0x0C, "05", 0, "55 66 01 01 00 00 00 0c 05 91 9e"),
    ("attitude", 0x0D, "", 0, "55 66 01 00 00 00 00 0d e8 05"),
    ("absolute zoom 4.5", 0x0F, "04 05", 1, "55 66 01 02 00 01 00 0f 04 05 60 bb"),
    ("laser range", 0x15, "", 0, "55 66 01 00 00 00 00 15 d1 96"),
    ("greatest zoom", 0x16, "", 0, "55 66 01 00 00 00 00 16 b2 a6"),
)
# Captured from a ZR10 (unit tests of a QGroundControl fork, UnipodMt11ProtocolTest): the gimbal numbers its replies
# on its own. The first answers a zoom request, the second the configuration: follow mode, mounted the right way up.
SIYI_CAPTURED = ("55 66 02 02 00 1b 5a 18 05 02 54 a9", "55 66 02 06 00 bb 18 0a 00 00 00 02 01 01 1a b6")

# Viewpro ViewLink protocol V3.4.9 (worked examples, as quoted in public programs) and V3.3.3: name, id, data, frame.
VIEWPRO_FRAMES = (
    ("camera command", 0x1C, "03 83", "55 AA DC 05 1C 03 83 99"),
    ("turn left", 0x30, "01 F8 30" + " 00" * 11, "55 AA DC 11 30 01 F8 30" + " 00" * 11 + " E8"),
    ("turn right", 0x30, "01 07 D0" + " 00" * 11, "55 AA DC 11 30 01 07 D0" + " 00" * 11 + " F7"),
)
VIEWPRO_OVER_TCP = (
    "55 AA DC 11 30 01 F8 30" + " 00" * 11 + " E8",
    "EB 90 14 55 AA DC 11 30 01 F8 30" + " 00" * 11 + " E8 2D",
)
# Captured from a serial line: the checksum covers the frame counter in the two upper bits of the length.
VIEWPRO_CAPTURED = (
    "55 AA DC 4A B1 07 00 6A 00 00 F2 7D 19",
    "55 AA DC 8A B1 07 00 6A 00 00 F2 7D D9",
    "55 AA DC CA B1 07 00 6A 00 00 F2 7D 99",
    "55 AA DC 0A B1 07 00 6A 00 00 F2 7D 59",
)
# Block B1 of the status in the vendor's document: yaw 39.28 degrees, pitch 40 degrees up (-40 as sent), roll -0.03.
VIEWPRO_ATTITUDE = "D7 FF 1B F0 E3 8C"

# Topotek: sample commands of ArduPilot's AP_Mount_Topotek, with the checksums of public programs. An angle of -50
# degrees is EC78 in those programs (a Skydroid C13, which has the same protocol).
TOPOTEK_REQUESTS = (
    ("G", "w", "GIA", "01", b"#TPUG2wGIA013E"),
    ("G", "w", "GAA", "01", b"#TPUG2wGAA0136"),
    ("G", "w", "PTZ", "00", b"#TPUG2wPTZ006A"),
    ("G", "w", "PTZ", "01", b"#TPUG2wPTZ016B"),
    ("G", "r", "GIC", "00", b"#TPUG2rGIC003A"),
    ("D", "r", "SDC", "00", b"#TPUD2rSDC003E"),
    ("D", "w", "AWB", "01", b"#TPUD2wAWB0144"),
)
