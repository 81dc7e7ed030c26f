"""What a correct client has at the end of a rehearsal: read from the store itself, beside the daemon."""

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.commands.alarms import alarm_as_text
from service.store.history import DATABASE
from service.store.schema import connect_reader


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """Some results: how many, and the SHA-256 of their ids in the order of `seq`, joined by line feeds."""

    results: int
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Earlier(Results):
    """Results of a history that ended, without those that came back."""

    instance_id: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """What a client has seen that followed all day, and asked again whenever it had no answer."""

    script: str
    instance_id: str  # the history at the end
    first_seq: int
    last_seq: int
    followed: Results  # of this history, by a client that followed all day
    kept: Results  # of this history, by one that begins now
    earlier: tuple[Earlier, ...]
    gaps: tuple[dict[str, Any], ...]
    """Removed before a client could read them: history, first and last number."""
    outcomes: dict[str, int]  # of what is kept; with the reason where there is one
    lots: tuple[dict[str, Any], ...]
    alarms: tuple[dict[str, Any], ...]  # in the order in which they were raised
    health: tuple[str, ...]  # words of NE 107, in the order in which they were seen
    is_simulated: bool = True


@dataclass
class Observer:
    """Notes the results that clients can read at each `look`."""

    state_dir: Path
    histories: dict[str, dict[int, str]] = field(default_factory=dict)
    """By `instance_id`, in order: ids by `seq`."""
    gaps: list[dict[str, Any]] = field(default_factory=list)

    def look(self) -> None:
        """Note all results that the store has now: before anything happens to it, and while it can be reached."""
        instance_id, first_seq, _, rows = _read(self.state_dir)
        seen = self.histories.setdefault(instance_id, {})
        newest = max(seen, default=0)
        if seen and first_seq > newest + 1:
            gap = {"instance_id": instance_id, "first_seq": newest + 1, "last_seq": first_seq - 1}
            self.gaps.append(gap)
        seen.update({seq: id_ for seq, id_, _, _ in rows})

    def expected(self, script: str, lots: Any, alarms: Any, health: Iterable[str]) -> Expected:
        """Return the state of a correct client after the last look."""
        self.look()
        instance_id, first_seq, last_seq, rows = _read(self.state_dir)
        current = self.histories[instance_id]
        lost = {
            other: [id_ for _, id_ in sorted(seen.items()) if id_ not in current.values()]
            for other, seen in self.histories.items()
            if other != instance_id
        }
        outcomes = Counter(
            outcome if reason is None else f"{outcome}, {reason}" for _, _, outcome, reason in rows
        )
        return Expected(
            script=script,
            instance_id=instance_id,
            first_seq=first_seq,
            last_seq=last_seq,
            followed=Results(**_digest(id_ for _, id_ in sorted(current.items()))),
            kept=Results(**_digest(id_ for _, id_, _, _ in rows)),
            earlier=tuple(Earlier(instance_id=other, **_digest(ids)) for other, ids in lost.items() if ids),
            gaps=tuple(self.gaps),
            outcomes=dict(sorted(outcomes.items())),
            lots=tuple(lots),
            alarms=tuple(alarms),
            health=tuple(health),
        )


def ends_of(state_dir: Path) -> tuple[int, int]:
    """Return the numbers of the oldest and the newest result that the feed has."""
    _, first_seq, last_seq, _ = _read(state_dir)
    return first_seq, last_seq


def _digest(ids: Iterable[str]) -> dict[str, Any]:
    listed = list(ids)
    return {"results": len(listed), "sha256": hashlib.sha256("\n".join(listed).encode()).hexdigest()}


def _read(state_dir: Path) -> tuple[str, int, int, list[tuple[int, str, str, str | None]]]:
    """Return history, first and last number, and the results that the feed has: number, id, outcome, reason."""
    with connect_reader(state_dir / DATABASE) as connection:
        instance_id, first_seq, last_seq = connection.execute(
            "SELECT instance_id, first_seq, last_seq FROM store"
        ).fetchone()
        rows = connection.execute(
            "SELECT seq, id, outcome, reason FROM results WHERE seq >= ? ORDER BY seq", (first_seq,)
        ).fetchall()
    return instance_id, first_seq, last_seq, rows


def as_text(expected: Expected) -> str:
    """Return it for people."""
    lines = [
        f"history     {expected.instance_id}, results {expected.first_seq} to {expected.last_seq}",
        f"followed    {_line(expected.followed)}: what a client has that followed all day",
        f"kept        {_line(expected.kept)}: what one gets that begins now",
    ]
    lines += [
        f"earlier     {_line(results)} of {results.instance_id}, lost with it" for results in expected.earlier
    ]
    lines += [
        f"gap         results {gap['first_seq']} to {gap['last_seq']} of {gap['instance_id']}"
        for gap in expected.gaps
    ]
    lines += [f"outcome     {n:4} {outcome}" for outcome, n in expected.outcomes.items()]
    lines += [
        f"lot         {lot['lot']} ({lot['state']}): {lot['triggers']} = {lot['measured']} measured + {lot['rejected']}"
        f" rejected + {lot['lost']} lost; {str(lot['verdict']).replace('_', ' ')}"
        for lot in expected.lots
    ]
    lines.append(f"health      {' -> '.join(expected.health)}")
    lines.append(
        f"alarms      {f'{len(expected.alarms)}, in the order of time' if expected.alarms else 'none'}"
    )
    lines += [alarm_as_text(alarm) for alarm in expected.alarms]
    return "\n".join(lines)


def _line(results: Results) -> str:
    return f"{results.results} results, sha256 of their ids {results.sha256}"
