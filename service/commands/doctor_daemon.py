"""Findings of a running daemon, which has the devices: its own health, asked over REST."""

from collections.abc import Iterator

from service.alarms.rules import load_rules
from service.commands.daemon_client import DaemonError, ask
from service.host.finding import Finding, judged, unknown
from service.language import Language

TIMEOUT_S = 5.0


def is_running(url: str) -> bool:
    """Return whether a daemon answers there; needs no key."""
    try:
        return ask(url, "/health/live", None, timeout_s=TIMEOUT_S).get("status") == "pass"
    except DaemonError as err:
        return err.kind is not None


def check_daemon(url: str, key: str | None) -> Iterator[Finding]:
    """Yield each check of the daemon's health that does not pass, with what its alarm says is to be done."""
    try:
        health = ask(url, "/health", key, timeout_s=TIMEOUT_S)
    except DaemonError as err:
        if err.kind is None:
            remedy = "systemctl restart stonefall; journalctl -u stonefall"
            yield judged("daemon", is_good=False, found=str(err), wanted="answers", remedy=remedy)
        else:
            yield unknown("daemon", f"runs, {err}", "--key or STONEFALL_KEY: a key of scope read")
        return
    checks = health["checks"]
    failing = {name: check for name, check in checks.items() if check["status"] != "pass"}
    yield judged(
        "daemon",
        is_good=not failing and health["ready"],
        found=f"{health['ne107']}, {len(checks) - len(failing)} of {len(checks)} checks pass"
        + ("" if health["ready"] else "; the next stone will not be measured"),
        wanted="good, and ready for stones",
        remedy="see below, and stonefall alarms",
    )
    for name, check in failing.items():
        rule = load_rules().of(name)
        if rule is not None:
            yield judged(
                name,
                is_good=False,
                found=check.get("detail") or str(check.get("observed_value")),
                wanted="passes",
                remedy=rule.action[Language.ENGLISH],
            )
