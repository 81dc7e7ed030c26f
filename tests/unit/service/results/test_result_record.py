"""The result record: what the light gate says of a stone, beside what was measured of it."""

from dataclasses import replace
from functools import cache

import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from support.known_bodies import BODIES, FORMS, SIZES

from pipeline.body_measurement import HullMeasurement, ParticleMeasurement
from pipeline.errors import RejectedError, RejectReason
from pipeline.fall import pulse_width_ns
from pipeline.frames import CameraId, Trigger
from pipeline.gradation.stones import Stone
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.particle import ParticleResult
from pipeline.segmentation import Silhouette, ViewStatus
from pipeline.uncertainty import Cause, Uncertainty
from pipeline.views.quality import Quality
from service.lots.stones import stone_of
from service.results.fields import Result
from service.results.record import document_of, lost_record, result_record

MIN_FERET_MM, MAX_FERET_MM = 10.0, 37.417  # of a box of 10 x 20 x 30 mm
REJECTED = ParticleResult(silhouettes={}, rejection=RejectedError(RejectReason.EMPTY, "nothing there"))


@cache
def box() -> ShapeMeasurement:
    box = trimesh.creation.box((10.0, 20.0, 30.0))
    return measure_shape(box.vertices, box.faces)


def measured(shape: ShapeMeasurement | None = None, volume_mm3: float = 6000.0) -> ParticleResult:
    measurement = ParticleMeasurement(
        body="estimate",
        supported_share=None,
        refinement_fallback=None,
        shape=shape or box(),
        hull=HullMeasurement(volume_mm3=6300.0, surface_area_mm2=2250.0),
        volume_mm3=volume_mm3,
        volume_model="test",
        volume_estimate_mm3=6010.0,
        angularity=None,
        density_kg_m3=None,
        uncertainty=Uncertainty(surface_mm={Cause.FOCUS: 0.03}, volume_percent={Cause.FOCUS: 0.5}),
    )
    return ParticleResult(silhouettes={}, quality=Quality.GOOD, measurement=measurement)


def test_every_view_says_who_found_its_outline_and_why_not_the_other():
    seen = {
        CameraId(camera): Silhouette(
            camera=CameraId(camera),
            status=ViewStatus.OK,
            image_size_px=(4, 3),
            found_by=found_by,
            fallback=flag,
        )
        for camera, found_by, flag in (("c01", "background", None), ("c02", "network", "no background yet"))
    }
    record = record_of(replace(REJECTED, silhouettes=seen), None)
    assert record.segmenters == {"c01": "background", "c02": "network"}
    assert record.segmentation_flags == {"c02": "no background yet"}
    lost = lost_record(
        trigger(1), bundle="b", reason="r", detail="d", calibration_id="0123", is_simulated=True
    )
    assert (lost.segmenters, lost.segmentation_flags) == ({}, {})


def trigger(width_ns: int | None) -> Trigger:
    return Trigger(
        sequence=1, received_ns=0, device_ns=0, utc="2026-11-21T04:00:00Z", pulse_width_ns=width_ns
    )


def record_of(result: ParticleResult, width_ns: int | None, speed_at_gate_mm_s: float = 0.0) -> Result:
    return result_record(
        result,
        trigger(width_ns),
        bundle="b",
        calibration_id="0123",
        is_simulated=True,
        speed_at_gate_mm_s=speed_at_gate_mm_s,
        timings_ms={},
    )


@pytest.mark.parametrize("name", BODIES)
def test_a_known_body_has_its_measures_in_the_record_and_in_the_lot(name: str) -> None:
    make, sizes = BODIES[name]
    shape = measure_shape(make(*sizes).vertices, make(*sizes).faces)
    record = record_of(measured(shape, shape.volume_mm3), None)
    fields = ("volume_mm3", "surface_area_mm2", "equivalent_diameter_mm", "sphericity")
    fields += ("max_feret_mm", "min_feret_mm", "sieve_size_mm")
    assert [getattr(record, each) for each in fields] == pytest.approx(SIZES[name], rel=5e-3)
    if name in FORMS:
        edges, krumbein, corey, zingg = FORMS[name]
        assert record.min_box_mm == pytest.approx(edges, rel=1e-3)
        assert (record.krumbein, record.corey) == pytest.approx((krumbein, corey), abs=1e-3)
        assert record.zingg_class == zingg
    stone = stone_of(document_of(record))
    assert isinstance(stone, Stone)
    assert (stone.volume_mm3, stone.max_feret_mm, stone.min_feret_mm, stone.sieve_size_mm) == pytest.approx(
        (SIZES[name][0], *SIZES[name][4:]), rel=1e-3
    )


@given(st.floats(MIN_FERET_MM, MAX_FERET_MM), st.floats(0, 3000))
def test_a_stone_is_plausible_however_it_was_turned_at_the_gate(extent_mm: float, speed: float) -> None:
    record = record_of(measured(), pulse_width_ns(extent_mm, speed), speed)
    assert record.gate_extent_mm == pytest.approx(extent_mm, rel=1e-4)
    assert record.gate_extent_is_plausible is True


@given(st.floats(0, 8) | st.floats(43, 500), st.floats(0, 3000))
def test_another_stone_s_pulse_is_flagged_and_nothing_else_changes(extent_mm: float, speed: float) -> None:
    record = record_of(measured(), pulse_width_ns(extent_mm, speed), speed)
    assert record.gate_extent_is_plausible is False
    assert record.outcome == "measured"
    found = {key: value for key, value in document_of(record).items() if not key.startswith("gate_")}
    assert found.items() <= document_of(record_of(measured(), None)).items()


def test_null_is_what_cannot_be_compared() -> None:
    def gate(record: Result) -> tuple[float | None, bool | None]:
        return record.gate_extent_mm, record.gate_extent_is_plausible

    assert gate(record_of(measured(), None)) == (None, None)
    assert gate(record_of(REJECTED, None)) == (None, None)
    assert gate(record_of(REJECTED, pulse_width_ns(15))) == (pytest.approx(15), None)
    lost = lost_record(
        trigger(1), bundle="b", reason="queue_full", detail="", calibration_id="0123", is_simulated=True
    )
    assert gate(lost) == (None, None)
    fields = [list(document_of(each)) for each in (lost, record_of(measured(), 1))]
    assert fields[0] == fields[1], "every record has the same fields in the same order"
