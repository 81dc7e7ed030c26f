"""Findings of a running daemon, which has the devices: its own health, asked over REST."""

from collections.abc import Iterator

from service.base.language import Language
from service.commands.daemon_client import DaemonError, ask
from service.health.alarms.rules import load_rules
from service.host.finding import Finding, fault, judged, unknown

TIMEOUT_S = 5.0


def is_running(url: str) -> bool:
    """True when a daemon answers there; needs no key."""
    try:
        return ask(url, "/health/live", None, timeout_s=TIMEOUT_S).get("status") == "pass"
    except DaemonError as err:
        return err.kind is not None


def check_daemon(url: str, key: str | None) -> Iterator[Finding]:
    """Yield each check of the daemon's health that is an alarm, with what is to be done."""
    try:
        health = ask(url, "/health", key, timeout_s=TIMEOUT_S)
    except DaemonError as err:
        if err.kind is None:
            remedy = "systemctl restart stonefall; journalctl -u stonefall"
            yield fault("daemon", found=str(err), wanted="answers", remedy=remedy)
        else:
            yield unknown("daemon", f"runs, {err}", "--key or STONEFALL_KEY: a key of scope read")
        return
    checks = health["checks"]
    failing = {name: check for name, check in checks.items() if check["status"] != "pass"}
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
        yield fault(
            name,
            found=check.get("detail") or str(check.get("observed_value")),
            wanted="passes",
            remedy=rule.action[Language.ENGLISH],
        )
