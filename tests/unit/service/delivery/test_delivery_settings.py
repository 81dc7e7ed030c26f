"""`[webhooks]` and `[file_drop]`: what is refused, and with which words."""

import tomllib
from pathlib import Path

import pytest
from support.configurations import REPLAY
from support.webhook_receiver import CERTIFICATE, OTHER_SECRET, SECRET

from service.base.errors import SettingsError
from service.configuration.settings import Settings, load_settings, shortcomings
from service.delivery.settings import DropFormat, delivery_shortcomings
from service.store.events import EventType

ENDPOINT = f"""
[webhooks]
allowed_hosts = ["mes.plant.example", "10.0.0.7", "fd00::7"]
[[webhooks.endpoints]]
name = "mes"
url = "https://mes.plant.example/stonefall"
secrets = ["{SECRET}"]
"""


def load(folder: Path, text: str) -> Settings:
    path = folder / "stonefall.toml"
    path.write_text(REPLAY + text)
    return load_settings(path)


def test_what_is_needed_and_the_rest_by_default(tmp_path: Path) -> None:
    settings = load(tmp_path, ENDPOINT + '[file_drop]\ndir = "drop"\n')
    (endpoint,) = settings.webhooks.endpoints
    assert (endpoint.host, endpoint.port, endpoint.events) == ("mes.plant.example", 443, tuple(EventType))
    assert settings.webhooks.timeout_s == 15
    assert settings.file_drop is not None
    assert (settings.file_drop.dir, settings.file_drop.formats) == (tmp_path / "drop", (DropFormat.CSV,))
    neither = load(tmp_path, "")
    assert (neither.webhooks.endpoints, neither.file_drop) == ((), None)


@pytest.mark.parametrize(
    ("instead", "words"),
    [
        (
            ("mes.plant.example/stone", "other.example/stone"),
            "mes: its host other.example is not in allowed_hosts",
        ),
        (("mes.plant.example/stone", "10.0.0.70/stone"), "mes: its host 10.0.0.70 is not in allowed_hosts"),
        (("https://", "ftp://"), "mes: url must begin with http:// or https://"),
        (("https://", "https://user:word@"), "mes: url must have no user, password or fragment"),
        (("/stonefall", "/#stonefall"), "mes: url must have no user, password or fragment"),
        (("example/stonefall", "example:port/stonefall"), "mes: url is not valid"),
        (("example/stonefall", "example/stone fall"), "mes: url must be printable ASCII"),
        (("https://mes.plant.example", "https://"), "mes: url names no host"),
        ((f'"{SECRET}"', ""), "mes: secrets and secret_files: one is needed, two during a rotation"),
        ((f'"{SECRET}"', f'"{SECRET}", "{SECRET}", "{SECRET}"'), "two during a rotation"),
        ((f'"{SECRET}"', '"whsec_c2hvcnQ="'), "mes: secrets: a secret is base64 of 24 to 64 bytes, not of 5"),
        (('name = "mes"', 'name = "m e s"'), "name is 1 to 64 letters"),
        (('name = "mes"', 'name = ".."'), "name is 1 to 64 letters"),
        (('name = "mes"', 'name = "mes"\nevents = ["lot.eaten"]'), "webhooks.endpoints.0.events.0"),
        (('name = "mes"', 'name = "mes"\nevents = []'), "mes: events names no event"),
        (('name = "mes"', 'name = "mes"\nsecret = "x"'), "webhooks.endpoints.0.secret"),
        (("[[webhooks", 'allowed_networks = ["10.0.0.0/33"]\n[[webhooks'), "allowed_networks: "),
        (("[[webhooks", "timeout_s = 600\n[[webhooks"), "timeout_s must be in 0.1..60, not 600"),
        (('"10.0.0.7"', '"10.0.0.7:80"'), "allowed_hosts: must be names or addresses without a port"),
        (("mes.plant.example/stone", "[fd00::7]/stone"), None),
        (("mes.plant.example/stone", "10.0.0.7:8443/stone"), None),
        (("https://mes.plant.example/", "http://MES.plant.example/"), None),
    ],
)
def test_endpoints_are_checked(tmp_path: Path, instead: tuple[str, str], words: str | None) -> None:
    text = ENDPOINT.replace(*instead)
    assert text != ENDPOINT
    if words is None:
        load(tmp_path, text)
        return
    with pytest.raises(SettingsError) as raised:
        load(tmp_path, text)
    assert words in str(raised.value)
    assert SECRET not in str(raised.value)


def test_two_endpoints_of_one_name_are_refused(tmp_path: Path) -> None:
    again = ENDPOINT[ENDPOINT.index("[[webhooks") :]
    with pytest.raises(SettingsError, match="each needs a name of its own"):
        load(tmp_path, ENDPOINT + again)


def test_secrets_are_in_nothing_that_is_printed(tmp_path: Path) -> None:
    settings = load(tmp_path, ENDPOINT)
    assert SECRET not in settings.model_dump_json()
    assert SECRET not in repr(settings)
    assert settings.webhooks.endpoints[0].keys() == [b"k" * 24]


def test_files_that_cannot_be_read_are_shortcomings_with_their_field(tmp_path: Path) -> None:
    (tmp_path / "wrong").write_text("whsec_")
    files = 'secret_files = ["none", "wrong"]\nca_file = "ca.pem"'
    settings = load(
        tmp_path, ENDPOINT.replace(f'secrets = ["{SECRET}"]', files) + '[file_drop]\ndir = "drop"\n'
    )
    assert list(delivery_shortcomings(settings.webhooks, settings.file_drop)) == [
        f"webhooks.endpoints: mes: secret_files: {tmp_path}/none: No such file or directory",
        f"webhooks.endpoints: mes: ca_file: {tmp_path}/ca.pem: No such file or directory",
        f"file_drop.dir: {tmp_path}/drop: there is no such folder",
    ]
    (tmp_path / "none").write_text(OTHER_SECRET)
    (tmp_path / "ca.pem").write_bytes(CERTIFICATE.read_bytes())
    (tmp_path / "drop").mkdir()
    (found,) = (each for each in shortcomings(settings) if "webhooks" in each or "file_drop" in each)
    assert found == (
        f"webhooks.endpoints: mes: secret_files: {tmp_path}/wrong: a secret is base64 of 24 to 64 bytes, not of 0"
    )
    (tmp_path / "wrong").write_text(SECRET)
    assert not list(delivery_shortcomings(settings.webhooks, settings.file_drop))
    assert not list((tmp_path / "drop").iterdir())


def test_a_folder_that_must_be_mounted(tmp_path: Path) -> None:
    drop = f'[file_drop]\ndir = "{tmp_path}"\nmust_be_mounted = true\nformats = ["csv", "json"]\n'
    settings = load(tmp_path, drop)
    assert list(delivery_shortcomings(settings.webhooks, settings.file_drop)) == [
        f"file_drop.dir: {tmp_path}: nothing is mounted there"
    ]
    mounted = load(tmp_path, drop.replace(f'"{tmp_path}"', '"/dev/shm"'))
    assert not list(delivery_shortcomings(mounted.webhooks, mounted.file_drop))
    for wrong in ('formats = ["docx"]', "formats = []"):
        with pytest.raises(SettingsError, match="file_drop"):
            load(tmp_path, f'[file_drop]\ndir = "drop"\n{wrong}\n')


def test_the_example_of_the_deployed_configuration_is_valid(tmp_path: Path) -> None:
    text = (Path(__file__).parents[4] / "deploy" / "stonefall.toml").read_text(encoding="utf-8")
    begin = text.index("[webhooks]")
    lines = text[begin : text.index("\n\n[", begin)].splitlines()
    example = "\n".join(line.removeprefix("# ") for line in lines)
    example = example.replace("allowed_hosts = []", 'allowed_hosts = ["mes.plant.example"]')
    assert tomllib.loads(example).keys() == {"webhooks", "file_drop", "mail"}
    settings = load(tmp_path, example)
    assert settings.webhooks.endpoints[0].ca_file == Path("/etc/stonefall/plant-ca.pem")
    assert settings.file_drop is not None
    assert settings.mail is not None
    assert settings.mail.user == "stonefall"
