"""Paths in a configuration file are relative to its folder."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo


def _beside_the_file(path: Path, info: ValidationInfo) -> Path:
    folder: Path = (info.context or {})["folder"]
    return Path(os.path.normpath(folder / path))


ConfiguredPath = Annotated[Path, AfterValidator(_beside_the_file)]
