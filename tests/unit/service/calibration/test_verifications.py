import asyncio
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.calibration_desk import a_drop
from support.outcomes import result

from service.base.language import Language
from service.base.messages import Code, in_language
from service.calibration import verifications
from service.calibration.verification_limits import VerificationParameters
from service.calibration.verifications import (
    Verification,
    VerificationRequest,
    Verifications,
    VerificationState,
)
from service.results.fields import Result, Verified

PLAN = VerificationRequest(diameter_mm=15.0, count=3)


def opened(folder: Path, **parameters: float) -> Verifications:
    return Verifications(folder, VerificationParameters(**parameters))


def record(diameter_mm: float | None, calibration_id: str = "rig") -> Result:
    detail = "the body leaves the image" if diameter_mm is None else None
    return result(equivalent_diameter_mm=diameter_mm, calibration_id=calibration_id, detail=detail)


async def let_fall(
    desk: Verifications,
    diameters_mm: list[float | None],
    uneven_mm: float = 0.01,
    calibration_id: str = "rig",
) -> None:
    for number, diameter_mm in enumerate(diameters_mm):
        if desk.collector is not None:
            drop = replace(a_drop(f"{number:06d}"), vertical_minus_horizontal_mm=uneven_mm)
            await desk.collector.add(drop, record(diameter_mm, calibration_id), None)


async def test_a_good_rig_passes_and_rejected_balls_do_not_count(tmp_path: Path):
    desk = opened(tmp_path)
    name = (await desk.start(PLAN, "rig")).id
    await let_fall(desk, [15.02, None, 15.04])
    assert desk.current is not None
    await let_fall(desk, [99.0], calibration_id="another")  # was under way with the one before
    await let_fall(desk, [15.03, 99.0])
    found = opened(tmp_path).find(name)
    assert found is not None
    assert (found.state, len(found.balls), found.problems) == (VerificationState.PASSED, 4, ())
    assert found.summary is not None
    assert found.summary.error_mm == pytest.approx(0.03)
    assert found.summary.sd_mm == pytest.approx(0.01)
    assert found.summary.vertical_minus_horizontal_mm == pytest.approx(0.01)
    assert desk.trouble("rig", datetime.now(UTC)) is None


async def test_a_ball_of_another_size_is_refused_and_does_not_count(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    desk = opened(tmp_path)
    await desk.start(PLAN, "rig")
    await let_fall(desk, [23.0, 15.0, 15.0, 13.0, 23.0])
    assert desk.current is not None
    assert desk.current.summary is not None
    assert desk.current.summary.error_mm == 0.0
    refused = [ball.detail for ball in desk.current.balls if ball.equivalent_diameter_mm is None]
    assert [str(detail)[:27] for detail in refused] == [
        "measures 23.00 mm, not 15 m",
        "measures 13.00 mm, not 15 m",
        "measures 23.00 mm, not 15 m",
    ]
    assert "measures 13.00 mm, not 15 mm: it is another ball" in caplog.text
    await let_fall(desk, [15.0])
    assert desk.all()[0].state is VerificationState.PASSED


@pytest.mark.parametrize(
    ("diameters_mm", "uneven_mm", "problem"),
    [
        ([15.11, 15.11, 15.11], 0.0, r"the diameter is \+0\.110 mm off"),
        ([14.89, 14.89, 14.89], 0.0, r"the diameter is -0\.110 mm off"),
        ([14.94, 15.0, 15.06], 0.0, r"scatters by 0\.060 mm"),
        ([15.0, 15.0, 15.0], -0.06, r"vertical diameter is -0\.060 mm"),
    ],
)
async def test_each_limit_fails_with_a_remedy(tmp_path: Path, diameters_mm, uneven_mm: float, problem: str):
    desk = opened(tmp_path)
    await desk.start(PLAN, "rig")
    await let_fall(desk, diameters_mm, uneven_mm)
    trouble = opened(tmp_path).trouble("rig", datetime.now(UTC))
    assert trouble is not None
    (found,) = desk.all()
    assert (found.state, len(found.problems)) == (VerificationState.FAILED, 1)
    assert in_language(found.problem_findings, Language.ENGLISH) == found.problems[0]
    with pytest.raises(ValueError, match=problem):
        raise ValueError(trouble)
    assert desk.trouble("another", datetime.now(UTC)) is None
    await desk.start(PLAN, "rig")
    await let_fall(desk, [15.0, 15.0, 15.0])
    assert desk.trouble("rig", datetime.now(UTC)) is None


async def test_overdue_is_trouble_where_a_verification_is_asked_for(tmp_path: Path):
    assert opened(tmp_path).trouble("rig", datetime.now(UTC)) is None
    desk = opened(tmp_path, every_h=8.0)
    assert "never verified" in str(desk.trouble("rig", datetime.now(UTC)))
    await desk.start(PLAN, "rig")
    await let_fall(desk, [15.0, 15.0, 15.0])
    assert desk.trouble("rig", datetime.now(UTC)) is None
    overdue = str(desk.trouble("rig", datetime.now(UTC) + timedelta(hours=9)))
    assert overdue == "the last verification was 9 hours ago, and one is due every 8 hours: start one"


async def test_the_word_for_results_and_a_verdict_that_is_void(tmp_path: Path):
    desk, now = opened(tmp_path, every_h=8.0), datetime.now(UTC)
    assert desk.verified("rig", now) is Verified.NEVER
    await desk.start(PLAN, "rig")
    await let_fall(desk, [15.0, 15.0, 15.0])
    assert desk.verified("rig", datetime.now(UTC)) is Verified.PASSED
    assert desk.verified("rig", datetime.now(UTC) + timedelta(hours=9)) is Verified.OVERDUE
    wrong = await desk.start(PLAN, "rig")
    await let_fall(desk, [15.5, 15.5, 15.5])
    assert desk.verified("rig", datetime.now(UTC)) is Verified.FAILED
    assert len(desk.series(15.0)) == 2
    voided = await desk.void(wrong.id, "the ball of the other rig")
    assert voided is not None
    assert (voided.state, voided.problems[-1]) == (VerificationState.VOID, "void: the ball of the other rig")
    assert desk.verified("rig", datetime.now(UTC)) is Verified.PASSED
    assert [each.state for each in opened(tmp_path, every_h=8.0).series(15.0)] == [VerificationState.PASSED]
    assert await desk.void("0009", "why") is None


async def test_it_ends_without_a_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    desk = opened(tmp_path)
    first = await desk.start(PLAN, "rig")
    await let_fall(desk, [15.0])
    desk = opened(tmp_path)  # the daemon was killed
    second = await desk.start(PLAN, "rig")
    await desk.cancel(second.id, "cancelled on request")
    third = await desk.start(PLAN, "rig")
    await desk.cancel_idle()
    assert desk.current == third
    monkeypatch.setattr(verifications, "IDLE_S", 0.0)
    await desk.cancel_idle()
    assert [(each.id, each.state, each.problems[0][:12]) for each in opened(tmp_path).all()] == [
        (third.id, VerificationState.CANCELLED, "no ball of 1"),
        (second.id, VerificationState.CANCELLED, "cancelled on"),
        (first.id, VerificationState.CANCELLED, "the daemon w"),
    ]
    assert [each.problem_findings[0].code for each in opened(tmp_path).all()] == [
        Code.BALLS_MISSING,
        Code.REPORTED,
        Code.DAEMON_RESTARTED,
    ]
    assert await desk.cancel("0009", "why") is None


async def test_a_ball_and_a_cancellation_are_written_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Both write the same file through the same temporary one."""
    desk = opened(tmp_path)
    name = (await desk.start(PLAN, "rig")).id
    write, is_writing = verifications.write_document, threading.Lock()

    def write_slowly(path: Path, document: Any) -> None:
        assert is_writing.acquire(blocking=False)
        time.sleep(0.01)
        write(path, document)
        is_writing.release()

    monkeypatch.setattr(verifications, "write_document", write_slowly)
    await asyncio.gather(let_fall(desk, [15.0]), desk.cancel(name, "cancelled on request"))
    found = opened(tmp_path).find(name)
    assert found is not None
    assert (found.state, len(found.balls)) == (VerificationState.CANCELLED, 1)


async def test_each_end_is_told_once(tmp_path: Path):
    ended: list[tuple[str, VerificationState]] = []

    def on_ended(verification: Verification) -> None:
        ended.append((verification.id, verification.state))

    desk = Verifications(tmp_path, VerificationParameters(), on_ended)
    passed = await desk.start(PLAN, "rig")
    await let_fall(desk, [15.02, 15.04])
    assert ended == []
    await let_fall(desk, [15.03])
    cancelled = await desk.start(PLAN, "rig")
    await desk.cancel(cancelled.id, "on request")
    await desk.cancel(cancelled.id, "on request")
    await desk.void(passed.id, "another ball")
    await desk.start(PLAN, "rig")
    Verifications(tmp_path, VerificationParameters(), on_ended)
    assert ended == [
        ("0001", VerificationState.PASSED),
        ("0002", VerificationState.CANCELLED),
        ("0001", VerificationState.VOID),
        ("0003", VerificationState.CANCELLED),
    ]


def test_a_damaged_one_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    (tmp_path / "0001.json").write_text("{}")
    assert opened(tmp_path).all() == []
    assert "verification 0001 is not used" in caplog.text
