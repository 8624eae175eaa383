import json

import pytest

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import frontends, live_decoders, live_devices

ARRAY = ArraySettings(antennas=4, subcarriers=4).geometry()


def test_every_decoder_is_timed():
    table = frontends.decoders(ARRAY)
    assert len(table.rows) == 7
    assert all(row[2] > 0 and row[3] > 0 for row in table.rows)
    assert json.dumps(table.as_dict())


@pytest.mark.parametrize("link", [frontends.over_serial, frontends.over_virtual])
def test_a_link_is_timed_and_accounted_for(link):
    whole = link(ARRAY, 300, ())
    assert (whole.arrived, whole.lost) == (300, 0)
    assert whole.seconds > 0
    hit = link(ARRAY, 300, ("--corrupt", "0.05", "--drop", "0.05"))
    assert hit.arrived == hit.told["sent"]
    assert hit.lost == hit.told["corrupted"] + hit.told["dropped"] == 300 - hit.arrived > 0


@pytest.mark.parametrize("name", live_devices.devices())
def test_a_live_device_accounts_for_every_frame(name: str) -> None:
    device = live_devices.devices()[name]
    passed = live_devices.passage(device, 24, {})
    assert passed.sent > 0
    assert passed.damaged == passed.dropped == 0
    tells_angles = device.array.antennas > 1
    assert (passed.theta_off_deg is not None) == tells_angles
    assert not tells_angles or passed.theta_off_deg < (0.5 if name == "krakensdr" else 0.02), "quantisation"
    transmitters = 2 if name == "krakensdr" else 1
    early = passed.rejected.get("calibrating", 0) + passed.rejected.get("incomplete", 0)
    assert passed.sent * transmitters - early <= passed.arrived <= passed.sent * transmitters


def test_decoders_of_live_devices_are_measured() -> None:
    table = live_decoders.decoders()
    assert [row[0] for row in table.rows] == list(live_devices.devices())
