"""The daemon's configuration: one TOML file, read once, frozen, every wrong field named.

Parameters are the dataclasses beside the code that uses them; this module only nests them. Relative
paths are relative to the file's folder. The calibration is not configuration but a measured result in
a file of its own.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryFile

from pydantic import BaseModel, ConfigDict, ValidationError

from pipeline.carving import CarvingParameters
from pipeline.particle import BodyParameters, PipelineParameters
from pipeline.views.consistency import ConsistencyParameters
from pipeline.views.quality import ViewsParameters
from service.acquisition.empty_rig import EmptyRigParameters
from service.api.settings import ApiSettings
from service.bundling.parameters import BundlingParameters
from service.calibration.verification_limits import VerificationParameters
from service.configuration.paths import ConfiguredPath
from service.configuration.rig_checks import rig_problems
from service.configuration.rig_settings import BACKENDS, RigSettings
from service.configuration.segmentation_settings import SegmentationSettings, plan_segmenter
from service.configuration.volume_models import MeasuringSettings
from service.errors import SettingsError, VolumeModelError
from service.health.optical_watch import OpticalParameters
from service.recording.recordings import RecordingsSettings
from service.store import KEEP_RAW


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkersSettings:
    """How many processes measure, and how long one bundle may take."""

    slots: int = 2
    deadline_s: float = 20.0

    def __post_init__(self) -> None:
        if not 1 <= self.slots <= 256:
            raise ValueError(f"slots must be in 1..256, not {self.slots}")
        if not 0.1 <= self.deadline_s <= 600:
            raise ValueError(f"deadline_s must be in 0.1..600, not {self.deadline_s:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class SpoolSettings:
    """The bounded queue of bundles; its folder belongs on tmpfs and is emptied at the start."""

    dir: ConfiguredPath
    max_bundles: int = 16  # about 21 MB each with 16 cameras of 1280x1024

    def __post_init__(self) -> None:
        if self.max_bundles < 1:
            raise ValueError(f"max_bundles must be at least 1, not {self.max_bundles}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreSettings:
    """Where results stay."""

    dir: ConfiguredPath
    keep_raw: int = KEEP_RAW  # frames of so many newest stones are kept
    save_silhouettes: bool = True

    def __post_init__(self) -> None:
        if self.keep_raw < 0:
            raise ValueError(f"keep_raw must not be negative, not {self.keep_raw}")


class Settings(BaseModel):
    """The whole file; a section is a field, an unknown key is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rig: RigSettings
    spool: SpoolSettings
    store: StoreSettings
    bundling: BundlingParameters = BundlingParameters()
    empty_rig: EmptyRigParameters = EmptyRigParameters()
    segmentation: SegmentationSettings = SegmentationSettings()
    views: ViewsParameters = ViewsParameters()
    consistency: ConsistencyParameters = ConsistencyParameters()
    optics: OpticalParameters = OpticalParameters()
    carving: CarvingParameters = CarvingParameters()
    body: BodyParameters = BodyParameters()
    measuring: MeasuringSettings = MeasuringSettings()
    verification: VerificationParameters = VerificationParameters()
    workers: WorkersSettings = WorkersSettings()
    recordings: RecordingsSettings = RecordingsSettings()
    api: ApiSettings = ApiSettings()

    @property
    def pipeline(self) -> PipelineParameters:
        return PipelineParameters(
            **{
                part.name: getattr(self, part.name)
                for part in fields(PipelineParameters)
                if part.name not in ("segmentation", "mesher", "measuring")
            },
            segmentation=self.segmentation.parameters,
            measuring=self.measuring.parameters,
        )


def load_settings(path: Path) -> Settings:
    """Read and check a configuration file; what it refers to is not looked at, see `problems`.

    Raises
    ------
    SettingsError
        Naming the file and every wrong field.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as err:
        raise SettingsError(f"{path}: {err.strerror}") from err
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise SettingsError(f"{path}: {err}") from err
    try:
        return Settings.model_validate(document, context={"folder": path.resolve().parent})
    except ValidationError as err:
        wrong = "; ".join(
            f"{_name_of(error['loc'])}: {error['msg'].removeprefix('Value error, ')}"
            for error in err.errors()
        )
        raise SettingsError(f"{path}: {wrong}") from None


def problems(settings: Settings) -> Iterator[str]:
    """Say which settings contradict each other or what they refer to, each with its field."""
    n_disagreeing = settings.carving.max_disagreeing_views
    if settings.views.min < n_disagreeing + 2:
        yield (
            f"views.min: must be at least {n_disagreeing + 2}, two more than"
            f" carving.max_disagreeing_views, not {settings.views.min}"
        )
    yield from rig_problems(settings.rig, settings.bundling)
    try:
        _ = settings.measuring.parameters
    except VolumeModelError as err:
        yield f"measuring.volume_model: {err}"
    if settings.measuring.volume_model is not None and settings.body.kind == "hull":
        yield 'measuring.volume_model: goes by the estimated body, so body.kind must be "estimate"'
    for name, folder in (("spool.dir", settings.spool.dir), ("store.dir", settings.store.dir)):
        if problem := _cannot_hold_files(folder):
            yield f"{name}: {problem}"


def shortcomings(settings: Settings) -> Iterator[str]:
    """Say what the daemon starts without, each with its field."""
    plan = plan_segmenter(settings.segmentation)
    if plan.trouble is not None:
        yield f"segmentation.model: {plan.trouble}"
    if plan.provider_trouble is not None:
        yield f"segmentation.providers: {plan.provider_trouble}"


def _name_of(loc: tuple[int | str, ...]) -> str:
    """Return the field as it is written; behind `rig` pydantic also names the backend."""
    if loc[0] == "rig" and len(loc) > 1 and loc[1] in BACKENDS:
        loc = (loc[0], *loc[2:])
    return ".".join(map(str, loc))


def _cannot_hold_files(folder: Path) -> str | None:
    """Why no file can be made in `folder` (which need not exist yet), None when it can."""
    existing = folder
    while not existing.exists():
        existing = existing.parent
    try:
        with TemporaryFile(dir=existing):
            return None
    except OSError as err:
        return f"cannot write to {existing}: {err.strerror}"
