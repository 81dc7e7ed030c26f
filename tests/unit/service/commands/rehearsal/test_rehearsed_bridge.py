"""The bridge of a rehearsal serves what can be served here, and leaves nothing behind."""

from pathlib import Path
from urllib.parse import urlsplit

import pytest
from pymodbus.client import ModbusTcpClient
from support.bridge import tell
from support.eventually import eventually
from support.fake_feed import FakeFeed, serving

from service.commands.rehearsal.rehearsed_bridge import rehearsable, rehearsed_bridge
from service.commands.rehearsal.rehearsed_daemon import RehearsalError, is_free


def test_each_outlet_has_an_address_that_is_served(tmp_path: Path) -> None:
    with serving(FakeFeed()) as daemon:
        tell(daemon)
        with rehearsed_bridge(tmp_path, daemon.url) as addresses:
            assert list(addresses) == rehearsable()
            ports = [urlsplit(address).port for address in addresses.values()]
            with ModbusTcpClient("127.0.0.1", port=urlsplit(addresses["modbus"]).port or 0) as client:
                eventually(lambda: client.read_coils(4, count=1).bits[0])
    assert all(is_free(port) for port in ports if port is not None)


def test_a_bridge_that_does_not_start_says_why(tmp_path: Path) -> None:
    (tmp_path / "bridge").write_text("no folder")
    with (
        pytest.raises(RehearsalError, match=r"the bridge does not serve port .* File exists"),
        rehearsed_bridge(tmp_path, "http://127.0.0.1:9"),
    ):
        pass
