"""Control charts of a product: its completed lots are the points, each with the figures that it was completed with."""

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import fmean

from pydantic import TypeAdapter

from drivers.files.times import utc_now
from pipeline.gradation.capability import capability
from pipeline.gradation.control_chart import (
    SIGMAS,
    Baseline,
    ControlChart,
    RuleName,
    Violation,
    baseline_of,
    control_chart,
)
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.specification import Range
from service.base.errors import InvalidRequestError
from service.lots.figures import SHARES, LotFigures, named_figures
from service.lots.products import Product, ProductDefinition, find_product
from service.lots.trends.control_documents import (
    Causes,
    ControlLimits,
    ControlPoint,
    ControlSettings,
    DriftedFigure,
    FigureControl,
    Origin,
    ProductControl,
    ProductDrift,
)
from service.lots.trends.diary import DiaryEntry, entries
from service.lots.trends.trend import ends_mm
from service.lots.yardsticks import Request, yardstick_of
from service.store import audit
from service.store.events import EventType, NewEvent
from service.store.schema import rows_by_name

N_BASELINE = 20
"""Lots whose figures make the limits, the first that count; before there are so many nothing is told to drift."""
MAX_FIRST, MAX_NEWEST = 100, 400
"""Lots that are looked at: the first, of which the limits come, and the newest."""
MAX_CAUSES = 500
"""Entries of the diary, and events, that causes are looked for among, the newest."""
TELLING = frozenset({RuleName.BEYOND_LIMITS, RuleName.EWMA})
"""Rules that make a product drift. The others mark points of the chart: with all of Western Electric's, false
alarms would be four times as many as with the limits alone (Champ and Woodall, Technometrics 29, 1987)."""
CAUSES = (EventType.ALARM_RAISED, EventType.CALIBRATION_ACTIVATED)
PRODUCT_CHECKS = (CONFORMITY, DRIFT, FEED) = ("conformity", "drift", "feed")
"""Checks of health that are about the product, and no cause of anything."""


class UnknownFigureError(InvalidRequestError):
    """The product's lots have no such figure; names those that they have."""


SETTINGS = TypeAdapter(ControlSettings)
FIGURES = TypeAdapter(dict[str, Estimate])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lot:
    lot: str
    opened_at: str
    closed_at: str
    figures: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Happened:
    """Candidates for a cause, newest first."""

    diary: Sequence[DiaryEntry]
    events: Sequence[NewEvent]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Chart:
    """A figure of lots: those that count, their limits, and what they violate."""

    name: str
    lots: Sequence[_Lot]  # all that have the figure, oldest first
    counted: Mapping[int, int]  # place of a lot -> place in `chart`
    n_baseline: int
    baseline: Baseline | None
    chart: ControlChart | None

    @property
    def newest(self) -> tuple[Estimate, list[RuleName]] | None:
        """The newest lot that counts, and the rules that make it drift; None without one beyond the baseline."""
        place = len(self.counted) - 1
        if self.chart is None or place < (N_BASELINE if self.n_baseline else 0):
            return None
        lot = self.lots[next(reversed(self.counted))]
        rules = [each.rule for each in self.chart.violations if each.place == place and each.rule in TELLING]
        return lot.figures[self.name], rules


def followed_figures(figures: LotFigures, definition: ProductDefinition) -> dict[str, Estimate]:
    """Return the figures of a lot that charts follow, by name."""
    named = named_figures(figures)
    return {name: named[name] for name in _names(definition, [step.sieve_mm for step in figures.curve])}


def _names(definition: ProductDefinition, apertures_mm: Sequence[float]) -> list[str]:
    sieves_mm = dict.fromkeys(ends_mm(definition, apertures_mm).values())
    return ["d50_mm", *(f"passing_{each:g}_mm_percent" for each in sieves_mm), *SHARES]


def save_settings(
    connection: sqlite3.Connection, product: Product, settings: ControlSettings, who: str
) -> ControlSettings:
    """Set the limits of a product's charts; raise `UnknownFigureError` for a figure that its lots do not have."""
    known = _names(product, yardstick_of(product, Request()).apertures_mm)
    for name in settings.limits:
        if name not in known:
            raise UnknownFigureError(f"body.limits: there is no {name!r}; there are {', '.join(known)}")
    before, after = (asdict(each) for each in (settings_of(connection, product.product), settings))
    if after != before:
        connection.execute(
            "INSERT OR REPLACE INTO control_settings VALUES (?, ?)", (product.product, json.dumps(after))
        )
        audit.note(connection, who, "control limits", product.product, before=before, after=after)
    return settings


def settings_of(connection: sqlite3.Connection, product: str) -> ControlSettings:
    """Return the settings of a product's charts."""
    row = connection.execute("SELECT document FROM control_settings WHERE product = ?", (product,)).fetchone()
    return ControlSettings() if row is None else SETTINGS.validate_json(row[0])


def product_control(
    connection: sqlite3.Connection, product: str, measured: MeasuredRange, limit: int
) -> ProductControl | None:
    """Return the control charts of a product with their newest points, None if there is no such product.

    Raises `UnknownYardstickError` as `yardstick_of` does.
    """
    found = find_product(connection, product)
    if found is None:
        return None
    yardstick = yardstick_of(found, Request(measured=measured))
    specification = yardstick.specification
    specified: dict[str, Range | None] = {}
    if specification is not None:
        specified = {f"passing_{each:g}_mm_percent": limits for each, limits in specification.passing.items()}
        specified |= {"flakiness_percent": specification.flakiness, "shape_percent": specification.shape}
    settings = settings_of(connection, product)
    charts = _charts(connection, product, settings)
    happened = _happened(connection, min((chart.lots[0].opened_at for chart in charts), default=utc_now()))
    if not charts:
        names = _names(found, yardstick.apertures_mm)
        charts = [_chart(name, (), settings.limits.get(name)) for name in names]
    return ProductControl(
        product=product,
        settings=settings,
        drifting=_drifted(charts),
        charts=[
            _figure_control(
                chart,
                list(_points(chart, happened))[-limit:],
                specified.get(chart.name),
                is_by_hand=chart.name in settings.limits,
            )
            for chart in charts
        ],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LotLimits:
    """Control limits of a product's lots, as the newest that counts has them, in the unit of the figure."""

    lower: float
    centre: float
    upper: float


def lot_limits(connection: sqlite3.Connection, product: str, figure: str) -> LotLimits | None:
    """Return the control limits of a figure of a product, None without limits."""
    charts = _charts(connection, product, settings_of(connection, product))
    chart = next((each for each in charts if each.name == figure), None)
    if chart is None or chart.chart is None or chart.baseline is None or not chart.counted:
        return None
    centre, reach = chart.baseline.centre, SIGMAS * float(chart.chart.sds[-1])
    return LotLimits(lower=centre - reach, centre=centre, upper=centre + reach)


def product_alarms(connection: sqlite3.Connection, since: str, until: str) -> list[str]:
    """Return the times at which alarms about a product were raised, oldest first, as far as events are kept."""
    rows = connection.execute(
        "SELECT at FROM events WHERE at >= ? AND at <= ? AND type = ? AND subject IN (?, ?, ?) ORDER BY seq",
        (since, until, EventType.ALARM_RAISED, *PRODUCT_CHECKS),
    )
    return [at for (at,) in rows]


def product_drift(connection: sqlite3.Connection, product: str) -> ProductDrift | None:
    """Return the figures of a product that drift, None if none does."""
    drifted = _drifted(_charts(connection, product, settings_of(connection, product)))
    return ProductDrift(product=product, figures=drifted) if drifted else None


def _drifted(charts: Sequence[_Chart]) -> list[DriftedFigure]:
    return [
        DriftedFigure(figure=chart.name, value=figure.value, centre=chart.baseline.centre, rules=rules)
        for chart in charts
        if chart.baseline is not None and (newest := chart.newest) is not None
        for figure, rules in [newest]
        if rules and figure.value is not None
    ]


def _charts(connection: sqlite3.Connection, product: str, settings: ControlSettings) -> list[_Chart]:
    lots = _completed_lots(connection, product, settings.since or "")
    names = lots[-1].figures if lots else ()
    return [_chart(name, lots, settings.limits.get(name)) for name in names]


def _completed_lots(connection: sqlite3.Connection, product: str, since: str) -> list[_Lot]:
    """Return the first and the newest lots with figures, oldest first; void ones are left out."""
    lots = (
        "SELECT lot, opened_at, closed_at, figures FROM lots"
        " WHERE product = ?1 AND state = 'closed' AND closed_at >= ?2 AND figures IS NOT NULL"
    )
    rows = connection.execute(
        f"SELECT * FROM ({lots} ORDER BY closed_at, lot LIMIT ?3) UNION"  # noqa: S608 - constant
        f" SELECT * FROM ({lots} ORDER BY closed_at DESC, lot DESC LIMIT ?4)"
        " ORDER BY closed_at, lot",
        (product, since, MAX_FIRST, MAX_NEWEST),
    )
    return [_Lot(**row | {"figures": FIGURES.validate_json(row["figures"])}) for row in rows_by_name(rows)]


def _chart(name: str, lots: Sequence[_Lot], by_hand: ControlLimits | None) -> _Chart:
    """Return the chart of a figure.

    Limits are as wide as a lot's number of stones asks for: to the scatter from lot to lot is added the error of
    sampling, and of each stone's measuring, that the first lots had, by effective numbers of stones. Its own error
    would not do: where little passes it is small because little passes. Systematic errors, which lots share, are out.
    """
    lots = [lot for lot in lots if name in lot.figures]
    places = [place for place, lot in enumerate(lots) if lot.figures[name].state is State.MEASURED]
    figures = [lots[place].figures[name] for place in places]
    values = [figure.value or 0.0 for figure in figures]
    first = figures[:N_BASELINE]
    variances = [(each.errors.sampling**2 + each.errors.measuring**2) * each.n_effective for each in first]
    errors = [(fmean(variances) / each.n_effective) ** 0.5 for each in figures]
    if by_hand is None:
        baseline = baseline_of(values[:N_BASELINE], errors[:N_BASELINE])
    else:
        baseline = Baseline(by_hand.centre, by_hand.sd)
    return _Chart(
        name=name,
        lots=lots,
        counted={place: number for number, place in enumerate(places)},
        n_baseline=min(len(values), N_BASELINE) if by_hand is None and baseline is not None else 0,
        baseline=baseline,
        chart=None if baseline is None else control_chart(values, baseline, errors),
    )


def _figure_control(
    chart: _Chart, points: list[ControlPoint], specified: Range | None, *, is_by_hand: bool
) -> FigureControl:
    baseline = chart.baseline
    origin = Origin.BY_HAND if is_by_hand else Origin.FIRST_LOTS
    values = [chart.lots[place].figures[chart.name].value or 0.0 for place in chart.counted]
    lower, upper = _ends(specified)
    return FigureControl(
        figure=chart.name,
        origin=None if baseline is None else origin,
        n_baseline=chart.n_baseline,
        centre=None if baseline is None else baseline.centre,
        sd=None if baseline is None else baseline.sd,
        specified=specified,
        capability=capability(values, lower, upper),
        points=points,
    )


def _ends(specified: Range | None) -> tuple[float | None, float | None]:
    """Return the limits that can be missed: 0 and 100 % are none."""
    if specified is None:
        return None, None
    lower, upper = specified.min_percent, specified.greatest_percent
    return (lower if lower > 0 else None), (upper if upper < 100 else None)


def _points(chart: _Chart, happened: _Happened) -> Iterator[ControlPoint]:
    for place, lot in enumerate(chart.lots):
        number = chart.counted.get(place)
        limits = dict.fromkeys(("lower", "upper", "ewma", "ewma_lower", "ewma_upper"))
        violated: list[Violation] = []
        if chart.chart is not None and chart.baseline is not None and number is not None:
            found, centre = chart.chart, chart.baseline.centre
            reach, ewma_reach = SIGMAS * found.sds[number], found.ewma_reach[number]
            limits = {"lower": centre - reach, "upper": centre + reach, "ewma": found.ewma[number]}
            limits |= {"ewma_lower": centre - ewma_reach, "ewma_upper": centre + ewma_reach}
            violated = [each for each in found.violations if each.place == number]
        yield ControlPoint(
            lot=lot.lot,
            closed_at=lot.closed_at,
            figure=lot.figures[chart.name],
            is_counted=number is not None,
            **limits,
            rules=[each.rule for each in violated],
            causes=_causes(chart, violated, happened) if violated else None,
        )


def _causes(chart: _Chart, violated: Sequence[Violation], happened: _Happened) -> Causes:
    """Return the candidates for a cause, since the last lot in control before the pattern."""
    lots = [chart.lots[place] for place in chart.counted]
    out = set() if chart.chart is None else {each.place for each in chart.chart.violations}
    before = min(each.began for each in violated) - 1
    while before in out:
        before -= 1
    since = lots[before].closed_at if before >= 0 else lots[0].opened_at
    until = lots[violated[0].place].closed_at
    return Causes(
        since=since,
        until=until,
        diary=[each for each in happened.diary if since < each.at <= until],
        events=[each for each in happened.events if since < each.at <= until],
    )


def _happened(connection: sqlite3.Connection, since: str) -> _Happened:
    rows = connection.execute(
        "SELECT at, type, subject, data FROM events"
        " WHERE at > ? AND type IN (?, ?) AND subject NOT IN (?, ?, ?) ORDER BY seq DESC LIMIT ?",
        (since, *CAUSES, *PRODUCT_CHECKS, MAX_CAUSES),
    )
    events = [
        NewEvent(at=at, type=EventType(kind), subject=subject, data=json.loads(data))
        for at, kind, subject, data in rows
    ]
    return _Happened(diary=entries(connection, since, None, MAX_CAUSES), events=events)
