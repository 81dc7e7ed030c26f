"""One thing that was looked at on the host or on the rig: what is there, what is wanted, and the remedy."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

IN_CHECKOUT = Path(__file__).parents[2] / "deploy/host"
HOST_FILES = "deploy/host" if IN_CHECKOUT.exists() else "/opt/stonefall/current/deploy/host"
"""Folder of the files that prepare a host, as a person at its shell names it."""


class HostVerdict(StrEnum):
    """Meaning of a finding."""

    GOOD = "good"
    FAULT = "fault"
    """It costs stones or results, now or later; `remedy` says what to do."""
    UNKNOWN = "unknown"
    """It cannot be read here, or does not exist on this machine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was checked."""

    subject: str
    verdict: HostVerdict
    found: str
    wanted: str
    remedy: str | None = None  # a command, or a file of deploy/host and where it goes; only of a fault


def judged(subject: str, *, is_good: bool, found: str, wanted: str, remedy: str) -> Finding:
    """Return a finding that is good, or a fault with its remedy."""
    if is_good:
        return Finding(subject=subject, verdict=HostVerdict.GOOD, found=found, wanted=wanted)
    return fault(subject, found=found, wanted=wanted, remedy=remedy)


def fault(subject: str, *, found: str, wanted: str, remedy: str) -> Finding:
    """Return a finding of what is wrong, with its remedy."""
    return Finding(subject=subject, verdict=HostVerdict.FAULT, found=found, wanted=wanted, remedy=remedy)


def unknown(subject: str, found: str, wanted: str) -> Finding:
    """Return a finding of what cannot be read."""
    return Finding(subject=subject, verdict=HostVerdict.UNKNOWN, found=found, wanted=wanted)


def installed(file: str, folder: str, then: str) -> str:
    """Return the remedy that puts a file of deploy/host where it goes, and the command that makes it count."""
    return f"install -Dt {folder} {HOST_FILES}/{file} && {then}"
