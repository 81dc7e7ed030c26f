"""Watch windows, lenses and light by the optics of each camera, exposure after exposure.

Every result, and every exposure of the empty rig, has the optics of each camera
(`pipeline.segmentation.optics`). Dust and fading light come slowly: at half of a limit cleaning is due
(*maintenance required*), at the limit results are less certain than specified (*out of specification*).
Whether a view is used is decided for each stone alone, by the pipeline, never here.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from math import hypot, sqrt
from statistics import fmean, median
from typing import Any

from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base.camera_status import CameraOptics
from service.base.messages import Code, CodedText, message
from service.base.status import Checks, trouble_check
from service.health.dark_panels import DarkPlace, ViewLight, dark_places
from service.health.findings import CameraFinding, Severity, described
from service.results.fields import Result

WINDOW = 20
"""Latest exposures over which medians are taken."""
MIN_EXPOSURES = 5
"""Fewest exposures with a meaningful median."""
MAINTENANCE_SHARE = 0.5
"""Share of a limit from which maintenance is required."""
HYSTERESIS = 0.9
"""Share of the value that raised an alarm below which the alarm ends, because figures scatter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticalParameters:
    """Limits at which a camera is out of specification; at half of each, maintenance is required."""

    light_change: float = 0.3  # of the plain wall's brightness, against the clean rig
    gradient: float = 0.5  # the same from border to border of the view
    flicker: float = 0.1  # standard deviation of the brightness from exposure to exposure
    dust: float = 0.1  # share of the light lost on average, against the clearest part of the view
    spots_share: float = 0.05  # of the view, darker than its surroundings
    saturated_share: float = 0.02  # of all pixels
    noise_grey: float = 8.0  # the design's is 2
    edge_width_px: float = 12.0  # of a stone's outline, 10 to 90 %, on its wider axis; 2.5 at F8, 3-4 at F2

    def __post_init__(self) -> None:
        for limit in fields(self):
            if not getattr(self, limit.name) > 0:
                raise ValueError(f"{limit.name} must be positive, not {getattr(self, limit.name):g}")


LIGHT_CHANGE, GRADIENT = "light_change", "gradient"
"""Limits of the light, whose findings are composed by geometry, see `dark_panels`."""
EDGE_WIDTH = "edge_width_px"
AXES = ("edge_width_u_px", "edge_width_v_px")
"""Widths of outlines across each axis of the image; a sharp outline has one width."""
CODES = {
    "flicker": (Code.LIGHT_FLICKERS, "percent", 100),
    "dust": (Code.DUSTY, "percent", 100),
    "spots_share": (Code.SPOTS, "percent", 100),
    "saturated_share": (Code.SATURATED, "percent", 100),
    "noise_grey": (Code.NOISY, "noise_grey", 1),
    EDGE_WIDTH: (Code.BLURRED, "width_px", 1),
}
"""By the name of the limit: the code of its finding, its parameter, and how many of its units are 1."""
MOTION_RATIO = 1.4
"""Ratio of the widths of outlines along the two axes of the image from which it is motion: a lens blurs both alike."""


@dataclass(slots=True)
class _Camera:
    series: dict[str, deque[float]] = field(default_factory=dict)
    optics: CameraOptics = field(default_factory=CameraOptics)  # medians of the series
    severities: dict[str, Severity] = field(default_factory=dict)  # by limit

    def add(self, figures: Mapping[str, Any], limits: OpticalParameters) -> None:
        """Take the figures of one exposure into account."""
        gradient_u, gradient_v = figures["gradient_uv"]
        width_px = figures[EDGE_WIDTH]
        named = {**figures, "gradient_u": gradient_u, "gradient_v": gradient_v}
        named |= dict(zip(AXES, named.pop("edge_widths_uv_px", None) or (width_px, width_px), strict=True))
        for name, value in named.items():
            if name != "gradient_uv" and value is not None:
                self.series.setdefault(name, deque(maxlen=WINDOW)).append(value)
        typical = {name: median(seen) for name, seen in self.series.items() if len(seen) >= MIN_EXPOSURES}
        self.optics = CameraOptics(**typical, flicker=_flicker(self.series.get("brightness", ())))
        for name, value in self.limited_figures().items():
            share = value / getattr(limits, name)
            self.severities[name] = _severity(share, self.severities.get(name, Severity.NOTHING))

    def limited_figures(self) -> dict[str, float]:
        """Return the figures that have a limit, by the name of the limit."""
        optics = self.optics
        figures = {name: value for name in CODES if (value := getattr(optics, name)) is not None}
        if EDGE_WIDTH in figures:
            figures[EDGE_WIDTH] = max(figures[EDGE_WIDTH], *self.widths_px())
        if (light := _light(optics)) is not None:
            figures |= {LIGHT_CHANGE: abs(1 - light.brightness), GRADIENT: hypot(*light.gradient_uv)}
        return figures

    def widths_px(self) -> tuple[float, float]:
        """Return the widths of outlines along the wider and the narrower axis of the image; 0 while unknown."""
        u_px, v_px = (getattr(self.optics, axis) or 0.0 for axis in AXES)
        return max(u_px, v_px), min(u_px, v_px)

    def detail(self, limit: str) -> CodedText:
        """Describe a figure that has reached its limit, with the remedy."""
        wide_px, narrow_px = self.widths_px()
        if limit == EDGE_WIDTH and wide_px > MOTION_RATIO * narrow_px > 0:
            return message(Code.BLURRED_BY_MOTION, wide_px=wide_px, narrow_px=narrow_px)
        code, name, factor = CODES[limit]
        return message(code, **{name: factor * self.limited_figures()[limit]})

    def severity(self, *limits: str) -> Severity:
        """Return the worst severity among these limits."""
        return max(self.severities.get(limit, Severity.NOTHING) for limit in limits)


class OpticalWatch:
    """Watches the optics of all cameras: feed it all results and all exposures of the empty rig, in their order."""

    def __init__(self, rig: RigCalibration, limits: OpticalParameters) -> None:
        self._rig = rig  # the configured one, for any calibration has the same neighbours
        self._limits = limits
        self._cameras = {camera.id: _Camera() for camera in rig.cameras}

    def use(self, limits: OpticalParameters) -> None:
        """Take other limits from the next exposure on."""
        self._limits = limits

    def checks(self) -> Checks:
        """Check how well the cameras see: windows, lenses and light."""
        findings, n_cameras = self.findings(), len(self._cameras)
        n_clear = n_cameras - len({camera for finding in findings for camera in finding.cameras})
        return {"optics": trouble_check(described(findings, n_cameras), n_clear, "cameras")}

    def feed(self, record: Result) -> None:
        """Take one result into account."""
        self.feed_optics({name: asdict(seen) for name, seen in record.optics.items()})

    def feed_optics(self, optics: Mapping[str, Mapping[str, Any]]) -> None:
        """Take the optics of one exposure into account, as `service.results.record.optics_record` writes them."""
        for name, camera in self._cameras.items():
            if name in optics:
                camera.add(optics[name], self._limits)

    def optics(self) -> dict[CameraId, CameraOptics]:
        """Return the optics of every camera of the rig."""
        return {name: camera.optics for name, camera in self._cameras.items()}

    def findings(self) -> tuple[CameraFinding, ...]:
        """Return the findings that need an operator, worst first."""
        found = self._light_findings()
        for limit in CODES:
            found += self._limit_findings(limit)
        return tuple(sorted(found, key=lambda finding: -finding.severity))

    def _limit_findings(self, limit: str) -> list[CameraFinding]:
        """Return one finding for each camera beyond a limit, or one for all if most are: the cause is common then."""
        values = {
            name: camera.limited_figures()[limit]
            for name, camera in self._cameras.items()
            if camera.severity(limit)
        }
        worst_first = sorted(values, key=lambda name: -values[name])
        groups = [worst_first] if self._are_most(values) else [[name] for name in worst_first]
        return [
            CameraFinding(
                cameras=tuple(group),
                severity=max(self._cameras[name].severity(limit) for name in group),
                detail=self._cameras[group[0]].detail(limit),
            )
            for group in groups
        ]

    def _light_findings(self) -> list[CameraFinding]:
        """Return where the light has changed: everywhere, on a part of the wall, or for single cameras."""
        changed = {
            name: severity
            for name, camera in self._cameras.items()
            if (severity := camera.severity(LIGHT_CHANGE, GRADIENT))
        }
        lights = {
            name: light for name in self._cameras if (light := _light(self._cameras[name].optics)) is not None
        }
        if self._are_most(changed):
            detail = self._describe_change(lights, changed, "_all")
            return [CameraFinding(cameras=tuple(changed), severity=max(changed.values()), detail=detail)]
        found = []
        for place in dark_places(self._rig, lights):
            alarmed = [changed.pop(name) for name in place.cameras if name in changed]
            if alarmed:
                found.append(
                    CameraFinding(cameras=place.cameras, severity=max(alarmed), detail=_describe_place(place))
                )
        for name, severity in changed.items():
            detail = self._describe_change(lights, [name])
            found.append(CameraFinding(cameras=(name,), severity=severity, detail=detail))
        return found

    def _describe_change(
        self, lights: Mapping[CameraId, ViewLight], cameras: Collection[CameraId], of: str = ""
    ) -> CodedText:
        """Describe which limits of the light these cameras have passed, with the median figure of each."""
        changes: list[str] = []
        figures: dict[str, float] = {}
        if any(self._cameras[name].severity(LIGHT_CHANGE) for name in cameras):
            changes.append("changed")
            figures["percent"] = 100 * (median(lights[name].brightness for name in cameras) - 1)
        if any(self._cameras[name].severity(GRADIENT) for name in cameras):
            changes.append("tilted")
            figures["slope_percent"] = 100 * median(hypot(*lights[name].gradient_uv) for name in cameras)
        return message(Code(f"light_{'_and_'.join(changes)}{of}"), **figures)

    def _are_most(self, cameras: Collection[CameraId]) -> bool:
        return 2 * len(cameras) > len(self._cameras)


def _severity(share: float, before: Severity) -> Severity:
    """Return the severity of a figure that has reached this share of its limit; alarms end with hysteresis."""
    for severity, raised_at in (
        (Severity.OUT_OF_SPECIFICATION, 1.0),
        (Severity.MAINTENANCE, MAINTENANCE_SHARE),
    ):
        if share >= raised_at * (HYSTERESIS if before >= severity else 1):
            return severity
    return Severity.NOTHING


def _light(optics: CameraOptics) -> ViewLight | None:
    if optics.brightness is None or optics.gradient_u is None or optics.gradient_v is None:
        return None
    return ViewLight(optics.brightness, (optics.gradient_u, optics.gradient_v))


def _flicker(brightness: Sequence[float]) -> float | None:
    """Return the standard deviation from exposure to exposure, without the largest step: one step is no flicker."""
    if len(brightness) < MIN_EXPOSURES:
        return None
    steps = sorted(abs(after - before) for before, after in pairwise(brightness))[:-1]
    return sqrt(fmean([step**2 for step in steps]) / 2) / max(fmean(brightness), 0.01)


def _describe_place(place: DarkPlace) -> CodedText:
    percent = 100 * place.loss
    if len(place.cameras) == 1:
        return message(Code.CAMERA_DARKER, percent=percent)
    where = {"azimuth_deg": place.azimuth_deg, "elevation_deg": place.elevation_deg}
    return message(Code.WALL_DARKER, percent=percent, **where)
