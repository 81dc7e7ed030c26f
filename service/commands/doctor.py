"""`stonefall doctor`: what can be looked at here and at the rig; `check-host`: here; `diagnostics`: all for support."""

import asyncio
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.base.errors import UsageError
from service.base.language import Language
from service.base.status import CheckStatus
from service.commands.daemon_client import ConfiguredUrl, DaemonClient, DaemonError, Key
from service.commands.doctor_rig import check_cameras, check_gate, check_pulse
from service.commands.options import Config
from service.configuration.host_needs import host_needs
from service.configuration.rig_checks import carried_by
from service.configuration.rig_settings import AravisRigSettings, ReplayRigSettings
from service.configuration.settings import Settings, load_settings, problems, shortcomings
from service.daemon.diagnostics.archive import build_archive
from service.daemon.diagnostics.diagnostic_inputs import diagnostic_inputs
from service.delivery.mail import MailSettings, reason_of, send, trial_message
from service.health.alarms.rules import load_rules
from service.host.finding import Finding, HostVerdict, fault, judged, unknown
from service.host.host import ROOT, Host, host_at
from service.host.machine import check_host
from service.store.schema import is_locked

TIMEOUT_S = 5.0
ARCHIVE_S = 90.0
"""The archive may wait for other answers of the daemon."""
STYLES = {HostVerdict.GOOD: "green", HostVerdict.FAULT: "bold red", HostVerdict.UNKNOWN: "yellow"}

Root = Annotated[
    Path,
    typer.Option(
        "--root",
        exists=True,
        file_okay=False,
        help="Look at the files below this folder instead of this machine's, such as a copy of /proc, /sys and /etc.",
    ),
]


def check_host_command(
    config: Config,
    root: Root = ROOT,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON list of all findings.")] = False,
) -> None:
    """Check buffers, network ports, processor, gate, clock, journal, spool and disk; exit 0 if there is no fault.

    Each fault has its remedy: a command, or a file of deploy/host and where it goes. Nothing is changed.
    """
    findings = check_host(host_at(root), host_needs(load_settings(config)))
    _report({"Host": findings}, list(map(asdict, findings)) if as_json else None)


def command(
    config: Config,
    pulse: Annotated[
        bool,
        typer.Option(
            "--pulse",
            help="Also arm the rig and fire the gate's test pulse, with and without the flash; no daemon may run.",
        ),
    ] = False,
    mail: Annotated[
        bool, typer.Option("--mail", help="Also send a test mail to all recipients of [mail].")
    ] = False,
    root: Root = ROOT,
    url: ConfiguredUrl = None,
    key: Key = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all findings by part as JSON.")] = False,
) -> None:
    """Check host, configuration, cameras and gate, and name each fault with its remedy; exit 0 if there is none.

    A running daemon holds the devices: then its health is read instead, and nothing is taken from it.
    """
    settings = load_settings(config)
    host = host_at(root)
    parts: dict[str, list[Finding]] = {
        "Host": check_host(host, host_needs(settings)),
        "Configuration": list(_configuration(config, settings)),
        "Rig": list(_rig(settings, host, DaemonClient(url or settings.api.local_url, key), is_fired=pulse)),
    }
    if mail:
        parts |= {"Mail": [check_mail(settings.mail)]}
    documents = {name.lower(): list(map(asdict, part)) for name, part in parts.items()}
    _report(parts, documents if as_json else None)


def diagnostics_command(
    config: Config,
    out: Annotated[
        Path | None, typer.Argument(help="File to write; default: stonefall-TIME.tar.gz here.")
    ] = None,
    url: ConfiguredUrl = None,
    key: Key = None,
    offline: Annotated[
        bool,
        typer.Option("--offline", help="Do not ask the daemon, even if it runs: without health and metrics."),
    ] = False,
) -> None:
    """Write an archive with configuration, versions, health, alarms, host, calibrations and log, without secrets."""
    out = out or Path(f"stonefall-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.tar.gz")
    if out.exists():
        raise UsageError(f"{out}: exists already")
    settings = load_settings(config)
    daemon = DaemonClient(url or settings.api.local_url, key)
    if not offline and is_running(daemon):
        try:
            content = daemon.fetch("/diagnostics", timeout_s=ARCHIVE_S)
        except DaemonError as err:
            raise DaemonError(f"{err}; --offline does without the daemon", err.kind) from err
        source = f"the daemon at {daemon.url}"
    else:
        os.nice(10)  # it may run beside a daemon
        content, source = build_archive(diagnostic_inputs(settings)), "files alone: no daemon was asked"
    with open(out, "xb", opener=partial(os.open, mode=0o600)) as file:  # for its owner alone
        file.write(content)
    typer.echo(f"{out}: {len(content) / 1e3:.0f} kB, of {source}")


def is_running(daemon: DaemonClient) -> bool:
    """True when a daemon answers; needs no key."""
    try:
        return daemon.ask("/health/live", timeout_s=TIMEOUT_S).get("status") == CheckStatus.PASS
    except DaemonError as err:
        return err.kind is not None


def check_daemon(daemon: DaemonClient) -> Iterator[Finding]:
    """Yield each check of the daemon's health that is an alarm, with what is to be done."""
    try:
        health = daemon.ask("/health", timeout_s=TIMEOUT_S)
    except DaemonError as err:
        if err.kind is None:
            remedy = "systemctl restart stonefall; journalctl -u stonefall"
            yield fault("daemon", found=str(err), wanted="answers", remedy=remedy)
        else:
            yield unknown("daemon", f"runs, {err}", "--key or STONEFALL_KEY: a key of scope read")
        return
    checks = health["checks"]
    failing = {name: check for name, check in checks.items() if check["status"] != CheckStatus.PASS}
    alarms = {name: rule for name in failing if (rule := load_rules().of(name)) is not None}
    yield judged(
        "daemon",
        is_good=not alarms and health["ready"],
        found=f"{health['ne107']}, {len(checks) - len(failing)} of {len(checks)} checks pass"
        + ("" if health["ready"] else "; the next stone will not be measured"),
        wanted="good, and ready for stones",
        remedy="see below, and stonefall alarms",
    )
    for name, rule in alarms.items():
        check = failing[name]
        found = check.get("detail") or str(check.get("observed_value"))
        yield fault(name, found=found, wanted="passes", remedy=rule.action[Language.ENGLISH])


def check_mail(settings: MailSettings | None) -> Finding:
    """Send a test mail, and return that the server took it for all recipients, or why not."""
    wanted = "the server takes a test mail for every recipient"
    if settings is None:
        return unknown("mail", "the configuration has no [mail]", wanted)
    try:
        refused = send(trial_message(settings), settings)
        found = f"{', '.join(refused)} refused" if refused else f"taken for {', '.join(settings.recipients)}"
    except (OSError, ValueError) as err:  # of SMTP and TLS, too; of a file
        refused, found = [*settings.recipients], reason_of(err)
    remedy = f"check {settings.host}, port, tls, user, password_file and recipients of [mail]"
    return judged("mail", is_good=not refused, found=found, wanted=wanted, remedy=remedy)


def _configuration(file: Path, settings: Settings) -> Iterator[Finding]:
    wrong = [*problems(settings), *shortcomings(settings)]
    for problem in wrong:
        field, _, text = problem.partition(": ")
        remedy = f"edit {file}, then: stonefall check-config {file}"
        yield fault(field, found=text, wanted="nothing is wrong with it", remedy=remedy)
    for most in carried_by(settings.rig, settings.bundling)[:1]:
        yield judged(
            "network of the cameras",
            is_good=most.is_burst_carried,
            found=f"a bundle is {most.bundle_ms:.1f} ms on the wire, {most.queued_bytes / 1e6:.2f} MB of it wait in"
            " the switch",
            wanted=f"two stones {1e3 / most.rate_hz:.0f} ms apart are carried",
            remedy='a faster uplink, rig.packet_delay_ns: "The network of the cameras" in deploy/README.md',
        )
    if not wrong:
        found = "nothing is wrong with it"
        yield Finding(subject=str(file), verdict=HostVerdict.GOOD, found=found, wanted="")


def _rig(settings: Settings, host: Host, daemon: DaemonClient, *, is_fired: bool) -> Iterator[Finding]:
    if is_locked(settings.store.dir) or is_running(daemon):
        yield from check_daemon(daemon)
        if is_fired:
            yield unknown(
                "test pulse", "not fired: the daemon has the rig and fires its own", "check background"
            )
        return
    rig = settings.rig
    if isinstance(rig, ReplayRigSettings):
        yield unknown("rig", f"{rig.recording} is replayed", "cameras and a light gate")
        return
    if isinstance(rig, AravisRigSettings):
        yield from check_cameras(rig, host)
    yield check_gate(rig)
    if is_fired:
        yield from asyncio.run(check_pulse(rig, settings))


def _report(parts: Mapping[str, Sequence[Finding]], document: object | None) -> None:
    """Print the document, or else the findings by part; exit with 1 if there is a fault."""
    if document is not None:
        typer.echo(json.dumps(document, indent=2))
    else:
        for title, findings in parts.items():
            _show(title, findings)
    if any(finding.verdict is HostVerdict.FAULT for findings in parts.values() for finding in findings):
        raise typer.Exit(1)


def _show(title: str, findings: Sequence[Finding]) -> None:
    """Print a part of the findings, each fault with its remedy below it."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, show_header=False
    )
    for _ in range(3):
        table.add_column(overflow="fold")
    for finding in findings:
        verdict = Text(finding.verdict, style=STYLES[finding.verdict])
        found = Text(finding.found)
        if finding.verdict is not HostVerdict.GOOD:
            found.append(f"; wanted: {finding.wanted}")
        if finding.remedy is not None:
            found.append(f"\n-> {finding.remedy}", style="bold")
        table.add_row(verdict, finding.subject, found)
    Console(width=None if Console().is_terminal else 160).print(table)
