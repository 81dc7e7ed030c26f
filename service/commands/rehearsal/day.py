"""A day that is played: a TOML file lists its steps, and each deed in it is a method of `Day`."""

import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter

from service.base.language import Language
from service.commands.rehearsal.expected import Expected, Observer, ends_of
from service.commands.rehearsal.recordings import RehearsedRecording
from service.commands.rehearsal.rehearsed_daemon import RehearsalError, RehearsedDaemon, set_ahead
from service.commands.rehearsal.rigs import Rig
from service.health.alarms.alarm import ACTIVE
from service.store.backups import back_up, restore

FOLDER = Path(__file__).parent / "scripts"
OF_LOTS = ("triggers", "measured", "rejected", "lost", "verdict")
OF_ALARMS = (
    "id", "check", "priority", "state", "raised_at", "cleared_at", "occurrences", "detail", "cause", "action",
)  # fmt: skip


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
    is_gige: bool = False
    """With sixteen simulated GigE cameras; otherwise a recording is replayed, which needs no package."""
    has_own_clock: bool = False
    recording: RehearsedRecording = RehearsedRecording.STONES
    alarms: tuple[str, ...] = ()
    """Checks whose alarms it causes, in their order; a busy machine may add its own."""
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


class Day:
    """Plays the steps of a script, and notes what clients can see."""

    def __init__(
        self,
        script: Script,
        daemon: RehearsedDaemon,
        rig: Rig,
        say: Callable[[str], None],
        language: Language,
    ) -> None:
        self._script, self._daemon, self._rig, self._say, self._language = script, daemon, rig, say, language
        self._observer = Observer(daemon.state_dir)
        self._health: list[str] = []
        self._is_reachable = True
        self._settings = daemon.settings

    def play(self) -> Expected:
        """Play all steps, and return what a client should have seen."""
        for step in self._script.steps:
            if step.do not in DEEDS:
                raise RehearsalError(
                    f"script {self._script.name}: do: must be one of {', '.join(DEEDS)}, not {step.do!r}"
                )
            if step.say:
                self._say(step.say)
            getattr(self, step.do)(**step.arguments)
            self._look()
        lots = [self._lot(lot["lot"]) for lot in reversed(self._daemon.ask("/lots")["items"])]
        alarms = [{name: alarm[name] for name in OF_ALARMS} for alarm in self._alarms()]
        self._look()
        return self._observer.expected(self._script.name, lots, alarms, self._health)

    # --- what a MES does ---

    def product(self, name: str, **words: Any) -> None:
        wanted = {"title": name, "density_kg_m3": 2700.0, **words}
        self._daemon.ask(f"/products/{name}", wanted, "PUT")

    def open(self, lot: str, **words: Any) -> None:
        self._daemon.ask("/lots", {"lot": lot, **words})

    def close(self, lot: str, **words: Any) -> None:
        self._daemon.ask(f"/lots/{lot}/close", words)

    # --- stones ---

    def fall(self, stones: int) -> None:
        """Let so many stones fall, or a few more, and wait until each has its outcome."""
        self.flow()
        self.count(stones)
        self.rest()

    def flow(self) -> None:
        """Let stones fall until `rest`."""
        self._rig.flow(self._daemon)

    def count(self, stones: int) -> None:
        """Wait for so many more outcomes."""
        goal = ends_of(self._daemon.state_dir)[1] + stones
        self._wait_for_ends(lambda _, last_seq: last_seq >= goal)
        self._look()

    def rest(self) -> None:
        """Let no more stones fall."""
        self._rig.rest(self._daemon)
        self._daemon.wait_for("/accounting", lambda counts: counts["in_progress"] == 0)

    # --- what happens to the daemon ---

    def kill(self, stones: int) -> None:
        """Kill the daemon while stones fall, start it again, and let so many more fall."""
        self._daemon.kill()
        self._look()
        self._daemon.start()
        self.flow()
        self.count(stones)

    def restart(self, settings: Mapping[str, Any] | None = None, *, is_reachable: bool = True) -> None:
        """Stop the daemon and start it with these settings beside those of the script."""
        self._daemon.stop()
        self._look()
        self._daemon.settings = merged(self._settings, settings or {})
        self._is_reachable = is_reachable
        self._daemon.start(is_reachable=is_reachable)
        self._rig.rest(self._daemon)

    def cut(self, settings: Mapping[str, Any] | None = None) -> None:
        """Cut the network: the daemon goes on where no client reaches it."""
        self.restart(settings, is_reachable=False)

    def expire(self) -> None:
        """Wait until retention has removed all results but the newest."""
        self._wait_for_ends(lambda first_seq, last_seq: first_seq == last_seq)

    def backup(self) -> None:
        back_up(self._daemon.state_dir, self._daemon.folder / "backup.sqlite")

    def restore(self) -> None:
        """Stop the daemon, put the backup in the place of its database, and start it again."""
        self._daemon.stop()
        self._look()
        restore(self._daemon.folder / "backup.sqlite", self._daemon.state_dir)
        self._daemon.start()
        self._rig.rest(self._daemon)

    def verify(self, diameter_mm: float, count: int) -> None:
        """Drop balls until a verification has its verdict."""
        wanted = {"diameter_mm": diameter_mm, "count": count, "by": "rehearsal"}
        name = self._daemon.ask("/verifications", wanted)["id"]
        self.flow()
        self._daemon.wait_for(f"/verifications/{name}", lambda now: now["state"] != "collecting")
        self.rest()

    def clock(self, ahead_s: float) -> None:
        """Set the wall clock of the daemon's host."""
        set_ahead(self._daemon.clock, ahead_s)

    def fault(self, request: Mapping[str, Any]) -> None:
        """Break or mend something on the rig."""
        self._rig.fault(request)

    def until(self, check: str, status: str) -> None:
        """Wait until a check of the daemon's health has this status."""
        self._daemon.wait_for("/health", lambda health: health["checks"][check]["status"] == status)

    def without_files(self) -> None:
        """Wait until the files of the oldest result are removed."""
        seq, _ = ends_of(self._daemon.state_dir)
        self._daemon.wait_for(f"/particles/{seq}", lambda found: found["files_removed"] is not None)

    def alarm(self, check: str) -> None:
        """Wait until the alarm of a check is raised."""
        self._daemon.wait_for("/alarms", lambda now: check in _calling(now))

    def without_alarm(self, check: str) -> None:
        """Wait until the cause of that alarm is gone for long enough."""
        self._daemon.wait_for("/alarms", lambda now: check not in _calling(now))

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    # --- what is seen ---

    def _look(self) -> None:
        """Note the results that clients can read, and the daemon's word of its health."""
        if not self._is_reachable:
            return
        self._observer.look()
        health = self._daemon.find("/health")
        if health is not None and health["ne107"] not in self._health[-1:]:
            self._health.append(health["ne107"])

    def _wait_for_ends(self, is_enough: Callable[[int, int], bool]) -> None:
        self._daemon.wait_for("/health/live", lambda _: is_enough(*ends_of(self._daemon.state_dir)))

    def _alarms(self) -> list[dict[str, Any]]:
        """Return all alarms of the day, oldest first, once the store has those that are known."""
        known = {alarm["id"] for listed in self._daemon.ask("/alarms").values() for alarm in listed}
        history = self._daemon.wait_for(
            f"/alarms/history?limit=1000&language={self._language}",
            lambda found: known <= {alarm["id"] for alarm in found["items"]},
        )
        return list(reversed(history["items"]))

    def _lot(self, lot: str) -> dict[str, Any]:
        figures = self._daemon.ask(f"/lots/{lot}/gradation")
        known = self._daemon.ask(f"/lots/{lot}")
        return {"lot": lot, "state": known["state"], **{name: figures[name] for name in OF_LOTS}}


DEEDS = tuple(name for name in vars(Day) if not name.startswith("_") and name != "play")


def _calling(alarms: Mapping[str, Any]) -> set[str]:
    """Return the checks with an alarm whose cause is there."""
    return {alarm["check"] for alarm in alarms["items"] if alarm["state"] in ACTIVE}


def merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return both tables in one; where both have a value, the second one's."""
    both = dict(first)
    for name, value in second.items():
        both[name] = merged(both[name], value) if isinstance(value, Mapping) and name in both else value
    return both
