from dataclasses import dataclass
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.gates.edge_filter import Began, Bounced, EdgeFilter, Ended, Pulse

DEBOUNCE = 1000


@dataclass(frozen=True)
class Stone:
    """Gaps between the edges of one stone, closing first; the last edge opens the beam."""

    gap_before: int
    gaps: list[int]  # odd many: bounces, one long one, bounces


SHORT = st.integers(0, DEBOUNCE - 1)
STONES = st.builds(
    lambda gap, before, closed, after: Stone(gap, [*before, closed, *after]),
    st.integers(DEBOUNCE, 100_000),
    st.lists(SHORT, max_size=6).filter(lambda gaps: len(gaps) % 2 == 0),
    st.integers(0, 100_000),
    st.lists(SHORT, max_size=6).filter(lambda gaps: len(gaps) % 2 == 0),
)


def feed(edge_filter: EdgeFilter, *edges: tuple[str, int]) -> list[Pulse]:
    return [
        pulse
        for direction, at_ns in edges
        for pulse in edge_filter.edge(is_closed=direction == "closed", at_ns=at_ns)
    ]


@given(st.lists(STONES, max_size=8))
def test_every_stone_is_one_pulse_and_every_other_closing_a_bounce(stones: list[Stone]) -> None:
    edge_filter, now, n_bounces = EdgeFilter(DEBOUNCE), 0, 0
    pulses: list[Pulse] = []
    expected = []
    for stone in stones:
        now += stone.gap_before
        began = now
        pulses += feed(edge_filter, ("closed", now))
        for number, gap in enumerate(stone.gaps):
            now += gap
            pulses += feed(edge_filter, ("closed" if number % 2 else "opened", now))
        expected += [Began(began), Ended(now - began)]
        n_bounces += len(stone.gaps) // 2
    pulses += edge_filter.settle(now + DEBOUNCE)
    assert [pulse for pulse in pulses if not isinstance(pulse, Bounced)] == expected
    assert sum(isinstance(pulse, Bounced) for pulse in pulses) == n_bounces


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5 * DEBOUNCE))))
def test_every_closing_is_a_stone_or_a_bounce_whatever_was_missed(edges: list[tuple[bool, int]]) -> None:
    edge_filter, now = EdgeFilter(DEBOUNCE), 0
    pulses: list[Pulse] = []
    for is_closed, gap in edges:
        now += gap
        pulses += edge_filter.edge(is_closed=is_closed, at_ns=now)
    kinds = [type(pulse) for pulse in pulses]
    assert kinds.count(Began) + kinds.count(Bounced) == sum(is_closed for is_closed, _ in edges)
    assert kinds.count(Ended) <= kinds.count(Began)
    began = [pulse.at_ns for pulse in pulses if isinstance(pulse, Began)]
    assert all(later - earlier >= DEBOUNCE for earlier, later in pairwise(began))


def test_a_stone_is_announced_at_once_and_its_width_when_it_is_certain() -> None:
    edge_filter = EdgeFilter(DEBOUNCE)
    assert feed(edge_filter, ("closed", 0)) == [Began(0)]
    assert edge_filter.settles_at_ns is None
    assert feed(edge_filter, ("opened", 5000)) == []
    assert edge_filter.settles_at_ns == 6000
    assert edge_filter.settle(5999) == []
    assert edge_filter.settle(6000) == [Ended(5000)]
    assert edge_filter.settles_at_ns is None
    assert edge_filter.settle(7000) == []


def test_stones_in_quick_succession_stay_several() -> None:
    edge_filter = EdgeFilter(DEBOUNCE)
    edges = [("closed", 0), ("opened", 10), ("closed", 1010), ("opened", 1020), ("closed", 2020)]
    assert feed(edge_filter, *edges) == [Began(0), Ended(10), Began(1010), Ended(10), Began(2020)]


def test_missed_edges_end_in_no_absurd_width() -> None:
    edge_filter = EdgeFilter(DEBOUNCE)
    assert feed(edge_filter, ("opened", 0), ("opened", 10)) == []
    assert feed(edge_filter, ("closed", 20), ("closed", 90_000)) == [Began(20), Began(90_000)]
    assert feed(edge_filter, ("opened", 95_000)) == []
    assert edge_filter.settle(99_000) == [Ended(5000)]


def test_a_bounce_that_is_told_late_is_still_no_stone() -> None:
    edge_filter = EdgeFilter(DEBOUNCE)
    feed(edge_filter, ("closed", 0), ("opened", 5000))
    assert edge_filter.settle(6000) == [Ended(5000)]
    assert feed(edge_filter, ("closed", 5300), ("opened", 5400)) == [Bounced(5300)]
    assert edge_filter.settle(9000) == []
    assert feed(edge_filter, ("closed", 9000)) == [Began(9000)]


def test_a_reset_forgets_the_pulse() -> None:
    edge_filter = EdgeFilter(DEBOUNCE)
    feed(edge_filter, ("closed", 0))
    edge_filter.reset()
    assert feed(edge_filter, ("opened", 10)) == []
    assert edge_filter.settle(10_000) == []


def test_debouncing_by_a_negative_time_is_refused() -> None:
    with pytest.raises(ValueError, match="debounce_ns must not be negative, not -1"):
        EdgeFilter(-1)
