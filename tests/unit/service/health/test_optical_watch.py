"""What the watch makes of the figures, one exposure after the other."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from support.outcomes import result

from pipeline.frames import CameraId
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.disturbance import Disturbance, dimmed_sector
from service.health.dark_panels import ViewLight, dark_places
from service.health.findings import CameraFinding, Severity
from service.health.optical_watch import (
    MIN_EXPOSURES,
    WINDOW,
    OpticalParameters,
    OpticalWatch,
)

RIG = as_built(nominal_rig(), seed=3)
C05 = CameraId("c05")
CLEAN = {
    "brightness": 1.0,
    "gradient_uv": [0.0, 0.0],
    "dust": 0.004,
    "spots_share": 0.0,
    "saturated_share": 0.0,
    "noise_grey": 2.0,
    "edge_width_px": 2.5,
    "contrast": 0.7,
}


def exposure(others: Mapping[str, Any] | None = None, **of: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Figures of all cameras: clean but for what is named, of a camera or of all the `others`."""
    return {name: CLEAN | dict(of.get(name, others or {})) for name in RIG.camera_ids}


def watching() -> OpticalWatch:
    return OpticalWatch(RIG, OpticalParameters())


def after(*exposures: dict[str, dict[str, Any]]) -> OpticalWatch:
    watch = watching()
    for each in exposures:
        watch.feed_optics(each)
    return watch


def the_finding(watch: OpticalWatch) -> CameraFinding:
    (finding,) = watch.findings()
    return finding


def test_a_clean_rig_has_no_findings() -> None:
    rng = np.random.default_rng(1)
    watch = after(*(exposure({"brightness": 1 + 0.01 * rng.normal()}) for _ in range(100)))
    assert not watch.findings()
    optics = watch.optics()[C05]
    assert optics.brightness == pytest.approx(1, abs=0.01)
    assert optics.flicker == pytest.approx(0.01, rel=0.4)
    assert (optics.dust, optics.noise_grey, optics.edge_width_px) == (0.004, 2.0, 2.5)


def test_few_exposures_are_no_opinion() -> None:
    dusty = exposure(c05={"dust": 0.2})
    watch = after(*[dusty] * (MIN_EXPOSURES - 1))
    assert not watch.findings()
    assert watch.optics()[C05].dust is None
    watch.feed_optics(dusty)  # of the empty rig
    assert the_finding(watch).cameras == (C05,)


def test_results_without_figures_teach_nothing() -> None:
    watch = after(*[exposure()] * MIN_EXPOSURES)
    watch.feed(result(outcome="lost"))
    watch.feed_optics({})
    assert watch.optics()[C05].dust == 0.004


@pytest.mark.parametrize(
    ("figure", "limit", "words"),
    [
        ("dust", 0.1, "light is lost in patches: clean window and lens"),
        ("spots_share", 0.05, "clean window and wall"),
        ("saturated_share", 0.02, "saturated"),
        ("noise_grey", 8.0, "noisy"),
        ("edge_width_px", 12.0, "look at focus"),
    ],
)
def test_maintenance_is_asked_for_at_half_of_a_limit_and_before_it(
    figure: str, limit: float, words: str
) -> None:
    for share, severity in (
        (0.45, None),
        (0.55, Severity.MAINTENANCE),
        (1.05, Severity.OUT_OF_SPECIFICATION),
    ):
        watch = after(*[exposure(c05={figure: share * limit})] * MIN_EXPOSURES)
        if severity is None:
            assert not watch.findings()
            continue
        finding = the_finding(watch)
        assert (finding.cameras, finding.severity) == ((C05,), severity)
        assert words in finding.detail


@pytest.mark.parametrize(
    ("across_uv", "words"),
    [
        ([13.0, 12.5], "outlines are 13.0 px wide: look at focus"),
        ([2.6, 13.0], "13.0 px wide along one axis of the image, 2.6 along the other: stones move too far"),
        ([13.0, 2.6], "look at the strobe and the exposure time"),
        (None, "outlines are 12.5 px wide: look at focus"),
    ],
)
def test_motion_is_told_from_a_lens_out_of_focus(across_uv: list[float] | None, words: str) -> None:
    blurred = {"edge_width_px": 12.5 if across_uv is None else 5.0, "edge_widths_uv_px": across_uv}
    finding = the_finding(after(*[exposure(c05=blurred)] * MIN_EXPOSURES))
    assert (finding.cameras, finding.severity) == ((C05,), Severity.OUT_OF_SPECIFICATION)
    assert words in finding.detail


def test_an_alarm_at_its_limit_does_not_come_and_go() -> None:
    watch = after(*[exposure(c05={"dust": 0.051})] * WINDOW)
    told = []
    for number in range(10 * WINDOW):
        watch.feed_optics(exposure(c05={"dust": 0.047 if number // WINDOW % 2 else 0.052}))
        told.append(len(watch.findings()))
    assert set(told) == {1}
    for _ in range(WINDOW):
        watch.feed_optics(exposure())
    assert not watch.findings()


def test_flicker_is_told_from_a_step() -> None:
    flickering = [exposure(c05={"brightness": 0.8 if number % 3 == 0 else 1.0}) for number in range(WINDOW)]
    findings = after(*flickering).findings()
    assert [finding.cameras for finding in findings] == [(C05,)]
    assert "from exposure to exposure: look at the strobe" in findings[0].detail
    step = after(*[exposure()] * 10, *[exposure(c05={"brightness": 0.9})] * 10)
    assert not step.findings()


def test_what_most_cameras_show_is_one_finding() -> None:
    finding = the_finding(after(*[exposure({"brightness": 0.69})] * MIN_EXPOSURES))
    assert (len(finding.cameras), finding.severity) == (16, Severity.OUT_OF_SPECIFICATION)
    assert finding.detail == "the light has changed by -31%: look at the strobes' supply"
    flickering = [exposure({"brightness": 1.1 if number % 2 else 0.9}) for number in range(WINDOW)]
    assert len(the_finding(after(*flickering)).cameras) == 16


def test_a_slope_of_the_light_is_no_change_of_its_strength() -> None:
    sloping = {"gradient_uv": [0.36, 0.48]}
    finding = the_finding(after(*[exposure(sloping)] * MIN_EXPOSURES))
    assert finding.detail == "the light differs by 60% from border to border: look at the strobes' supply"
    finding = the_finding(after(*[exposure(sloping | {"brightness": 1.2})] * MIN_EXPOSURES))
    assert finding.detail.startswith("the light has changed by +20% and differs by 60% from border to border")


@pytest.mark.parametrize("brightness", [0.65, 1.4])
def test_what_one_camera_shows_is_in_front_of_it(brightness: float) -> None:
    finding = the_finding(after(*[exposure(c05={"brightness": brightness})] * MIN_EXPOSURES))
    assert (finding.cameras, finding.severity) == ((C05,), Severity.OUT_OF_SPECIFICATION)
    assert ("35% less light" if brightness < 1 else "changed by +40%") in finding.detail


def view_light(trouble: Disturbance) -> ViewLight:
    """Plane through the light on the wall, as it is read off an image."""
    light = np.asarray(trouble.wall_light, np.float64)[::16, ::16]
    v, u = np.mgrid[-1 : 1 : light.shape[0] * 1j, -1 : 1 : light.shape[1] * 1j]
    terms = np.stack([np.ones(light.size), u.ravel(), v.ravel()], axis=1)
    middle, slope_u, slope_v = np.linalg.lstsq(terms, light.ravel())[0]
    return ViewLight(middle, (2 * slope_u / middle, 2 * slope_v / middle))


@pytest.mark.parametrize("behind", ["c05", "c10", "c16"])
def test_a_panel_that_dims_is_named_by_geometry(behind: str) -> None:
    """The panel that c05 looks at loses 40 % of its light; those beside it see its border."""
    (camera,) = RIG.subset([CameraId(behind)]).cameras
    toward_panel = -camera.center_mm / np.linalg.norm(camera.center_mm)
    lights = {each.id: view_light(dimmed_sector(RIG, each, 0.4, toward_panel)) for each in RIG.cameras}
    (place,) = dark_places(RIG, lights)
    assert place.cameras[0] == behind
    assert 3 <= len(place.cameras) <= 8
    azimuth, elevation = np.deg2rad([place.azimuth_deg, place.elevation_deg])
    found = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    assert np.rad2deg(np.arccos(found @ toward_panel)) < 10
    figures = {
        name: {"brightness": light.brightness, "gradient_uv": list(light.gradient_uv)}
        for name, light in lights.items()
    }
    finding = the_finding(after(*[exposure(**figures)] * MIN_EXPOSURES))
    assert finding.cameras == place.cameras
    assert finding.severity is Severity.OUT_OF_SPECIFICATION
    assert "look at the light panel there" in finding.detail


def test_two_dark_places_are_two() -> None:
    lights = {name: ViewLight(1.0, (0.0, 0.0)) for name in RIG.camera_ids}
    lights |= {CameraId("c01"): ViewLight(0.7, (0.0, 0.0)), CameraId("c15"): ViewLight(0.8, (0.0, 0.0))}
    assert [place.cameras for place in dark_places(RIG, lights)] == [("c01",), ("c15",)]


def test_limits_are_checked() -> None:
    with pytest.raises(ValueError, match="dust must be positive"):
        OpticalParameters(dust=0.0)
