"""The rules by which checks of health are alarms: `alarms.toml`, as data."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib.resources import files

from pydantic import TypeAdapter

from service.base.language import Language
from service.base.status import CheckStatus, Ne107

CAMERA = "camera"
"""The rule of all checks `camera:ID`."""


class Priority(StrEnum):
    """Urgency of an operator's response, most urgent first."""

    URGENT = "urgent"
    """No stone is measured or stored."""
    HIGH = "high"
    """Stones are lost, or results are wrong."""
    MEDIUM = "medium"
    """Results are less than they could be; within the shift."""
    LOW = "low"
    """When there is time."""

    @property
    def rank(self) -> int:
        """Return 0 for the most urgent one."""
        return list(Priority).index(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """When a check is an alarm, and what is to be done."""

    warn: Priority | None = None
    fail: Priority | None = None
    on_delay_s: float
    off_delay_s: float
    parents: tuple[str, ...] = ()
    cause: Mapping[Language, str]
    action: Mapping[Language, str]

    def priority(self, status: CheckStatus) -> Priority | None:
        """Return the priority of a status, None if it is no alarm."""
        return {CheckStatus.WARN: self.warn, CheckStatus.FAIL: self.fail}.get(status)


@dataclass(frozen=True, slots=True)
class Rules:
    """The rules by check, the reasons why other checks are no alarms, and all checks in the order of health."""

    by_check: Mapping[str, Rule]
    no_alarm: Mapping[str, str]
    checks: tuple[str, ...] = ()
    ne107: Mapping[str, Ne107] = field(default_factory=dict)
    """Word of the device while a check does not pass, unless it is in a worse state."""

    def of(self, check: str) -> Rule | None:
        """Return the rule of a check, None if it is no alarm."""
        return self.by_check.get(check.partition(":")[0])


@cache
def load_rules() -> Rules:
    """Return the rules that stonefall comes with."""
    document = tomllib.loads(
        files("service.health.alarms").joinpath("alarms.toml").read_text(encoding="utf-8")
    )
    ne107 = {check: Ne107(rule.pop("ne107")) for check, rule in document.items() if "ne107" in rule}
    no_alarm = {check: rule["no_alarm"] for check, rule in document.items() if "no_alarm" in rule}
    rules = {check: rule for check, rule in document.items() if check not in no_alarm}
    return Rules(TypeAdapter(dict[str, Rule]).validate_python(rules), no_alarm, tuple(document), ne107)
