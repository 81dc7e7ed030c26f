"""Mail to a server on loopback: once each, over failures and restarts, encrypted, never in the way of anything."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.eventually import soon
from support.smtp_server import SmtpServer
from support.webhook_receiver import CERTIFICATE

from service.base.status import CheckStatus
from service.delivery.mail import Letter, Mail, MailSettings, MailTls
from service.store import Store
from service.store.events import EventType, NewEvent, note_event


class Clock:
    """Time that goes on by a day with each look: no test waits for a pause."""

    def __init__(self) -> None:
        self.now = datetime(2026, 3, 2, 13, tzinfo=UTC)

    def __call__(self) -> datetime:
        self.now += timedelta(days=1)
        return self.now


def settings_of(server: SmtpServer, **other: Any) -> MailSettings:
    known = {
        "host": "localhost",
        "port": server.port,
        "sender": "rig@plant.example",
        "recipients": ("shift@plant.example", "lab@plant.example"),
        "ca_file": CERTIFICATE,
    }
    return MailSettings(**known | other)


async def write(event: Mapping[str, Any], settings: MailSettings) -> Letter:
    name = event["subject"]
    return Letter(
        subject=f"Schicht {name}\r\nBcc: all@x.example", text="1,2 t\n", file_name=f"{name}.pdf", pdf=b"%PDF"
    )


async def shift_ended(store: Store, *names: str) -> None:
    for name in names:
        await store.write(note_event, NewEvent(type=EventType.SHIFT_ENDED, subject=name, data={}))


@asynccontextmanager
async def mailing(store: Store, settings: MailSettings) -> AsyncIterator[Mail]:
    mail = Mail(store, settings, now=Clock())
    task = asyncio.create_task(mail.run(write))
    try:
        await begun(store)
        yield mail
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def begun(store: Store) -> None:
    await until_rows(store, "webhooks", 1)


async def noted(store: Store, n_attempts: int) -> None:
    """Wait until so many attempts are in the store: a message that is sent and not noted is sent again."""
    await until_rows(store, "webhook_deliveries", n_attempts)


async def until_rows(store: Store, table: str, n_rows: int) -> None:
    async def is_so() -> bool:
        query = f"SELECT count(*) FROM {table}"  # noqa: S608 - of this module
        (found,) = await store.read(lambda connection: connection.execute(query).fetchone())
        return int(found) >= n_rows

    await soon(is_so)


@pytest.mark.parametrize("tls", MailTls)
async def test_each_end_of_a_shift_is_mailed_once_to_all(store: Store, tls: MailTls, tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret\n")
    login = {"user": "rig", "password_file": tmp_path / "password"} if tls is not MailTls.NONE else {}
    await shift_ended(store, "before the first start")
    async with SmtpServer(with_tls=tls is MailTls.TLS) as server:
        settings = settings_of(server, tls=tls, **login)
        async with mailing(store, settings) as mail:
            await store.write(note_event, NewEvent(type=EventType.HEALTH_CHANGED, subject="device", data={}))
            await shift_ended(store, "a", "b")
            await noted(store, 2)
            assert mail.checks()["mail"].status is CheckStatus.PASS
        async with mailing(store, settings):  # after a restart nothing is sent again
            await shift_ended(store, "c")
            await noted(store, 3)
        first, second, third = server.taken
        assert [each["Subject"] for each in server.taken] == [
            f"Schicht {name} Bcc: all@x.example" for name in "abc"
        ]
        assert first["To"] == "shift@plant.example, lab@plant.example"
        assert first["Bcc"] is None
        assert len({each["Message-ID"] for each in server.taken}) == 3
        (file,) = third.iter_attachments()
        assert (file.get_filename(), file.get_content()) == ("c.pdf", b"%PDF")
        assert second.get_body().get_content().strip() == "1,2 t"
        assert set(server.was_encrypted) == {tls is not MailTls.NONE}
        assert server.logins == (["\0rig\0secret"] * 3 if login else [])


async def test_what_fails_is_told_and_sent_later_in_order(store: Store) -> None:
    async with SmtpServer() as server:
        server.answers = {"MAIL": ["451 later"] * 4, "DATA": ["554 no"]}
        async with mailing(store, settings_of(server)) as mail:
            await shift_ended(store, "a", "b")
            await server.until(lambda: len(server.taken) == 2)
            assert [each["Subject"][8] for each in server.taken] == ["a", "b"]
            await soon(lambda: mail.checks()["mail"].status is CheckStatus.PASS)


async def test_repeated_failures_are_a_warning_that_names_the_answer(store: Store) -> None:
    async with SmtpServer() as server:
        server.answers = {"AUTH": [], "MAIL": ["535 who are you"] * 10_000}
        async with mailing(store, settings_of(server)) as mail:
            await shift_ended(store, "a")
            await soon(lambda: mail.checks()["mail"].status is CheckStatus.WARN)
            assert "535 who are you" in (mail.checks()["mail"].detail or "")
            server.answers.clear()
            await server.until(lambda: len(server.taken) == 1)


async def test_a_refused_recipient_keeps_the_sheet_from_no_other(store: Store) -> None:
    async with SmtpServer() as server:
        server.answers = {"lab@plant.example": ["550 moved"]}
        async with mailing(store, settings_of(server)) as mail:
            await shift_ended(store, "a")
            await soon(lambda: mail.checks()["mail"].detail == "lab@plant.example was refused")
            assert len(server.taken) == 1
            await shift_ended(store, "b")
            await soon(lambda: mail.checks()["mail"].status is CheckStatus.PASS)
            assert len(server.taken) == 2


async def test_a_message_that_may_have_been_taken_comes_again_as_the_same(store: Store) -> None:
    async with SmtpServer(closes_after_data=1) as server, mailing(store, settings_of(server)):
        await shift_ended(store, "a")
        await server.until(lambda: len(server.taken) == 2)
        once, again = server.taken
        assert once["Message-ID"] == again["Message-ID"]
        assert bytes(once).split(b"boundary=")[0] == bytes(again).split(b"boundary=")[0]


async def test_nothing_is_sent_in_the_clear_where_tls_is_asked_for(store: Store, tmp_path: Path) -> None:
    async with SmtpServer() as server:
        settings = settings_of(server, ca_file=None)  # its certificate is signed by nobody that is known
        async with mailing(store, settings) as mail:
            await shift_ended(store, "a")
            await soon(lambda: "certificate" in (mail.checks()["mail"].detail or "").lower())
        assert server.taken == []


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"recipients": ()}, "recipients"),
        ({"recipients": ("a b@x",)}, "recipients"),
        ({"sender": "x@y\r\nBcc: z@x"}, "sender"),
        ({"host": "smtp://x"}, "host"),
        ({"port": 0}, "port"),
        ({"user": "rig"}, "password_file"),
        ({"tls": MailTls.NONE, "user": "rig", "password_file": Path("x")}, "tls"),
        ({"timeout_s": 0.0}, "timeout_s"),
    ],
)
def test_wrong_settings_name_the_field(wrong: dict[str, Any], named: str) -> None:
    good = {"host": "mail.plant.example", "sender": "rig@plant.example", "recipients": ("a@plant.example",)}
    MailSettings(**good)
    with pytest.raises(ValueError, match=named):
        MailSettings(**good | wrong)
