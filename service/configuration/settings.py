"""The configuration of the daemon: one TOML file, read once, frozen, every wrong field named.

Parameters are dataclasses beside the code that uses them; this module only nests them. Relative paths start at the
folder of the file. The calibration is not configuration but a measured result in a file of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from tempfile import TemporaryFile

from pydantic import BaseModel, ConfigDict, ValidationError

from pipeline.carving import CarvingParameters
from pipeline.meshing import MeshingParameters
from pipeline.particle import BodyParameters, PipelineParameters
from pipeline.uncertainty import QualityParameters
from pipeline.views.consistency import ConsistencyParameters
from pipeline.views.quality import ViewsParameters
from service.acquisition.empty_rig import EmptyRigParameters
from service.base.errors import StoreError, VolumeModelError
from service.base.log_level import LogLevel
from service.base.paths import ConfiguredPath
from service.base.schema import Live, require_ranges
from service.base.settings_file import Loc, dotted, load_settings_file, wrong_fields
from service.bundling.window import BundlingSettings
from service.calibration.verification_limits import VerificationParameters
from service.configuration.rig_checks import rig_problems
from service.configuration.rig_settings import BACKENDS, RigSettings
from service.configuration.segmentation_settings import SegmentationSettings, plan_segmenter
from service.configuration.volume_models import MeasuringSettings
from service.delivery.mail import MailSettings
from service.delivery.settings import FileDropSettings, WebhooksSettings, delivery_shortcomings
from service.health.optical_watch import OpticalParameters
from service.lots.plant import PlantSettings, logo_of
from service.lots.shifts import LotsSettings
from service.recording.recordings import RecordingsSettings
from service.store import KEEP_RAW
from service.store.keys import stored_keys
from service.store.retention import RetentionLimits
from service.web.settings import ApiSettings, WithoutKeys


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkersSettings:
    """Number of processes that measure, and the time that one bundle may take."""

    slots: int = 2
    deadline_s: float = 20.0

    def __post_init__(self) -> None:
        require_ranges(self, slots=(1, 256), deadline_s=(0.1, 600))


@dataclass(frozen=True, slots=True, kw_only=True)
class SpoolSettings:
    """The bounded queue of bundles; its folder should be on tmpfs, and is emptied at the start."""

    dir: ConfiguredPath
    max_bundles: int = 16  # about 21 MB each with 16 cameras of 1280x1024

    def __post_init__(self) -> None:
        if self.max_bundles < 1:
            raise ValueError(f"max_bundles must be at least 1, not {self.max_bundles}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreSettings:
    """Folder of the store, what it keeps, and how often its database is copied."""

    dir: ConfiguredPath
    keep_raw: int = KEEP_RAW  # number of the newest stones whose frames are kept
    save_silhouettes: bool = True
    backup_every_h: Live[float] = 1.0  # hours between two copies of the database in dir/backups; 0: none
    keep_backups: Live[int] = 4
    exact_meshes: bool = False  # PLY in single precision instead of compact meshes
    retention: Live[RetentionLimits] = field(default_factory=RetentionLimits)

    def __post_init__(self) -> None:
        if self.keep_raw < 0:
            raise ValueError(f"keep_raw must not be negative, not {self.keep_raw}")
        require_ranges(self, backup_every_h=(0, 8760), keep_backups=(1, 1000))


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSettings:
    """The daemon's log."""

    level: LogLevel = LogLevel.INFO


class Settings(BaseModel):
    """The whole file: each section is a field, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rig: RigSettings
    spool: SpoolSettings
    store: StoreSettings
    bundling: BundlingSettings = BundlingSettings()
    empty_rig: EmptyRigParameters = EmptyRigParameters()
    segmentation: SegmentationSettings = SegmentationSettings()
    views: ViewsParameters = ViewsParameters()
    quality: QualityParameters = QualityParameters()
    consistency: ConsistencyParameters = ConsistencyParameters()
    optics: Live[OpticalParameters] = OpticalParameters()
    carving: CarvingParameters = CarvingParameters()
    meshing: MeshingParameters = MeshingParameters()
    body: BodyParameters = BodyParameters()
    measuring: MeasuringSettings = MeasuringSettings()
    verification: Live[VerificationParameters] = VerificationParameters()
    workers: WorkersSettings = WorkersSettings()
    log: Live[LogSettings] = LogSettings()
    recordings: RecordingsSettings = RecordingsSettings()
    lots: Live[LotsSettings] = LotsSettings()
    plant: Live[PlantSettings] = PlantSettings()
    api: ApiSettings = ApiSettings()
    webhooks: Live[WebhooksSettings] = WebhooksSettings()
    file_drop: FileDropSettings | None = None
    mail: MailSettings | None = None

    @property
    def pipeline(self) -> PipelineParameters:
        """Return the parameters of the pipeline, but for the fall, which the source of the stones knows.

        Raises `VolumeModelError` when the volume model is unusable.
        """
        names = {part.name for part in fields(PipelineParameters)} & Settings.model_fields.keys()
        given = {name: getattr(self, name) for name in names}
        given |= {name: given[name].parameters for name in ("segmentation", "measuring")}
        return PipelineParameters(**given)


def load_settings(path: Path) -> Settings:
    """Read and check a configuration file, but not the files that it refers to: see `problems`.

    Raises `SettingsError`, which names the file and each wrong field.
    """
    return load_settings_file(path, Settings, _name_of)


def wrong_rig_fields(err: ValidationError) -> str:
    """Return the fields that are wrong in `[rig]`, which was validated alone, each with the reason."""
    return wrong_fields(err, _name_of, "rig")


def problems(settings: Settings) -> Iterator[str]:
    """Yield contradictions between settings, or with the files they refer to, each with its field."""
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
        yield 'measuring.volume_model: needs an estimated body: leave body.kind = "hull" out, or the model'
    if settings.plant.logo is not None:
        try:
            logo_of(settings.plant.logo)
        except ValueError as err:
            yield f"plant.logo: {err}"
    for name, folder in (("spool.dir", settings.spool.dir), ("store.dir", settings.store.dir)):
        if problem := _write_problem(folder):
            yield f"{name}: {problem}"
    if not (settings.api.may_read_without_keys or settings.api.keys or _has_keys(settings)):
        yield (
            f"api.host: every host that reaches {settings.api.host} could read everything, as there is no key: make one"
            " with `stonefall keys create NAME --config FILE`, or say in [api] that"
            f' without_keys = "{WithoutKeys.EVERY_HOST_MAY_READ}"'
        )


def _has_keys(settings: Settings) -> bool:
    """True when the store has keys, or they cannot be read."""
    try:
        return bool(stored_keys(settings.store.dir))
    except StoreError:
        return True


def shortcomings(settings: Settings) -> Iterator[str]:
    """Yield the missing things that the daemon can start without, each with its field."""
    plan = plan_segmenter(settings.segmentation)
    if plan.trouble is not None:
        yield f"segmentation.model: {plan.trouble}"
    if plan.provider_trouble is not None:
        yield f"segmentation.providers: {plan.provider_trouble}"
    try:
        stored_keys(settings.store.dir)
    except StoreError as err:
        yield f"api.keys: {err}: no key of the store is accepted"
    yield from delivery_shortcomings(settings.webhooks, settings.file_drop)
    if settings.mail is not None:
        for read in (settings.mail.password, settings.mail.context):
            try:
                read()
            except ValueError as err:
                yield f"mail.{err}"


def _name_of(loc: Loc) -> str:
    """Return the name of a field as it is in the file; pydantic adds the backend after `rig`."""
    if loc[0] == "rig" and len(loc) > 1 and loc[1] in BACKENDS:
        loc = (loc[0], *loc[2:])
    return dotted(loc)


def _write_problem(folder: Path) -> str | None:
    """Return the reason why no file can be written to `folder`, which need not exist yet; None when one can."""
    existing = folder
    while not existing.exists():
        existing = existing.parent
    try:
        with TemporaryFile(dir=existing):
            return None
    except OSError as err:
        return f"cannot write to {existing}: {err.strerror}"
