"""Findings on a screen: one line each, and below them what to do about the faults."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.host.finding import Finding, HostVerdict

STYLES = {HostVerdict.GOOD: "green", HostVerdict.FAULT: "bold red", HostVerdict.UNKNOWN: "yellow"}


def document(findings: Iterable[Finding]) -> list[Mapping[str, Any]]:
    """Return findings as JSON has them."""
    return [asdict(finding) for finding in findings]


def has_fault(findings: Iterable[Finding]) -> bool:
    """True when there is a fault among them."""
    return any(finding.verdict is HostVerdict.FAULT for finding in findings)


def show(title: str, findings: Iterable[Finding]) -> None:
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
