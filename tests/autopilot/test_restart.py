"""The application is killed while it uploads, and started again: the vehicle circles in the meantime."""

import os

import pytest

pytestmark = pytest.mark.udp

TIMES = int(os.environ.get("TIMES", "1"))  # more of the same, with other seeds
WATCHED = "watched from now on"
NAV_WAYPOINT, NAV_LOITER_UNLIM = 16, 17


def flown_line(vehicle):
    """Return the items from the one flown to the end of its line."""
    mission = vehicle.autopilot.mission
    items = mission.items()
    end = mission.index
    while items[end].command == NAV_WAYPOINT:
        end += 1
    return items[mission.index : end + 1]


@pytest.mark.parametrize("seed", range(1, TIMES + 1))
@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_killed_during_an_upload_and_started_again(vehicle_of, launch, flavour, seed):
    vehicle = vehicle_of(flavour, seed)
    item = 1 + seed % 3
    first = launch(vehicle.url)
    first.wait_for(WATCHED)
    before = []
    vehicle.at_item(item, lambda: (first.kill(), before.extend(flown_line(vehicle))))
    first.process.wait(90.0)
    vehicle.wait(30.0)
    after = vehicle.do(lambda: flown_line(vehicle))
    assert after[-1].command == NAV_LOITER_UNLIM
    assert after[-1] == before[-1]
    centre_m = vehicle.autopilot.plane.east_north_m(after[-1].latitude_deg, after[-1].longitude_deg)
    assert vehicle.off_circle_m(centre_m) < 2.0 * abs(after[-1].params[2])

    second = launch(vehicle.url)
    second.wait_for(WATCHED)
    assert "taking over the circle that is flown" in second.announced
    assert vehicle.do(lambda: flown_line(vehicle))[-1] == before[-1]
    assert second.end()["outcome"] == "interrupted"
    taking_over, acquired, _ = (second.run / "journal.jsonl").read_text().partition('"ControlAcquired"')
    assert acquired
    assert "MISSION_ITEM_INT" not in taking_over  # resumed at once: nothing is uploaded before
