"""Paths in a configuration file are relative to its folder."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo


def beside_the_file(path: Path, info: ValidationInfo) -> Path:
    """Return an absolute path."""
    folder: Path = (info.context or {})["folder"]
    return Path(os.path.normpath(folder / path))


ConfiguredPath = Annotated[Path, AfterValidator(beside_the_file)]
