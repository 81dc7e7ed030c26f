"""What `stonefall doctor --mail` finds at a mail server on loopback."""

import asyncio

import pytest
from support.smtp_server import SmtpServer
from support.webhook_receiver import CERTIFICATE

from service.commands.doctor import check_mail
from service.delivery.mail import MailSettings
from service.host.finding import Finding, HostVerdict

RECIPIENTS = ("shift@plant.example", "lab@plant.example")


async def found_at(port: int) -> Finding:
    settings = MailSettings(
        host="localhost", port=port, sender="rig@plant.example", recipients=RECIPIENTS, ca_file=CERTIFICATE
    )
    return await asyncio.to_thread(check_mail, settings)


async def test_a_test_mail_reaches_every_recipient_each_time() -> None:
    async with SmtpServer() as server:
        for _ in range(2):
            found = await found_at(server.port)
            assert (found.verdict, found.found) == (HostVerdict.GOOD, f"taken for {', '.join(RECIPIENTS)}")
        assert server.was_encrypted == [True, True]
        first, second = server.taken
        assert first["To"] == ", ".join(RECIPIENTS)
        assert "Testmail" in first["Subject"]
        assert first["Message-ID"] != second["Message-ID"]  # a receiver drops none


@pytest.mark.parametrize(
    ("answers", "told"),
    [
        ({"lab@plant.example": ["550 unknown"]}, "lab@plant.example refused"),
        ({"DATA": ["552 too big"]}, "the server answers 552 too big"),
    ],
)
async def test_a_refusal_is_a_fault_with_a_remedy(answers: dict[str, list[str]], told: str) -> None:
    async with SmtpServer(answers=answers) as server:
        found = await found_at(server.port)
    assert (found.verdict, found.found) == (HostVerdict.FAULT, told)
    assert found.remedy is not None and "[mail]" in found.remedy


async def test_a_server_that_is_not_there_is_a_fault() -> None:
    async with SmtpServer() as server:
        port = server.port
    assert (await found_at(port)).verdict is HostVerdict.FAULT


def test_without_a_section_nothing_is_sent() -> None:
    assert check_mail(None).verdict is HostVerdict.UNKNOWN
