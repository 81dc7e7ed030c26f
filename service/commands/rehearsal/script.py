"""The scripts of rehearsals: TOML files beside this module, each a list of steps."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter

from service.commands.rehearsal.recordings import RehearsedRecording

FOLDER = Path(__file__).parent / "scripts"


class ScriptStep(BaseModel):
    """What is done, what is said of it, and the arguments of the deed: a method of `Day`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    do: str
    say: str = ""

    @property
    def arguments(self) -> dict[str, Any]:
        return dict(self.model_extra or {})


@dataclass(frozen=True, kw_only=True)
class Script:
    """A day: what falls, on which rig, with which settings, and what happens."""

    name: str
    title: str
    steps: tuple[ScriptStep, ...]
    is_gige: bool = (
        False  # sixteen simulated GigE cameras; otherwise a recording is replayed, which needs no package
    )
    has_own_clock: bool = False
    recording: RehearsedRecording = RehearsedRecording.STONES
    alarms: tuple[
        str, ...
    ] = ()  # checks whose alarms it causes, in their order; a busy machine may add its own
    settings: dict[str, Any] = field(default_factory=dict)


def scripts() -> dict[str, Script]:
    """Return all scripts by name."""
    adapter = TypeAdapter(Script)
    return {
        path.stem: adapter.validate_python(
            {"name": path.stem, **tomllib.loads(path.read_text(encoding="utf-8"))}
        )
        for path in sorted(FOLDER.glob("*.toml"))
    }
