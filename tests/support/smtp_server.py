"""A mail server on loopback, which answers as a test says and keeps what it takes."""

import asyncio
import base64
import ssl
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from email import message_from_bytes, policy
from email.message import EmailMessage
from types import TracebackType
from typing import Self, cast

from support.eventually import PATIENCE_S
from support.webhook_receiver import CERTIFICATE

OK = "250 ok"


@dataclass
class SmtpServer:
    """Takes mail; `answers` has what it says to a command in the place of `OK`, each once."""

    with_tls: bool = False
    """Encrypted from the first byte; else it offers STARTTLS."""
    answers: dict[str, list[str]] = field(default_factory=dict)
    taken: list[EmailMessage] = field(default_factory=list)
    logins: list[str] = field(default_factory=list)
    was_encrypted: list[bool] = field(default_factory=list)
    closes_after_data: int = 0
    """Messages after which it closes the connection without an answer, although it has taken them."""

    async def __aenter__(self) -> Self:
        self._changed = asyncio.Condition()
        self._serving: set[asyncio.Task[None]] = set()
        self._context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        self._context.load_cert_chain(CERTIFICATE)
        context = self._context if self.with_tls else None
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, ssl=context)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.close()
        for task in self._serving:
            task.cancel()
        await asyncio.gather(*self._serving, return_exceptions=True)

    @property
    def port(self) -> int:
        return int(self._server.sockets[0].getsockname()[1])

    async def until(self, is_so: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S), self._changed:
            await self._changed.wait_for(is_so)

    def _said(self, command: str, usual: str = OK) -> str:
        waiting = self.answers.get(command)
        return waiting.pop(0) if waiting else usual

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
                await self._talk(reader, writer)
        finally:
            self._serving.discard(task)
            writer.transport.abort()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        is_encrypted = self.with_tls

        async def say(*lines: str) -> None:
            writer.write("".join(f"{line}\r\n" for line in lines).encode())
            await writer.drain()

        await say(self._said("CONNECT", "220 test"))
        while line := (await reader.readline()).decode().strip():
            command = line.split(" ")[0].split(":")[0].upper()
            if command == "EHLO":
                offers = [] if is_encrypted else ["250-STARTTLS"]
                await say("250-test", *offers, "250 AUTH PLAIN")
            elif command == "STARTTLS":
                await say("220 go")
                await writer.start_tls(self._context)
                is_encrypted = True
            elif command == "AUTH":
                self.logins.append(base64.b64decode(line.split(" ")[2]).decode())
                await say(self._said("AUTH", "235 welcome"))
            elif command == "DATA":
                await say("354 go on")
                content = await reader.readuntil(b"\r\n.\r\n")
                answer = self._said("DATA")
                if answer == OK:
                    message = message_from_bytes(content.removesuffix(b".\r\n"), policy=policy.default)
                    async with self._changed:
                        self.taken.append(cast("EmailMessage", message))
                        self.was_encrypted.append(is_encrypted)
                        self._changed.notify_all()
                if self.closes_after_data > 0:
                    self.closes_after_data -= 1
                    return
                await say(answer)
            elif command == "QUIT":
                await say("221 bye")
                return
            else:
                await say(
                    self._said(command if command != "RCPT" else line.partition("<")[2].partition(">")[0])
                )
