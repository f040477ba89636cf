"""Two links to one vehicle, cut in turn: the flight goes on as if there were one good link.

CUTS=50 LIFE_S=900 LINK_SPEED=1 LINK_LOSS=0.1 LINK_DELAY_MS=300 python -m pytest tests/autopilot/test_two_links.py -s
cuts more, in real time, with both links bad; FLAVOUR=px4 on the other autopilot. Both without sockets:
``tests/exchange/test_two_links.py``.
"""

import csv
import os

import pytest

from sidelong.sitl.settings import LinkFaults

pytestmark = [pytest.mark.udp, pytest.mark.timeout(3600)]

FLAVOUR = os.environ.get("FLAVOUR", "arduplane")
CUTS = int(os.environ.get("CUTS", "2"))
SPEED = float(os.environ.get("LINK_SPEED", "10"))
FAULTS = LinkFaults(float(os.environ.get("LINK_LOSS", "0")), 0.0, 1e-3 * float(os.environ.get("LINK_DELAY_MS", "0")))
WATCHED = "watched from now on"
CUT_S, BETWEEN_S = 2.0, 2.0  # of the wall clock


def test_one_of_two_links_is_cut_again_and_again(vehicle_of, launch):
    vehicle = vehicle_of(FLAVOUR, links=2, speed=SPEED, faults=FAULTS)
    application = launch(vehicle.urls[0], "--connect", vehicle.urls[1])
    application.wait_for(WATCHED)
    for number in range(CUTS):
        vehicle.cut = {vehicle.ports[number % 2]}
        vehicle.wait(CUT_S * SPEED)
        vehicle.cut = set()
        vehicle.wait(BETWEEN_S * SPEED)
    assert application.announced.count("is bad: using") >= CUTS - 1
    summary = application.end()
    print(f"{FLAVOUR}: {CUTS} cuts, {application.announced.count('is bad: using')} changes of link, {summary}")
    assert summary["outcome"] == "interrupted"
    for trouble in ("yielding", "link lost", "has restarted"):
        assert trouble not in application.announced
    if SPEED == 1.0 and not FAULTS.loss:  # a second of silence is ten of the vehicle's at ten times the speed
        assert "too late" not in application.announced
    (first, second) = summary["links"]
    assert first["received_bytes_s"] > 500.0
    assert second["received_bytes_s"] > 500.0
    (run,) = application.out.iterdir()
    with (run / "links.csv").open() as file:
        rows = list(csv.DictReader(file))
    used = [row["url"] for row in rows if row["in_use"] == "1"]
    assert set(used) == set(vehicle.urls)
