"""Alarms as a person reads them in a terminal."""

from service.commands.alarms import alarm_as_text

ALARM = {
    "id": 7,
    "check": "camera:c05",
    "priority": "medium",
    "state": "unacknowledged",
    "raised_at": "2026-11-21T04:00:00.400Z",
    "cleared_at": None,
    "occurrences": 1,
    "detail": "no answer",
    "cause": "A camera is lost.",
    "action": "Check its cable.",
}


def test_an_alarm_that_calls() -> None:
    assert alarm_as_text(ALARM).splitlines() == [
        "    7  medium  camera:c05  not acknowledged; raised 2026-11-21 04:00:00 UTC",
        "       no answer",
        "       A camera is lost.",
        "       -> Check its cable.",
    ]


def test_one_that_is_gone_says_how_long_it_was_there() -> None:
    gone = ALARM | {
        "state": "returned",
        "cleared_at": "2026-11-21T05:01:30.400Z",
        "occurrences": 3,
        "detail": None,
    }
    times = "first raised 2026-11-21 04:00:00 UTC, 3 times in all, gone after 1:01:30"
    assert alarm_as_text(gone).splitlines() == [
        f"    7  medium  camera:c05  gone, not acknowledged; {times}",
        "       A camera is lost.",
        "       -> Check its cable.",
    ]
    assert "ended" in alarm_as_text(gone | {"state": "normal"})


def test_a_clock_that_was_set_back_makes_no_negative_time() -> None:
    assert "gone after 0:00:00" in alarm_as_text(
        ALARM | {"state": "normal", "cleared_at": "2026-11-21T03:00:00.000Z"}
    )


def test_what_came_back_is_not_gone() -> None:
    assert "gone" not in alarm_as_text(ALARM | {"cleared_at": "2026-11-21T05:00:00.000Z"})
