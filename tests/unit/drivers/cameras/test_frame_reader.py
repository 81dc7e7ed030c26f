"""Aravis dates a frame by the wall clock, which may be set before the frame is taken."""

from types import SimpleNamespace

import pytest

from drivers.cameras import frame_reader

NOW_NS, WALL_NS, MS, HOUR_NS = 10**12, 1_795_000_000 * 10**9, 10**6, 3600 * 10**9


@pytest.mark.parametrize("step_ns", [0, HOUR_NS, -HOUR_NS])
def test_a_wall_clock_that_was_set_meanwhile_moves_a_frame_by_its_age_at_most(
    step_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrived_ns, age_ns = WALL_NS, 5 * MS
    clocks = SimpleNamespace(monotonic_ns=lambda: NOW_NS, time_ns=lambda: arrived_ns + age_ns + step_ns)
    monkeypatch.setattr(frame_reader, "time", clocks)
    assert frame_reader._monotonic_ns(arrived_ns) == NOW_NS - (0 if step_ns else age_ns)
