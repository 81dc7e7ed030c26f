"""What `stonefall doctor` makes of a running daemon's health."""

import pytest

from service.commands.daemon_client import DaemonClient
from service.commands.doctor import check_daemon
from service.host.finding import HostVerdict


def verdicts(health: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> dict[str, HostVerdict]:
    monkeypatch.setattr(DaemonClient, "ask", lambda *_, **__: health)
    return {finding.subject: finding.verdict for finding in check_daemon(DaemonClient())}


def test_only_what_is_an_alarm_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    checks = {
        "drops": {"status": "warn", "detail": "a calibration is open"},
        "disk": {"status": "pass"},
        "camera:c03": {"status": "pass"},
    }
    health = {"ne107": "maintenance_required", "ready": True, "checks": checks}
    assert verdicts(health, monkeypatch) == {"daemon": HostVerdict.GOOD}
    checks["camera:c03"] = {"status": "fail", "detail": "lost"}
    assert verdicts(health, monkeypatch) == {"daemon": HostVerdict.FAULT, "camera:c03": HostVerdict.FAULT}
    health |= {"checks": {}, "ready": False}
    assert verdicts(health, monkeypatch) == {"daemon": HostVerdict.FAULT}
