"""Alarms as text: one as `/alarms` and `/alarms/history` have it, for a terminal."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from service.health.alarms.alarm import AlarmState

STATES = {
    AlarmState.UNACKNOWLEDGED: "not acknowledged",
    AlarmState.ACKNOWLEDGED: "acknowledged",
    AlarmState.RETURNED: "gone, not acknowledged",
    AlarmState.SHELVED: "shelved",
    AlarmState.SUPPRESSED: "caused by another alarm",
    AlarmState.NORMAL: "ended",
}


def as_text(alarm: Mapping[str, Any]) -> str:
    """Return an alarm in a few lines: how urgent, since when and for how long; what is wrong, why, what to do."""
    lines = (
        f"{alarm['id']:>5}  {alarm['priority']}  {alarm['check']}  {STATES[alarm['state']]}; {_times(alarm)}",
        *(f"       {text}" for text in (alarm["detail"], alarm["cause"], f"-> {alarm['action']}") if text),
    )
    return "\n".join(lines)


def _times(alarm: Mapping[str, Any]) -> str:
    raised = datetime.fromisoformat(alarm["raised_at"])
    text = f"raised {raised:%Y-%m-%d %H:%M:%S} UTC"
    if alarm["occurrences"] > 1:
        text = f"first {text}, {alarm['occurrences']} times in all"
    if alarm["state"] in (AlarmState.RETURNED, AlarmState.NORMAL) and alarm["cleared_at"] is not None:
        lasted = datetime.fromisoformat(alarm["cleared_at"]) - raised
        text += f", gone after {timedelta(seconds=max(0, round(lasted.total_seconds())))}"  # a clock may be set back
    return text
