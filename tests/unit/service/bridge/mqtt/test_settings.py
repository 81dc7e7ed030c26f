"""`[mqtt]` of the bridge's configuration: what is refused, and by which field."""

from pathlib import Path
from typing import Any

import pytest

from service.base.errors import SettingsError
from service.bridge.settings import load_bridge_settings


def load(folder: Path, text: str) -> Any:
    path = folder / "bridge.toml"
    path.write_text(f'dir = "state"\n[mqtt]\n{text}')
    return load_bridge_settings(path).mqtt


def test_tls_is_what_is_meant_without_a_word(tmp_path: Path) -> None:
    found = load(tmp_path, 'host = "broker.plant"\nprefix = "stonefall/line-1"\nca_file = "ca.pem"')
    assert found.tls
    assert (found.tcp_port, found.ca_file) == (8883, tmp_path / "ca.pem")
    assert load(tmp_path, 'host = "127.0.0.1"\ntls = false\nprefix = "a"').tcp_port == 1883


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('prefix = "a"', "host"),
        ('host = "mqtt://broker"\nprefix = "a"', "host must be"),
        ('host = "broker"', "needs a prefix"),
        ('host = "broker"\nprefix = "a"\nport = 0', "port"),
        *((f'host = "broker"\nprefix = "{prefix}"', "prefix") for prefix in
          ("", "/a", "a/", "a//b", "a/#", "a/+/b", "$SYS", "a\\u0000", "a\\nb", "ü" * 101)),
        ('host = "broker"\nprefix = "a"\nclient_id = "a/b"', "client_id"),
        ('host = "broker"\nprefix = "a"\ntls = false\nca_file = "ca.pem"', "tls is false"),
        ('host = "broker"\nprefix = "a"\ncertificate_file = "c.pem"', "each needs the other"),
        ('host = "broker"\nprefix = "a"\npassword_file = "p"', "needs a user"),
        ('host = "broker"\nprefix = "a"\npassword = "p"', "password"),
        ('host = "broker"\nprefix = "a"\ntls_insecure = true', "tls_insecure"),
        *((f'host = "broker"\n[mqtt.sparkplug]\n{name} = "{value}"', f"sparkplug.{name}")
          for name in ("group", "node", "device", "primary_host") for value in ("", "a/b", "a+", "#")),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_refused_by_its_name(tmp_path: Path, text: str, word: str) -> None:
    with pytest.raises(SettingsError, match=word.replace(".", r"\.")):
        load(tmp_path, text)


def test_a_password_is_read_from_its_file_alone(tmp_path: Path) -> None:
    found = load(tmp_path, 'host = "broker"\nprefix = "a"\nuser = "u"\npassword_file = "secret"')
    with pytest.raises(ValueError, match=r"password_file: .*secret: No such file"):
        found.password()
    (tmp_path / "secret").write_text("hush hush\n")
    assert found.password() == "hush hush"
    (tmp_path / "secret").write_bytes(b"\xff")
    with pytest.raises(ValueError, match="is not text"):
        found.password()


def test_certificates_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    found = load(tmp_path, 'host = "broker"\nprefix = "a"\nca_file = "ca.pem"')
    with pytest.raises(ValueError, match=r"ca_file: .*ca\.pem: No such file"):
        found.tls_context()
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(ValueError, match=r"ca_file: .*ca\.pem"):
        found.tls_context()
