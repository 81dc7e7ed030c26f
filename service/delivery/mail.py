"""Mail of what has happened, by SMTP: in the order of the events, each once as far as SMTP allows.

The events are the outbox, as for webhooks: how far the mail is stands in the store. A message whose acceptance was not
noted, because the daemon was killed in between, is sent again with the same `Message-ID`, by which receivers drop it.
"""

import asyncio
import logging
import re
import smtplib
import ssl
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from email.headerregistry import Address
from email.message import EmailMessage
from email.utils import format_datetime
from enum import StrEnum
from functools import partial
from time import monotonic
from typing import Any

from drivers.files.bounded import read_bounded
from pipeline.frames import rfc3339
from service.base.abandonable import start_abandonable
from service.base.addresses import is_host
from service.base.errors import ServiceError, StoreError
from service.base.language import Language
from service.base.messages import Code, CodedText, joined
from service.base.messages import message as coded
from service.base.paths import ConfiguredPath
from service.base.schema import require_ranges
from service.base.status import Checks, trouble_check
from service.delivery import table
from service.delivery.progress import PAUSES_S, EndpointAnswer, EndpointProgress, next_progress
from service.delivery.settings import MAX_SECRET_BYTES
from service.delivery.table import Attempt
from service.store import Store
from service.store.events import EventType, events_after

log = logging.getLogger(__name__)

OUTBOX = "[mail]"
"""Name in the table of endpoints, which no webhook can have."""
TOLD = (EventType.SHIFT_ENDED,)
"""Events that are told by mail."""
MAX_RECIPIENTS = 20
ADDRESS = re.compile(r"[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]{1,64}@[A-Za-z0-9.-]{1,255}")
FAILED_OFTEN = 3
"""Failures in a row after which health tells: the first is repeated after 5 s, the second after 5 minutes."""
ANSWER_S = 120.0
"""A server that has not taken a message for so long does not answer."""
STORE_RETRY_S = 5.0


class MailTls(StrEnum):
    """How the connection to the mail server is encrypted."""

    STARTTLS = "starttls"
    """From the server's STARTTLS on, without which nothing is sent."""
    TLS = "tls"
    """From the first byte."""
    NONE = "none"


PORTS = {MailTls.STARTTLS: 587, MailTls.TLS: 465, MailTls.NONE: 25}


@dataclass(frozen=True, slots=True, kw_only=True)
class MailSettings:
    """The mail server, and who gets the sheets of shifts."""

    host: str
    sender: str
    recipients: tuple[str, ...]
    port: int | None = None  # 587, with "tls" 465, with "none" 25
    tls: MailTls = MailTls.STARTTLS
    user: str | None = None
    password_file: ConfiguredPath | None = None  # with one line; read for every message
    ca_file: ConfiguredPath | None = None  # instead of the system's certificates
    language: Language | None = None  # that of issued reports when absent
    timeout_s: float = 30.0  # of each answer

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be a name or address without a port, not {self.host!r}")
        for name, address in (("sender", self.sender), *(("recipients", each) for each in self.recipients)):
            if not ADDRESS.fullmatch(address):
                raise ValueError(f"{name}: {address!r} is no address of mail")
        if not 1 <= len(self.recipients) <= MAX_RECIPIENTS:
            raise ValueError(f"recipients: 1 to {MAX_RECIPIENTS} are needed, not {len(self.recipients)}")
        if self.port is not None and not 0 < self.port < 65536:
            raise ValueError(f"port must be in 1..65535, not {self.port}")
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user, password_file: one needs the other")
        if self.user is not None and self.tls is MailTls.NONE:
            raise ValueError('tls: with a password it must be "starttls" or "tls": all could read it')
        require_ranges(self, timeout_s=(1, 300))

    def password(self) -> str:
        """Return the password; reads its file. Raises `ValueError`, which names the file."""
        if self.password_file is None:
            return ""
        try:
            return read_bounded(self.password_file, MAX_SECRET_BYTES).decode().strip()
        except OSError as err:
            raise ValueError(f"password_file: {self.password_file}: {err.strerror}") from err
        except UnicodeError:
            raise ValueError(f"password_file: {self.password_file}: is not text") from None

    def context(self) -> ssl.SSLContext:
        """Return the TLS context; reads files. Raises `ValueError`, which names the file."""
        try:
            return ssl.create_default_context(cafile=self.ca_file)
        except OSError as err:  # of TLS as well
            raise ValueError(f"ca_file: {self.ca_file}: {err.strerror or err}") from err


@dataclass(frozen=True, slots=True, kw_only=True)
class Letter:
    """What is to be said by mail, with one file."""

    subject: str
    text: str
    file_name: str
    pdf: bytes


Write = Callable[[Mapping[str, Any], MailSettings], Awaitable[Letter | None]]
"""Returns what is to be said of an event; None: nothing."""


def message_of(
    letter: Letter, event: Mapping[str, Any], instance_id: str, settings: MailSettings
) -> EmailMessage:
    """Return the message of an event, the same at each attempt."""
    name = f"{event['type']}.{event['subject']}.{instance_id}"
    message = _message(letter.subject, letter.text, datetime.fromisoformat(event["at"]), name, settings)
    message.add_attachment(letter.pdf, maintype="application", subtype="pdf", filename=letter.file_name)
    return message


def trial_message(settings: MailSettings) -> EmailMessage:
    """Return a message that shows its recipients that mail of this machine arrives."""
    text = "Mail of stonefall arrives here. / Mail von stonefall kommt hier an.\n"
    at = datetime.now(UTC)
    return _message("stonefall: test mail / Testmail", text, at, f"trial.{at:%Y%m%dT%H%M%S.%f}", settings)


def _message(subject: str, text: str, at: datetime, name: str, settings: MailSettings) -> EmailMessage:
    message = EmailMessage()
    message["From"] = Address("stonefall", addr_spec=settings.sender)
    message["To"] = ", ".join(settings.recipients)
    message["Subject"] = " ".join(subject.split())  # a header is one line
    message["Date"] = format_datetime(at)
    message["Message-ID"] = f"<{name}@{settings.sender.rpartition('@')[2]}>"
    message["Auto-Submitted"] = "auto-generated"  # RFC 3834: no answer of an absent recipient
    message.set_content(text)
    return message


def send(message: EmailMessage, settings: MailSettings) -> list[str]:
    """Hand a message over to the server, and return the recipients that it refused; blocks.

    Raises `OSError`, which that of SMTP and TLS is, or `ValueError` for a file, if no recipient gets it.
    """
    port = settings.port or PORTS[settings.tls]
    make: Callable[..., smtplib.SMTP] = smtplib.SMTP
    if settings.tls is MailTls.TLS:
        make = partial(smtplib.SMTP_SSL, context=settings.context())
    with make(settings.host, port, timeout=settings.timeout_s) as server:
        if settings.tls is MailTls.STARTTLS:
            server.starttls(context=settings.context())
        if settings.user is not None:
            server.login(settings.user, settings.password())
        return sorted(server.send_message(message))


class Mail:
    """Sends the mail: `run` is its task. Call it on the event loop."""

    def __init__(
        self,
        store: Store,
        settings: MailSettings | None,
        *,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        answer_s: float = ANSWER_S,
    ) -> None:
        self._store = store
        self._settings = settings
        self._now = now
        self._answer_s = answer_s
        self._progress: EndpointProgress | None = None
        self._refused: list[str] = []
        self._silent: CodedText | None = None

    def checks(self) -> Checks:
        """Return the check of mail, which warns of repeated failures and of recipients that are refused."""
        troubles = [self._silent] if self._silent else []
        progress = self._progress
        if progress is not None and progress.attempts >= FAILED_OFTEN:
            since, problem = str(progress.failing_since), str(progress.last_problem)
            troubles.append(coded(Code.MAIL_FAILING, since=since, reported=problem))
        troubles += [coded(Code.MAIL_REFUSED, recipient=each) for each in self._refused]
        return {"mail": trouble_check(joined(troubles))}

    async def run(self, write: Write) -> None:
        """Send what is due whenever something is, until waiting in the store is ended."""
        settings, is_begun = self._settings, False
        while settings is not None and not self._store.is_released:
            last_event = self._store.last_event
            try:
                if not is_begun:
                    await self._store.write(table.begin, [OUTBOX])
                    is_begun = True
                pause_s = await self._step(settings, write)
            except (StoreError, ServiceError) as err:  # health says so, too
                log.error("mail: %s", err)
                pause_s = STORE_RETRY_S
            with suppress(TimeoutError):
                async with asyncio.timeout(pause_s):
                    await self._store.wait_for_event(last_event)

    async def _step(self, settings: MailSettings, write: Write) -> float | None:
        """Send the next message if it is time; return how long to wait for the next look, None: for an event."""
        before = self._progress = await self._store.read(table.progress_of, OUTBOX)
        if (pause_s := before.pause_s(self._now())) > 0:
            return pause_s
        due = await self._store.read(events_after, before.after, 1, TOLD)
        if not due.items:
            return None
        (event,) = due.items
        message, began_s, at = "", monotonic(), rfc3339(self._now())
        try:
            letter = await write(event, settings)
            if letter is not None:
                email = message_of(letter, event, self._store.instance_id, settings)
                message = email["Message-ID"]
                self._refused = await self._send(email, settings)
        except (OSError, ServiceError, ValueError) as err:
            answer = EndpointAnswer(problem=reason_of(err))
        else:
            answer = EndpointAnswer()
        after = next_progress(before, event["seq"], answer, self._now())
        if after.disabled_at is not None:  # no end: the shifts of a long holiday are sent after it
            again = rfc3339(self._now() + timedelta(seconds=PAUSES_S[-1]))
            after = replace(after, disabled_at=None, next_attempt_at=again)
        if answer.problem is not None:
            log.warning("mail: %s", answer.problem)
        delivery = Attempt(
            at=at,
            webhook_id=message,
            type=event["type"],
            event=event["seq"],
            attempt=before.attempts + 1,
            status=None,
            problem=answer.problem,
            duration_ms=round(1000 * (monotonic() - began_s)),
        )
        self._progress = await self._store.write(table.note, OUTBOX, delivery, before, after)
        return 0.0

    async def _send(self, message: EmailMessage, settings: MailSettings) -> list[str]:
        """Send a message; a server that does not answer is waited for, as it may have taken it."""
        sending = start_abandonable("mail", send, message, settings)
        while not (await asyncio.wait([sending], timeout=self._answer_s))[0]:
            self._silent = coded(Code.MAIL_SILENT, server=settings.host, waited_s=self._answer_s)
            log.error("mail: %s", self._silent)
        self._silent = None
        refused = sending.result()
        if refused:
            log.error("mail: refused recipients: %s", ", ".join(refused))
        return refused


def reason_of(error: Exception) -> str:
    """Return the reason for which `send` failed, in one line."""
    match error:
        case smtplib.SMTPRecipientsRefused(recipients=refused):
            return "; ".join(f"{name}: {_said(*answer)}" for name, answer in sorted(refused.items()))
        case smtplib.SMTPResponseException(smtp_code=code, smtp_error=said):
            return _said(code, said)
        case OSError():
            return " ".join(str(error.strerror or error).split()) or type(error).__name__
    return " ".join(str(error).split()) or type(error).__name__


def _said(code: int, said: bytes | str) -> str:
    text = said.decode(errors="replace") if isinstance(said, bytes) else said
    return f"the server answers {code} {' '.join(text.split())[:200]}"
