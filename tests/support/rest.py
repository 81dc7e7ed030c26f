"""A fake daemon, the files of a result, and a client of the REST interface."""

import asyncio
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, fields
from functools import cache
from http import HTTPStatus
from pathlib import Path
from types import SimpleNamespace
from typing import TypeVar, cast

import httpx
import numpy as np
import trimesh
from fastapi import FastAPI
from starlette.datastructures import State
from support.outcomes import trigger

from drivers.errors import CameraUnavailableError, LossCause
from drivers.files.recording import write_bundle
from drivers.files.silhouette_file import write_silhouettes
from drivers.interfaces import CameraVitals
from pipeline.frames import CameraId, Frame, FrameBundle, Image
from service.acquisition.acquisition import Acquisition
from service.base.camera_status import CameraStatus
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    AcquisitionTarget,
    CheckStatus,
    ConfigurationState,
    Health,
    HealthCheck,
    Ne107,
    NotDisarmedError,
    next_state,
)
from service.calibration.calibrations import Calibrations
from service.configuration.settings import Settings
from service.daemon.diagnostics.archive import Inputs
from service.daemon.overview.overviews import KeptFigures
from service.daemon.overview.result_delays import ResultDelays
from service.daemon.rest import app
from service.daemon.running_daemon import rig_standing
from service.delivery.webhooks import Webhooks
from service.health.alarms.alarms import Alarms
from service.health.facts import Facts
from service.health.refinement_watch import RefinementTrend
from service.lots.plant import PlantSettings
from service.lots.shifts import LotsSettings
from service.recording.recordings import Recordings
from service.remeasuring.remeasuring import Remeasuring
from service.reports.lot_reports import RigStanding
from service.store import Store
from service.store.checks import RetentionFacts
from service.web.key_ring import KeyRing
from service.web.problems import all_problems
from service.web.reader_process import Reading
from service.web.settings import ApiSettings

T = TypeVar("T")

CAMERAS = (CameraId("c01"), CameraId("c02"), CameraId("c03"))
SILENT_CAMERA = CAMERAS[2]
"""Does not answer when it shall show itself."""
BOX_MM = (10.0, 20.0, 30.0)
GREY = {CameraId("c01"): 10, CameraId("c02"): 20}  # of the images, so that views cannot be mixed up

GOOD_HEALTH = Health(
    ne107=Ne107.GOOD,
    ready=True,
    checks={
        "camera:c01": HealthCheck(status=CheckStatus.PASS, observed_value=0.2, observed_unit="s", detail=None)
    },
)
SICK_HEALTH = Health(
    ne107=Ne107.FAILURE,
    ready=False,
    reasons=("camera c02 is lost",),
    checks={"camera:c02": HealthCheck(status=CheckStatus.FAIL, detail="does not answer")},
)

T = TypeVar("T")


JUST_LOADED = ConfigurationState(loaded_at="2026-11-24T06:00:00Z", restart_needed_for=(), problem=None)


@dataclass
class FakeControl:
    """Fake of the daemon, whose state a test sets; it arms and disarms at once."""

    recordings: Recordings | None = None
    state: AcquisitionState = AcquisitionState.DISARMED
    condition: Health = GOOD_HEALTH
    images: dict[str, Image] = field(default_factory=dict)
    calibrations: Calibrations | None = None
    lots: LotsSettings = field(default_factory=LotsSettings)
    delays: ResultDelays = field(default_factory=ResultDelays)
    settings: Settings = field(default_factory=Settings.model_construct)
    configured: ConfigurationState = JUST_LOADED
    diagnosed: Inputs | None = None
    alarms: Alarms | None = None
    webhooks: Webhooks | None = None
    remeasuring: Remeasuring | None = None
    plant: PlantSettings = field(default_factory=PlantSettings)
    figures: KeptFigures | None = None
    shown: list[tuple[CameraId, float]] = field(default_factory=list)

    def acquisition_status(self) -> AcquisitionStatus:
        return AcquisitionStatus(state=self.state, cameras=len(CAMERAS))

    def request(self, target: AcquisitionTarget) -> AcquisitionState:
        next_state(self.state, target)
        self.state = AcquisitionState(target)
        return self.state

    def health(self) -> Health:
        return self.condition

    def part(self, kind: type[T]) -> T:
        states = {
            Acquisition: self.acquisition,
            AcquisitionStatus: self.acquisition_status,
            Facts: self.facts,
            Health: self.health,
            RigStanding: self.rig_standing,
        }
        parts = (getattr(self, each.name) for each in fields(self))
        found = states[kind]() if kind in states else next(each for each in parts if isinstance(each, kind))
        return cast("T", found)

    def acquisition(self) -> SimpleNamespace:
        return SimpleNamespace(
            state=self.state,
            status=self.acquisition_status,
            request=self.request,
            show_camera=self.show_camera,
            cameras=SimpleNamespace(latest_image=self.images.get),
        )

    def rig_standing(self) -> RigStanding:
        assert self.calibrations is not None
        return rig_standing(self.calibrations, self.plant)

    def facts(self) -> Facts:
        assert self.calibrations is not None
        return Facts(
            health=self.condition,
            acquisition=self.acquisition_status(),
            cameras=self.cameras(),
            calibration=self.calibrations.facts(),
            waiting=3,
            max_waiting=16,
            workers=2,
            slots=2,
            worker_restarts=1,
            left_out=0,
            refinement=RefinementTrend(supported_share=0.8, rushed_share=0.25),
            loop_ms=1.5,
            free_bytes=10**10,
            retention=RetentionFacts(warn_days=7.0),
        )

    def cameras(self) -> list[CameraStatus]:
        return [CameraStatus(id=camera, state="armed", frames=7) for camera in CAMERAS]

    async def show_camera(self, camera: CameraId, seconds: float) -> CameraVitals:
        if self.state is not AcquisitionState.DISARMED:
            raise NotDisarmedError(self.state)
        if camera == SILENT_CAMERA:
            raise CameraUnavailableError(camera, "does not answer", LossCause.SILENT)
        self.shown.append((camera, seconds))
        return CameraVitals(serial=f"SIM-{camera}", model="SF-1280", address="127.0.0.2")


class ReadingThread:
    """Stands in for the process `stonefall-read`: what it is asked for is made in a thread of this process."""

    async def run(self, function: Callable[..., T], *arguments: object) -> T:
        return await asyncio.to_thread(function, *arguments)


_built = cache(app.build_routes)


def _routes(path_prefix: str = "") -> FastAPI:
    """Return an application with the routes that all of this process share; they are not to be added to."""
    own = copy(_built(path_prefix))
    own.state, own.user_middleware, own.middleware_stack = State(), [], None
    return own


app.build_routes = _routes


def app_of(
    store: Store,
    control: FakeControl,
    settings: ApiSettings | None = None,
    reading: Reading | None = None,
    drawing: Reading | None = None,
) -> FastAPI:
    """Return the application, with a thread in the place of the reading process unless one is given.

    Without `drawing` that makes pictures and meshes as well.
    """
    settings = settings or ApiSettings()
    reading = reading or ReadingThread()
    control.figures = KeptFigures(store, reading)
    return app.create_app(
        store, control, settings, reading, drawing or reading, KeyRing(settings.keys, store)
    )


def particle_files(folder: Path) -> dict[str, Path]:
    """Write the files of a worker: the mesh of a box, two silhouettes, the frames of two cameras."""
    folder.mkdir(parents=True, exist_ok=True)
    labels = {camera: ((0, 0), np.full((6, 8), grey // 2, np.uint8)) for camera, grey in GREY.items()}
    write_silhouettes(folder / "silhouettes.tiff", labels, (8, 6))
    trimesh.creation.box(BOX_MM).export(folder / "mesh.ply")
    frames = {
        camera: Frame(
            camera=camera,
            image=np.full((6, 8), grey, dtype=np.uint8),
            frame_id=1,
            device_ns=0,
            received_ns=0,
        )
        for camera, grey in GREY.items()
    }
    bundle = FrameBundle(trigger=trigger(1), frames=frames, missing={CAMERAS[2]: "lost"})
    write_bundle(folder / "bundle.tiff", bundle, CAMERAS, compression="zstd")
    return {name: folder / name for name in ("mesh.ply", "silhouettes.tiff", "bundle.tiff")}


def client_of(app: FastAPI, address: str = "127.0.0.1", host: str = "127.0.0.1:8080") -> httpx.AsyncClient:
    """Return a client at `address` that asks for `host`; unexpected exceptions become responses."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False, client=(address, 50000))
    return httpx.AsyncClient(transport=transport, base_url=f"http://{host}/api/v1")


def assert_problem(answer: httpx.Response, status: int, slug: str) -> None:
    """Fail unless the answer is this problem, in the form that all have."""
    problem = answer.json()
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert (answer.status_code, problem["status"]) == (status, status)
    assert problem["type"] == f"urn:stonefall:problem:{slug}"
    described = all_problems()
    is_named = any(slug in titles for titles in described.values())
    assert not is_named or slug in described[HTTPStatus(status)]  # as `openapi.json` says
    assert problem["instance"] == answer.request.url.path
    assert problem["request_id"] == answer.headers["X-Request-Id"]
    assert "Retry-After" in answer.headers or status not in (429, 503)
    assert problem["title"]
    assert problem["detail"]
