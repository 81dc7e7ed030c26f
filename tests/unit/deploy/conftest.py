"""Hosts of the installer, each in a folder of its test."""

from pathlib import Path

import pytest
from installer import placement, releases
from installer.host import Host
from support.installed_host import NEW, OLD, Script, put


@pytest.fixture
def host(tmp_path: Path) -> Host:
    host = Host(root=tmp_path)
    put(host, OLD)
    return host


@pytest.fixture
def script(host: Host) -> Script:
    put(host, NEW)
    host.path("/run/systemd/system").mkdir(parents=True)
    host.path("/var/lib/stonefall").mkdir(parents=True)
    releases.make_current(host, OLD)
    placement.place(host, OLD)
    return Script(host)
