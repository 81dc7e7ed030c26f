"""`[measuring]` of the configuration, and files with coefficients of the volume correction ("stonefall-volume/1")."""

import json
from dataclasses import InitVar, asdict, dataclass
from pathlib import Path

from drivers.files.bounded import read_bounded
from drivers.files.durable import write_file
from pipeline.body_measurement import MeasuringParameters
from pipeline.formats import unread_format
from pipeline.measuring.volume_correction import SYNTHETIC, VolumeModel
from service.base.errors import VolumeModelError
from service.base.paths import ConfiguredPath

FORMAT = "stonefall-volume/1"
MAX_BYTES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringSettings:
    """Density of stones outside of lots, and the volume model."""

    density_kg_m3: float | None = None  # EN 1097-6; a lot's stones have their product's
    volume_model: ConfiguredPath | None = None  # of `stonefall fit-volume`; without it, the built-in one

    density_g_cm3: InitVar[float | None] = None  # the same, as files of before 1.22 have it

    def __post_init__(self, density_g_cm3: float | None) -> None:
        if density_g_cm3 is not None:
            if self.density_kg_m3 is not None:
                raise ValueError("density_kg_m3 and density_g_cm3 are the same: give one")
            object.__setattr__(self, "density_kg_m3", 1000 * density_g_cm3)
        MeasuringParameters(density_kg_m3=self.density_kg_m3)

    @property
    def parameters(self) -> MeasuringParameters:
        """Return the parameters of the pipeline; raise `VolumeModelError` when the file of the model is unusable."""
        model = SYNTHETIC if self.volume_model is None else read_volume_model(self.volume_model)
        return MeasuringParameters(density_kg_m3=self.density_kg_m3, volume_model=model)


def read_volume_model(path: Path) -> VolumeModel:
    """Read the coefficients in a file; raise `VolumeModelError`, which names file and field, if they are wrong."""
    try:
        document = json.loads(read_bounded(path, MAX_BYTES))
    except OSError as err:
        raise VolumeModelError(f"{path}: {err.strerror}") from err
    except (ValueError, RecursionError) as err:
        raise VolumeModelError(f"{path}: is not JSON: {err}") from err
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT:
        raise VolumeModelError(
            f"{path}: format: {unread_format(found, FORMAT)}; stonefall fit-volume writes such a file"
        )
    shares: dict[str, float] = {}
    for name in ("gap_share", "hidden_share"):
        value = document.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise VolumeModelError(f"{path}: {name}: must be a number, not {value!r}")
        shares[name] = value
    if not isinstance(document.get("id"), str):
        raise VolumeModelError(f"{path}: id: must be a text, not {document.get('id')!r}")
    try:
        return VolumeModel(id=document["id"], **shares)
    except ValueError as err:
        raise VolumeModelError(f"{path}: {err}") from err


def write_volume_model(path: Path, model: VolumeModel, remarks: dict[str, float | int | str]) -> None:
    """Write the coefficients and how they were found; the file appears when it is complete."""
    document = {"format": FORMAT, **asdict(model), **remarks}
    write_file(path, (json.dumps(document, indent=2) + "\n").encode())
