from __future__ import annotations

import pytest

from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.payload.registry import read_payload


@pytest.mark.parametrize(
    ("text", "kind", "url"),
    [
        ("siyi://", "siyi", None),
        ("siyi://10.0.0.9", "siyi", "udp://10.0.0.9:37260"),
        ("siyi://10.0.0.9:5000", "siyi", "udp://10.0.0.9:5000"),
        ("siyi:///dev/ttyUSB0", "siyi", "serial:///dev/ttyUSB0:115200"),
        ("siyi:///dev/ttyUSB0:57600", "siyi", "serial:///dev/ttyUSB0:57600"),
        ("mavlink", "mavlink", None),
    ],
)
def test_short_forms_name_kind_and_url(text, kind, url):
    assert read_payload("--payload", text) == (kind, url)


@pytest.mark.parametrize("text", ["siyi", "zt30://10.0.0.9", "siyi://10.0.0.9:70000", "siyi://a:b:c", ""])
def test_wrong_payload_is_refused_with_the_form_it_should_have(text):
    with pytest.raises(InputError, match=r"--payload.*//HOST"):
        read_payload("--payload", text)


def test_mavlink_has_no_address_of_its_own():
    with pytest.raises(InputError, match="by the vehicle's links; give mavlink alone"):
        read_payload("--payload", "mavlink://127.0.0.1")


def test_wrong_url_in_the_file_is_refused_by_its_field():
    with pytest.raises(InputError, match=r"payload\.url.*udp://HOST:PORT"):
        load_config(None, {"payload": {"kind": "siyi", "url": "192.168.144.25"}})


def test_unknown_kind_names_the_nearest():
    with pytest.raises(InputError, match="'siyi'"):
        load_config(None, {"payload": {"kind": "siiy"}})
