"""Which settings a reload applies, which wait for a restart, and that a bad file changes nothing."""

import asyncio
from pathlib import Path

import pytest
from support.configurations import KEY, REPLAY
from support.recordings import make_bundle, write_recording

from service.base.errors import StoreError
from service.base.messages import Code, message
from service.base.status import trouble_check
from service.configuration.settings import Settings, load_settings
from service.daemon.reloading import Configuration, differences, with_live
from service.store import Store
from service.store.audit import csv_page, entries


class Applied:
    """In the place of the daemon's parts: keeps the settings that they are given."""

    def __init__(self, trouble: StoreError | None = None) -> None:
        self.now: Settings | None = None
        self.trouble = trouble

    async def apply(self, old: Settings, new: Settings) -> None:
        if self.trouble is not None:
            raise self.trouble
        self.now = new


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_recording(tmp_path / "recording", [make_bundle(1)])
    file = tmp_path / "stonefall.toml"
    file.write_text(REPLAY)
    return file


async def reloaded(file: Path, text: str, store: Store, applied: Applied) -> Configuration:
    configuration = Configuration(load_settings(file), file)
    await reload(configuration, file, text, store, applied)
    return configuration


async def reload(configuration: Configuration, file: Path, text: str, store: Store, applied: Applied) -> None:
    await asyncio.to_thread(file.write_text, text)
    await configuration.reload(applied.apply, store)


async def test_what_can_be_applied_is_and_the_rest_is_named(file: Path, store: Store) -> None:
    text = REPLAY + "keep_raw = 7\nretention.files_days = 30\n[optics]\ndust = 0.2\n[workers]\nslots = 1\n"
    applied = Applied()
    configuration = await reloaded(file, text, store, applied)
    assert applied.now is configuration.settings
    assert configuration.settings.store.retention.files_days == 30
    assert configuration.settings.optics.dust == 0.2
    assert (configuration.settings.workers.slots, configuration.settings.store.keep_raw) == (2, 200)
    assert configuration.state.restart_needed_for == ("store.keep_raw", "workers.slots")
    assert configuration.state.problem is None
    assert configuration.checks() == {
        "configuration": trouble_check(message(Code.RESTART_NEEDED, settings="store.keep_raw, workers.slots"))
    }
    (entry,) = await store.read(entries, None, 0, 10)
    assert (entry.who, entry.action, entry.subject) == ("SIGHUP", "configuration", str(file))
    assert entry.before is not None and entry.after is not None
    assert (entry.before["optics.dust"], entry.after["optics.dust"]) == (0.1, 0.2)
    assert entry.after.keys() == {"store.retention", "optics.dust"}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[rig", "stonefall.toml"),
        (REPLAY + "[optics]\ndust = -1.0\n", "dust must be positive"),
        (REPLAY.replace('recording"', 'gone"'), "rig.recording"),
        (REPLAY + "[carving]\nmax_disagreeing_views = 7\n", "views.min"),
    ],
)
async def test_a_bad_file_changes_nothing_and_is_told(
    text: str, named: str, file: Path, store: Store
) -> None:
    applied = Applied()
    before = load_settings(file)
    configuration = await reloaded(file, text, store, applied)
    assert applied.now is None
    assert configuration.settings == before
    assert named in str(configuration.state.problem)
    check = configuration.checks()["configuration"]
    assert (check.status, check.detail) == (
        "warn",
        f"the configuration was refused, the one of {configuration.state.loaded_at} stays in use:"
        f" {configuration.state.problem}",
    )
    await reload(configuration, file, REPLAY + "[optics]\ndust = 0.2\n", store, applied)  # mended
    assert configuration.state.problem is None
    assert configuration.settings.optics.dust == 0.2


async def test_a_store_that_is_damaged_refuses_the_configuration(file: Path, store: Store) -> None:
    configuration = await reloaded(
        file, REPLAY + "[optics]\ndust = 0.2\n", store, Applied(StoreError("is damaged"))
    )
    assert configuration.settings.optics.dust == 0.1
    assert configuration.state.problem == "is damaged"


async def test_keys_are_not_given_up_before_the_address_of_the_network_is(file: Path, store: Store) -> None:
    await asyncio.to_thread(file.write_text, REPLAY + '[api]\nhost = "0.0.0.0"\n' + KEY)
    configuration = await reloaded(file, REPLAY, store, Applied())
    assert len(configuration.settings.api.keys) == 1
    assert "every host that reaches 0.0.0.0" in str(configuration.state.problem)
    assert "needs a restart" in str(configuration.state.problem)


async def test_the_audit_keeps_no_token_of_an_url_and_yet_tells_that_it_changed(
    file: Path, store: Store
) -> None:
    endpoint = (
        '[webhooks]\nallowed_hosts = ["127.0.0.1"]\n[[webhooks.endpoints]]\nname = "mes"\n'
        f'url = "http://127.0.0.1/hook/{{0}}?token={{0}}"\nsecrets = ["whsec_{32 * "A"}"]\n'
    )
    configuration = await reloaded(file, REPLAY + endpoint.format("key-before"), store, Applied())
    await reload(configuration, file, REPLAY + endpoint.format("key-now"), store, Applied())
    noted = await store.read(entries, None, 0, 10)
    assert len(noted) == 2
    assert "http://127.0.0.1/hook/redacted" in str(noted[1].after)
    assert "key-" not in str(noted)
    exported, _ = await store.read(csv_page, None, 0, 10)
    assert b"key-" not in exported


def test_another_secret_is_a_difference(file: Path) -> None:
    endpoint = (
        '[webhooks]\nallowed_hosts = ["127.0.0.1"]\n[[webhooks.endpoints]]\nname = "mes"\n'
        'url = "http://127.0.0.1/"\nsecrets = ["whsec_{}"]\n'
    )
    versions = []
    for secret in (32 * "A", 32 * "B"):
        file.write_text(REPLAY + endpoint.format(secret))
        versions.append(load_settings(file))
    old, new = versions
    assert differences(old, new) == ["webhooks.endpoints"]
    assert differences(with_live(old, new), new) == []
