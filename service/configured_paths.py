"""Paths in a configuration file, which are relative to its folder."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo


def resolve_path(path: Path, info: ValidationInfo) -> Path:
    """Return the absolute path; a relative one starts at the folder of the configuration file."""
    folder: Path = (info.context or {})["folder"]
    return Path(os.path.normpath(folder / path))


ConfiguredPath = Annotated[Path, AfterValidator(resolve_path)]
