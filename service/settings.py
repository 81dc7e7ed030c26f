"""The daemon's configuration: one TOML file, read once, frozen, every wrong field named.

Parameters are the dataclasses beside the code that uses them; this module only nests them. Relative
paths are relative to the file's folder. The calibration is not configuration but a measured result in
a file of its own.
"""

import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, ValidationInfo

from drivers.errors import RecordingError
from drivers.factory import ReplayBackend
from drivers.recording import open_recording, require_rig_of
from drivers.rig_file import read_rig
from pipeline.carving import CarvingParameters
from pipeline.consistency import ConsistencyParameters
from pipeline.particle import MeasuringParameters, PipelineParameters, ViewsParameters
from pipeline.segmentation.subtraction import SegmentationParameters
from service.api.settings import ApiSettings
from service.bundling import BundlingParameters
from service.errors import SettingsError
from service.store import KEEP_RAW


def _beside_the_file(path: Path, info: ValidationInfo) -> Path:
    folder: Path = (info.context or {})["folder"]
    return Path(os.path.normpath(folder / path))


ConfiguredPath = Annotated[Path, AfterValidator(_beside_the_file)]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSettings:
    """Where stones come from."""

    recording: ConfiguredPath
    backend: Literal["replay"] = "replay"
    pace: Literal["recorded", "fast"] = "recorded"
    speed: float = 1.0  # factor on the recorded pace
    loop: bool = False
    calibration: ConfiguredPath | None = None  # rig file; default: the recording's own

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 100:
            raise ValueError(f"speed must be in 0.01..100, not {self.speed:g}")
        if self.pace == "fast" and self.speed != 1.0:
            raise ValueError('speed scales the recorded pace and means nothing with pace = "fast"')

    @property
    def backend_settings(self) -> ReplayBackend:
        return ReplayBackend(recording=self.recording, pace=self.pace, speed=self.speed, loop=self.loop)

    @property
    def calibration_path(self) -> Path:
        return self.calibration or self.recording / "rig.json"


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
    keep_raw: int = KEEP_RAW  # frames of so many newest stones are kept, compressed
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
    segmentation: SegmentationParameters = SegmentationParameters()
    views: ViewsParameters = ViewsParameters()
    consistency: ConsistencyParameters = ConsistencyParameters()
    carving: CarvingParameters = CarvingParameters()
    measuring: MeasuringParameters = MeasuringParameters()
    workers: WorkersSettings = WorkersSettings()
    api: ApiSettings = ApiSettings()

    @property
    def pipeline(self) -> PipelineParameters:
        return PipelineParameters(
            **{part.name: getattr(self, part.name) for part in fields(PipelineParameters)}
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
            f"{'.'.join(map(str, error['loc']))}: {error['msg'].removeprefix('Value error, ')}"
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
    try:
        recording = open_recording(settings.rig.recording)
    except RecordingError as err:
        yield f"rig.recording: {err}"
    else:
        path = settings.rig.calibration_path
        try:
            require_rig_of(recording, read_rig(path), path)
        except RecordingError as err:
            yield f"rig.calibration: {err}"
    for name, folder in (("spool.dir", settings.spool.dir), ("store.dir", settings.store.dir)):
        if problem := _cannot_hold_files(folder):
            yield f"{name}: {problem}"


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
