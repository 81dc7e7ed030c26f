"""Accuracy of the whole measuring chain: a synthetic rig is calibrated from balls, then measures known bodies.

Images and results follow from the seed alone, whatever the number of processes.
"""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import trimesh
from threadpoolctl import threadpool_limits

from pipeline.calibration import BallDrop, CalibrationReport, calibrate, observe_ball
from pipeline.calibration.paper import observe_centroids
from pipeline.errors import CalibrationError
from pipeline.evaluation.distance_picture import distance_picture
from pipeline.evaluation.scene import EvaluationScene, build_scene, photograph_drop
from pipeline.evaluation.surface_distances import Surface
from pipeline.evaluation.trials import METHODS, Measured, Method, Trial, random_body, try_body
from pipeline.frames import Image
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.mask_segmenter import MaskSegmenter
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, Looks
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from service.processing.models.networks import load_model

RigName = Literal["true", "paper", "ours"]
RIGS: tuple[RigName, ...] = ("true", "paper", "ours")
CALIBRATIONS: Mapping[RigName, tuple[Literal["paper", "bundle"], int]] = {
    "paper": ("paper", 8),
    "ours": ("bundle", 20),
}
"""Method and number of drops of each calibration; the paper used eight."""
BALL_DIAMETER_MM = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchPlan:
    """The bodies, rigs and methods that are tried."""

    poses: Mapping[str, int]  # by body; of a random body the number of bodies
    own_bodies: Mapping[str, Body] = field(default_factory=dict)  # from mesh files, by name in `poses`
    looks: Mapping[str, Looks] = field(default_factory=dict)  # of a body's poses in turn; else as it is
    seed: int = 1
    lens: LensPreset = LensPreset.F2  # as published
    methods: Mapping[RigName, tuple[Method, ...]] = field(
        default_factory=lambda: dict.fromkeys(RIGS, METHODS)
    )
    model: str | None = (
        None  # of a U2-Net, whose masks then are the silhouettes of the paper's calibration and method
    )
    pictures: Path | None = None  # folder for pictures of each body's first pose


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchResult:
    """The trials and the calibrations; a rig without calibration is in `refused` with the reason, and in no trial."""

    trials: tuple[Trial, ...]
    reports: Mapping[RigName, CalibrationReport]
    refused: Mapping[RigName, str]
    stages_ms: Mapping[tuple[str, str], Sequence[float]] = field(default_factory=dict)
    """Processor time by method and stage, for each body."""
    paper_drops: tuple[BallDrop, ...] = ()  # as the paper's calibration sees them
    first_view: Image | None = None  # first camera's, of the first drop, if there are to be pictures


def run_accuracy_bench(
    plan: BenchPlan,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    n_processes: int | None = None,
) -> BenchResult:
    """Calibrate the rigs and measure the bodies of the plan; call `on_progress` with the steps done and in total.

    There are as many processes as processors, or so many.
    """
    calibrations = {rig: CALIBRATIONS[rig] for rig in plan.methods if rig in CALIBRATIONS}
    n_drops = max((count for _, count in calibrations.values()), default=0)
    total = n_drops + len(calibrations) + sum(plan.poses.values())
    done = 0

    def finished(futures: Iterable[Future[Any]]) -> None:
        nonlocal done
        for future in as_completed(futures):
            future.result()
            done += 1
            on_progress(done, total)

    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        n_processes or os.cpu_count(), mp_context=context, initializer=_use_one_thread
    ) as pool:
        try:
            dropped = [pool.submit(_drop, plan, number, calibrations) for number in range(n_drops)]
            finished(dropped)
            drops = [future.result() for future in dropped]
            solved = {
                rig: pool.submit(_calibrate, [drop[rig] for drop in drops if rig in drop], method)
                for rig, (method, _) in calibrations.items()
            }
            finished(solved.values())
            outcomes = {rig: future.result() for rig, future in solved.items()}
            reports = {
                rig: report for rig, report in outcomes.items() if isinstance(report, CalibrationReport)
            }
            rigs: dict[RigName, RigCalibration] = {}
            if "true" in plan.methods:
                rigs["true"] = as_built(nominal_rig(), plan.seed)
            rigs |= {rig: report.rig for rig, report in reports.items()}
            tried = [
                pool.submit(_try, plan, name, number, rigs)
                for name, n_poses in plan.poses.items()
                for number in range(n_poses)
            ]
            finished(tried)
            first_view = pool.submit(_first_view, plan).result() if plan.pictures and n_drops else None
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    stages_ms: dict[tuple[str, str], list[float]] = {}
    for future in tried:
        for stage, ms in future.result()[1].items():
            stages_ms.setdefault(stage, []).append(ms)
    return BenchResult(
        trials=tuple(trial for future in tried for trial in future.result()[0]),
        reports=reports,
        refused={rig: reason for rig, reason in outcomes.items() if isinstance(reason, str)},
        stages_ms=stages_ms,
        paper_drops=tuple(drop["paper"] for drop in drops if "paper" in drop),
        first_view=first_view,
    )


def picture_name(body: str, rig: str, method: str) -> str:
    """Return the name of the file with the picture of a body's first pose."""
    return f"{body}-{rig}-{method}.png".replace(" ", "-").translate(str.maketrans("", "", "',"))


# --- in the worker processes ---


def _use_one_thread() -> None:
    cv2.setNumThreads(1)
    threadpool_limits(1)


@cache
def _scene(seed: int, lens: LensPreset) -> EvaluationScene:
    """Return the scene, which is built once in each process and is equal in all."""
    return build_scene(seed, exposure=LENS_PRESETS[lens])


@cache
def _masks(model: str) -> MaskSegmenter:
    return MaskSegmenter(load_model(model))


def _drop(
    plan: BenchPlan, number: int, calibrations: Mapping[RigName, tuple[str, int]]
) -> dict[RigName, BallDrop]:
    """Return the drop as each calibration that uses it sees it."""
    scene = _scene(plan.seed, plan.lens)
    bundle = photograph_drop(scene, number, BALL_DIAMETER_MM)
    compared = observe_ball(bundle, scene.background, BackgroundSegmenter(), BALL_DIAMETER_MM)
    drops = {rig: compared for rig, (_, count) in calibrations.items() if number < count}
    if plan.model is not None and "paper" in drops:
        drops["paper"] = observe_centroids(bundle, _masks(plan.model), BALL_DIAMETER_MM)
    return drops


def _first_view(plan: BenchPlan) -> Image:
    frames = photograph_drop(_scene(plan.seed, plan.lens), 0, BALL_DIAMETER_MM).frames
    return next(iter(frames.values())).image


def _calibrate(drops: Sequence[BallDrop], method: Literal["paper", "bundle"]) -> CalibrationReport | str:
    try:
        design = nominal_rig()
        return calibrate(drops, design, method=method, created_at=design.created_at, name=f"bench-{method}")
    except CalibrationError as err:
        return str(err)


def _try(
    plan: BenchPlan, name: str, number: int, rigs: Mapping[RigName, RigCalibration]
) -> tuple[list[Trial], dict[tuple[str, str], float]]:
    """Return the trials of a body, and the processor time of each method's stages in ms."""
    body = plan.own_bodies.get(name) or random_body(name, number, plan.seed)
    if name in plan.looks:
        body = plan.looks[name].of(body, number)

    def picture(trial: Trial, measured: Measured, truth: trimesh.Trimesh) -> None:
        if plan.pictures is None or number > 0 or trial.distances is None:
            return
        distances_mm = Surface(truth).signed_distances_mm(np.asarray(measured.mesh.vertices))
        title = (
            f"{name}: {trial.method}, rig: {trial.rig};"
            f" mean {trial.distances.mean_mm:.3f} mm, max {trial.distances.max_mm:.3f} mm"
        )
        image_rgb = distance_picture(measured.mesh, distances_mm, title)
        cv2.imwrite(str(plan.pictures / picture_name(name, trial.rig, trial.method)), image_rgb[..., ::-1])

    measured_with: dict[str, tuple[RigCalibration, Sequence[Method]]] = {
        name: (rig, plan.methods[name]) for name, rig in rigs.items()
    }
    stages_ms: dict[tuple[str, str], float] = {}
    last_s = time.process_time()

    def on_stage(method: str, stage: str) -> None:
        nonlocal last_s
        now_s = time.process_time()
        stages_ms.setdefault((method, stage), 1000 * (now_s - last_s))  # of the first rig
        last_s = time.process_time()

    masks = None if plan.model is None else _masks(plan.model)
    trials = try_body(body, number, _scene(plan.seed, plan.lens), measured_with, picture, masks, on_stage)
    return trials, stages_ms
