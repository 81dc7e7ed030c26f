"""The bridge's configuration: what is wrong is named, nothing is guessed."""

from pathlib import Path

import pytest

from service.base.errors import SettingsError, UsageError
from service.bridge import run, settings
from service.bridge.contacts.points import Contact
from service.bridge.settings import BridgeSettings, load_bridge_settings


def load(tmp_path: Path, text: str) -> BridgeSettings:
    path = tmp_path / "bridge.toml"
    path.write_text(text)
    return load_bridge_settings(path)


def test_paths_start_at_the_folder_of_the_file(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        'dir = "state"\n[daemon]\nkey_file = "key"\nconsumer = "scada"\n[modbus]\n'
        '[gpio]\nchip = "/dev/gpiochip0"\nlines = {17 = "rig_ready", LAMP = "out_of_limits"}\n',
    )
    assert found.dir == tmp_path / "state"
    assert found.daemon.key_file == tmp_path / "key"
    assert found.outlets == ("modbus", "gpio")
    assert found.gpio is not None
    assert found.gpio.lines == {"17": Contact.RIG_READY, "LAMP": Contact.OUT_OF_LIMITS}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('dir = "state"', "needs a table of what is to be served: [opcua], [mqtt], [modbus], [gpio]"),
        ("[modbus]", "dir: Field required"),
        ('dir = "s"\n[modbus]\nhots = "h"', "modbus.hots: Unexpected keyword argument"),
        ('dir = "s"\n[contacts]\n[modbus]', "contacts: Extra inputs are not permitted"),
        ('dir = "s"\n[modbus]\nport = 0', "modbus: port must be in 1..65535, not 0"),
        ('dir = "s"\n[modbus]\nhost = "a b"', "modbus: host must be a name or an address"),
        ('dir = "s"\n[modbus]\n[daemon]\nurl = "ftp://x"', "daemon: url must be an address such as"),
        ('dir = "s"\n[modbus]\n[daemon]\nurl = "http://"', "daemon: url must be an address such as"),
        ('dir = "s"\n[modbus]\n[daemon]\nurl = "http://h:99999"', "daemon: url must be an address such as"),
        ('dir = "s"\n[modbus]\n[daemon]\nconsumer = "a b"', "daemon: consumer must be 1 to 40 letters"),
        ('dir = "s"\n[gpio]\nchip = "c"\nlines = {1 = "lamp"}', "gpio.lines.1: Input should be 'heartbeat'"),
        ('dir = "s"\n[gpio]\nchip = "c"\nlines = {}', "gpio: lines must have one at least"),
        ('dir = "s"\n[gpio]\nchip = ""\nlines = {1 = "alarm"}', "gpio: chip must be named"),
        ('dir = "s', "Unterminated string"),
    ],
)
def test_what_is_wrong_is_named(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError) as refused:
        load(tmp_path, text)
    assert f"{tmp_path}/bridge.toml: " in str(refused.value)
    assert said in str(refused.value)


def test_the_file_of_the_repository_is_read() -> None:
    path = Path(__file__).parents[4] / "deploy/bridge.toml"
    found = load_bridge_settings(path)
    assert found.daemon.url == "http://127.0.0.1:8080"
    assert "modbus" in found.outlets


def test_a_missing_package_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(settings.OUTLETS, "modbus", "package_of_the_extra.outlet")
    found = load(tmp_path, 'dir = "s"\n[modbus]')
    with pytest.raises(
        UsageError, match=r"\[modbus\] needs the extra \[bridge\], which is not installed .*-bridge.lock"
    ):
        run.outlets(found)
