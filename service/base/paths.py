"""Paths: in a configuration file, which are relative to its folder, and the cache in the home of the user."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo

CREDENTIALS = "$CREDENTIALS_DIRECTORY"
UNIT_CREDENTIALS = Path("/run/credentials/stonefall.service")
"""Where systemd puts the credentials of the unit, for commands that it has not started."""


def resolve_path(path: Path, info: ValidationInfo) -> Path:
    """Return the absolute path; a relative one starts at the folder of the configuration file.

    One that starts with `$CREDENTIALS_DIRECTORY` is a credential that the unit loads (LoadCredential=).
    """
    if path.parts[:1] == (CREDENTIALS,):
        folder = Path(os.environ.get(CREDENTIALS.removeprefix("$"), UNIT_CREDENTIALS))
        return folder.joinpath(*path.parts[1:])
    base: Path = (info.context or {})["folder"]
    return Path(os.path.normpath(base / path))


ConfiguredPath = Annotated[Path, AfterValidator(resolve_path)]


def user_cache() -> Path:
    """Return the folder of what can be fetched or made again (XDG); raise `RuntimeError` if the user has no home."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache") / "stonefall"
