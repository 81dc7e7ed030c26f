"""Lots in the words of ISA-95: opened, closed, voided; at most one is open, and takes every stone that falls.

A closed lot is final for its revision once all its stones have outcomes: then it is completed, with its verdict and an
issued report. What changes its figures later is another revision, which is completed anew.
"""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from http import HTTPStatus
from typing import Annotated, Any

from pydantic import BaseModel, Field

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from pipeline.gradation.specification import Verdict
from service.base.errors import ProblemError, ProblemKind
from service.base.ids import NEW_ID
from service.base.schema import GivenTime, Name, OptionalTime, Remark, Time, request_body
from service.base.status import Report
from service.lots.outcome import LotCompletion, ReachedVerdict
from service.lots.products import find_product
from service.store import audit
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import rows_by_name

Tonnage = Annotated[float, Field(ge=0, le=1e6)]
Given = Annotated[str | None, Field(max_length=200)]
REST_S = 10.0
"""Time without another revision after which a lot whose stones are measured again is completed."""
MOST_RUNS = 1000
"""Lots of one sample that are looked at, the newest."""


class LotState(StrEnum):
    """State of a lot."""

    OPEN = "open"
    CLOSING = "closing"
    """Closed, and stones of it have no outcome yet."""
    CLOSED = "closed"
    VOID = "void"


@request_body
class LotDefinition:
    """What the plant says of a lot; all but the first is optional."""

    lot: Annotated[str, Field(pattern=NEW_ID)]
    """Material lot."""
    equipment: Name | None = None
    """The crusher or belt that it comes from."""
    sublot: Name | None = None
    """Material sublot, ISA-95."""
    sample_id: Name | None = None
    """Id of the laboratory sample; lots with the same one are compared by `/repeatability`."""
    sampler: Name | None = None
    """Who took the sample."""
    external_id: Name | None = None
    """Its id in the plant's own system, such as `4500012345/10`; lots are found by it."""
    order: Name | None = None
    """Order or delivery that it is for; lots are found by it."""
    customer: Name | None = None
    """Who gets it; lots are found by it."""
    tonnage_t: Tonnage | None = None
    """Mass of the whole lot, t."""
    remark: Remark | None = None
    """Whatever else the plant says of it."""


class LotDocument(Report):
    """A lot in the words of ISA-95."""

    lot: str = Field(description="Material lot")
    state: LotState = Field(
        description="`open`: takes what falls; `closing`: closed, and some stones have no outcome yet; `closed`;"
        " `void`: counts no more"
    )
    product: str = Field(description="Material definition")
    product_version: int = Field(description="Version of the product that the lot was opened with")
    equipment: str | None = Field(description="The crusher or belt that it comes from")
    sublot: str | None = Field(description="Material sublot")
    sample_id: str | None = Field(description="Id of the laboratory sample")
    sampler: str | None = Field(description="Who took the sample")
    external_id: str | None = Field(default=None, description="Its id in the plant's own system")
    order: str | None = Field(default=None, description="Order or delivery that it is for")
    customer: str | None = Field(default=None, description="Who gets it")
    tonnage_t: float | None = Field(description="Mass of the whole lot, t")
    remark: str | None = Field(description="Whatever else the plant said of it")
    opened_at: Time = Field(description="When it was opened, RFC 3339 UTC")
    closed_at: OptionalTime = Field(description="When it was closed or voided, RFC 3339 UTC; null while open")
    void_reason: str | None = Field(description="Why it counts no more; null unless void")
    revision: int = Field(
        description="0 while it is open; 1 when it is closed, and one more with each change after that"
    )
    n_stones: int = Field(description="Stones that fell and have an outcome, whatever became of them")
    in_progress: int = Field(default=0, description="Stones that fell and have no outcome yet")
    completion: LotCompletion | None = Field(
        default=None,
        description="Verdict and report, once all stones have outcomes: final if of this `revision`; null before",
    )
    reached: ReachedVerdict | None = Field(
        default=None,
        description="Latest verdict, `conforms` or `does_not_conform`, that its stones allowed while it was open; null:"
        " none yet",
    )

    @property
    def is_closed(self) -> bool:
        """Whether it takes no more stones and counts, though some may have no outcome yet."""
        return self.state in (LotState.CLOSING, LotState.CLOSED)

    @property
    def is_final(self) -> bool:
        """Whether verdict and report of this very revision are said."""
        return self.completion is not None and self.completion.revision == self.revision


class LotConflictError(ProblemError):
    """Another lot is open, the lot exists already, or its state does not allow it."""

    kinds = (ProblemKind("lot-conflict", HTTPStatus.CONFLICT, "The lots do not allow this now"),)


class UnknownProductError(ProblemError):
    """There is no such product, or not this version of it."""

    kinds = (ProblemKind("unknown-product", HTTPStatus.NOT_FOUND, "No such product"),)


def open_lot(
    connection: sqlite3.Connection,
    definition: LotDefinition,
    product: str,
    version: int | None,
    who: str,
    closes: str | None = None,
) -> LotDocument:
    """Open a lot of a product, in the place of the open one that it `closes`; what falls from now on is in it.

    The same lot opened again while it is open is returned as it is. Raises `LotConflictError` if another lot is open,
    this one was opened before with other words, or is closed or void, or the name of another differs by capital letters
    alone; `UnknownProductError` if there is no such product, or not this version of it.
    """
    found = find_product(connection, product, version)
    if found is None:
        name = product if version is None else f"{product}, version {version}"
        raise UnknownProductError(f"there is no product {name}")
    existing = find_lot(connection, definition.lot)
    if existing is not None:
        same = (definition_of(existing), existing.product, existing.product_version)
        if existing.state is LotState.OPEN and same == (definition, product, found.version):
            return existing
        raise LotConflictError(f"lot {definition.lot} exists already and is {existing.state}")
    for alike in _lots(connection, "lot = ? COLLATE NOCASE", (definition.lot,), 1):
        raise LotConflictError(
            f"lot {alike.lot} differs by capital letters alone: its files would be the same"
        )
    for other in _lots(connection, "state = 'open'", (), 1):
        if other.lot != closes:
            raise LotConflictError(f"lot {other.lot} is open: close it first")
        close_lot(connection, other.lot, None, who)
    connection.execute(
        "INSERT INTO lots (lot, product, version, definition, opened_at, state) VALUES (?, ?, ?, ?, ?, 'open')",
        (definition.lot, product, found.version, json.dumps(asdict(definition)), utc_now()),
    )
    return _noted(connection, definition.lot, who, "lot opened", None, EventType.LOT_OPENED)


def close_lot(
    connection: sqlite3.Connection, lot: str, tonnage_t: float | None, who: str
) -> LotDocument | None:
    """Close a lot; what fell until now stays in it. A closed one is returned as it is; None if there is none."""
    before = find_lot(connection, lot)
    if before is None or before.is_closed:
        return before
    if before.state is LotState.VOID:
        raise LotConflictError(f"lot {lot} is void")
    definition = definition_of(before)
    if tonnage_t is not None:
        definition = replace(definition, tonnage_t=tonnage_t)
    connection.execute(
        "UPDATE lots SET state = 'closed', closed_at = ?, definition = ?, revision = revision + 1 WHERE lot = ?",
        (utc_now(), json.dumps(asdict(definition)), lot),
    )
    return _noted(connection, lot, who, "lot closed", before, EventType.LOT_CLOSED)


def void_lot(connection: sqlite3.Connection, lot: str, reason: str, who: str) -> LotDocument | None:
    """Declare a lot void: its figures count no more, and are kept. None if there is none."""
    before = find_lot(connection, lot)
    if before is None or before.state is LotState.VOID:
        return before
    connection.execute(
        "UPDATE lots SET state = 'void', void_reason = ?, closed_at = coalesce(closed_at, ?),"
        " revision = revision + 1 WHERE lot = ?",
        (reason, utc_now(), lot),
    )
    return _noted(connection, lot, who, "lot voided", before, EventType.LOT_VOIDED)


def assign(
    connection: sqlite3.Connection, lot: str, since: str, until: str, who: str
) -> tuple[LotDocument, int] | None:
    """Put what fell from `since` to before `until` outside of any lot into this one; return it, and how many these are.

    Stones of another lot stay there. None if there is no such lot.
    """
    before = find_lot(connection, lot)
    if before is None:
        return None
    if before.state is LotState.VOID:
        raise LotConflictError(f"lot {lot} is void")
    n_assigned, n_triggers = (
        connection.execute(
            f"UPDATE {table} SET lot = ? WHERE captured_at >= ? AND captured_at < ? AND lot IS NULL"  # noqa: S608 - of two
            " AND kind = 'particle'",
            (lot, since, until),
        ).rowcount
        for table in ("indexed_fields", "triggers")
    )
    details = {"since": since, "until": until, "n_stones": n_assigned}
    audit.note(connection, who, "stones assigned", lot, after=details)
    if n_assigned or n_triggers:  # of which some may have no outcome yet
        _revise_closed(connection, lot)
        _note_event(connection, EventType.LOT_ASSIGNED, existing_lot(connection, lot))
    return existing_lot(connection, lot), n_assigned


def note_revised(connection: sqlite3.Connection, lot: str) -> None:
    """Note within a transaction that a stone of a lot was measured again: a closed lot says something else now."""
    if _revise_closed(connection, lot):
        _note_event(connection, EventType.LOT_REVISED, existing_lot(connection, lot))


def uncompleted_lots(connection: sqlite3.Connection) -> dict[str, bool]:
    """Return the closed lots whose revision is not completed, oldest first; True: it can be.

    All its stones have outcomes then, and none was measured again within `REST_S`: a whole lot that is comes to one
    revision after the other.
    """
    found = _lots(connection, "state = 'closed' AND completed_revision < revision", (), MOST_RUNS)[::-1]
    recent = connection.execute(
        "SELECT subject FROM events WHERE seq > (SELECT last_event FROM store) - ? AND type = ? AND at > ?",
        (MOST_RUNS, EventType.LOT_REVISED, rfc3339(datetime.now(UTC) - timedelta(seconds=REST_S))),
    )
    revised = {lot for (lot,) in recent}
    return {each.lot: each.state is LotState.CLOSED and each.lot not in revised for each in found}


def complete_lot(
    connection: sqlite3.Connection, lot: str, completion: LotCompletion, figures: Mapping[str, Any]
) -> None:
    """Note within a transaction that a revision of a closed lot is final; nothing happens if it has changed since.

    `figures` are those that control charts follow, as JSON has them.
    """
    completed = connection.execute(
        "UPDATE lots SET completed_revision = ?1, completion = ?2, figures = ?4"
        " WHERE lot = ?3 AND state = 'closed' AND revision = ?1",
        (completion.revision, completion.model_dump_json(), lot, json.dumps(figures)),
    )
    if completed.rowcount:
        after = existing_lot(connection, lot)
        _note_event(connection, EventType.LOT_COMPLETED, after)
        if completion.verdict is Verdict.DOES_NOT_CONFORM:
            _note_event(connection, EventType.LOT_DOES_NOT_CONFORM, after)


def reach_verdict(connection: sqlite3.Connection, lot: str, reached: ReachedVerdict) -> None:
    """Note within a transaction that an open lot has a verdict; nothing happens if it has this one already."""
    noted = connection.execute(
        "UPDATE lots SET reached = ?1 WHERE lot = ?2 AND state = 'open' AND reached ->> 'verdict' IS NOT ?3",
        (reached.model_dump_json(), lot, reached.verdict),
    )
    if noted.rowcount:
        _note_event(connection, EventType.LOT_VERDICT_REACHED, existing_lot(connection, lot))


def _revise_closed(connection: sqlite3.Connection, lot: str) -> bool:
    update = "UPDATE lots SET revision = revision + 1 WHERE lot = ? AND state = 'closed'"
    return connection.execute(update, (lot,)).rowcount > 0


def find_lot(connection: sqlite3.Connection, lot: str) -> LotDocument | None:
    """Return a lot, None if there is none."""
    return next(iter(_lots(connection, "lot = ?", (lot,), 1)), None)


def lots_of_sample(connection: sqlite3.Connection, sample_id: str) -> list[LotDocument]:
    """Return the lots with this sample id, oldest first."""
    return _lots(connection, "definition ->> 'sample_id' = ?", (sample_id,), MOST_RUNS)[::-1]


class ClosedLot(Report):
    """The lot that was closed last, in short."""

    lot: str = Field(description="Material lot")
    product: str = Field(description="Id of its product")
    closed_at: Time = Field(description="When it was closed, RFC 3339 UTC")
    completion: LotCompletion | None = Field(
        description="Verdict and report of its last revision that was completed; null before the first"
    )


def newest_closed(connection: sqlite3.Connection) -> ClosedLot | None:
    """Return the lot that was closed last and is not void, None if there is none."""
    row = connection.execute(
        "SELECT lot, product, closed_at, completion FROM lots WHERE state = 'closed'"
        " ORDER BY closed_at DESC, opened_at DESC LIMIT 1"
    ).fetchone()
    if row is None:
        return None
    *facts, completion = row
    found = None if completion is None else LotCompletion.model_validate_json(completion)
    return ClosedLot(**dict(zip(("lot", "product", "closed_at"), facts, strict=True)), completion=found)


class LotChoice(BaseModel):
    """Lots that are asked for; what is absent holds for any."""

    state: LotState | None = Field(default=None, description="Only lots in this state")
    product: Annotated[str | None, Field(max_length=64)] = Field(
        default=None, description="Only lots of this product"
    )
    external_id: Given = Field(default=None, description="Only lots with this id in the plant's own system")
    order: Given = Field(default=None, description="Only lots of this order")
    customer: Given = Field(default=None, description="Only lots of this customer")
    search: Given = Field(
        default=None,
        pattern=r"^[^\n]*$",
        description="Only lots with this in their id, product, `external_id`, `order` or `customer`; a to z and A"
        " to Z are alike",
    )
    before: GivenTime | None = Field(default=None, description="Opened before, RFC 3339")


SAID = {name: f"definition ->> '{name}'" for name in ("external_id", "order", "customer")}
"""What the plant says of a lot and finds it by, in SQL."""
SEARCHED = " || char(10) || ".join(("lot", "product", *(f"coalesce({said}, '')" for said in SAID.values())))
CONDITIONS = {
    "state": "shown_state = ?",
    "product": "product = ?",
    "before": "opened_at < ?",
    **{name: f"{said} = ?" for name, said in SAID.items()},
    "search": f"instr(lower({SEARCHED}), lower(?)) > 0",
}
"""Condition of each field of `LotChoice`."""


def lots(connection: sqlite3.Connection, choice: LotChoice, limit: int) -> list[LotDocument]:
    """Return up to `limit` lots that fit, newest first."""
    given = {
        CONDITIONS[name]: value
        for name, value in choice.model_dump(include=set(CONDITIONS)).items()
        if value is not None
    }
    return _lots(connection, " AND ".join(given) or "TRUE", tuple(given.values()), limit)


def _lots(
    connection: sqlite3.Connection, condition: str, values: tuple[object, ...], limit: int
) -> list[LotDocument]:
    rows = connection.execute(
        "SELECT definition, shown_state AS state, product, version AS product_version, opened_at, closed_at,"  # noqa: S608 - of this module
        " void_reason, revision, completion, reached, in_progress,"
        " (SELECT coalesce(sum(n_stones), 0) FROM stones WHERE stones.lot = shown.lot) AS n_stones"
        " FROM (SELECT *, iif(state = 'closed' AND in_progress > 0, 'closing', state) AS shown_state FROM (SELECT *,"
        " (SELECT coalesce(sum(n), 0) FROM triggers WHERE triggers.state = 'open' AND triggers.lot = lots.lot)"
        f" AS in_progress FROM lots)) AS shown WHERE {condition} ORDER BY opened_at DESC, lot LIMIT ?",
        (*values, limit),
    )
    return [_document(**row) for row in rows_by_name(rows)]


def _document(definition: str, completion: str | None, reached: str | None, **row: Any) -> LotDocument:
    return LotDocument(
        **asdict(LotDefinition(**json.loads(definition))),
        completion=None if completion is None else LotCompletion.model_validate_json(completion),
        reached=None if reached is None else ReachedVerdict.model_validate_json(reached),
        **row,
    )


def definition_of(lot: LotDocument | LotDefinition) -> LotDefinition:
    """Return the definition of a lot, without what became of it."""
    return LotDefinition(**{each.name: getattr(lot, each.name) for each in fields(LotDefinition)})


def facts_of(lot: LotDocument) -> dict[str, Any]:
    """Return a lot as the audit and the events have it."""
    facts = lot.model_dump()
    return facts | {"version": facts.pop("product_version")}


def existing_lot(connection: sqlite3.Connection, lot: str) -> LotDocument:
    """Return a lot that there is."""
    return _lots(connection, "lot = ?", (lot,), 1)[0]


def _noted(
    connection: sqlite3.Connection,
    lot: str,
    who: str,
    action: str,
    before: LotDocument | None,
    event: EventType,
) -> LotDocument:
    """Note a change of a lot in the audit and among the events, and return the lot as it is now."""
    after = existing_lot(connection, lot)
    facts = None if before is None else _audited(before)
    audit.note(connection, who, action, lot, before=facts, after=_audited(after))
    _note_event(connection, event, after)
    return after


def _audited(lot: LotDocument) -> dict[str, Any]:
    """Return a lot as the audit has it: what the plant says of it is a part of its own."""
    definition = asdict(definition_of(lot))
    facts = {name: value for name, value in facts_of(lot).items() if name not in definition}
    return {"definition": definition, **facts}


def _note_event(connection: sqlite3.Connection, event: EventType, lot: LotDocument) -> None:
    note_event(connection, NewEvent(type=event, subject=lot.lot, data=facts_of(lot)))
