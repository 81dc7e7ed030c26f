"""The configuration of the running daemon: read again on SIGHUP, what can be applied at once is, the rest is named.

A configuration with a problem changes nothing: the daemon goes on with the last good one, and health says why.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_type_hints

from drivers.files.times import utc_now
from service.base.errors import ServiceError, StoreError
from service.base.messages import Code, message
from service.base.redaction import redacted
from service.base.schema import LIVE
from service.base.status import Checks, ConfigurationState, trouble_check
from service.configuration.settings import Settings, load_settings, problems
from service.store import Store
from service.store.audit import CONFIGURATION, note

log = logging.getLogger(__name__)


class Configuration:
    """The settings in use, and what became of the file since; `reload` reads it again. Call it on the event loop."""

    def __init__(self, settings: Settings, file: Path) -> None:
        self.settings = settings
        """What the daemon works with now."""
        self.state = ConfigurationState(loaded_at=utc_now(), restart_needed_for=(), problem=None)
        self._file = file

    def checks(self) -> Checks:
        """Check that the daemon works with what the configuration file says."""
        state, problem = self.state, None
        if state.problem is not None:
            problem = message(Code.CONFIGURATION_REFUSED, since=state.loaded_at, reported=state.problem)
        elif state.restart_needed_for:
            problem = message(Code.RESTART_NEEDED, settings=", ".join(state.restart_needed_for))
        return {"configuration": trouble_check(problem)}

    async def reload(self, apply: Callable[[Settings, Settings], Awaitable[None]], store: Store) -> None:
        """Read the file, have `apply(old, new)` put the live settings into the parts, and note it in the audit."""
        try:
            wanted, live = await asyncio.to_thread(_read, self._file, self.settings)
            await apply(self.settings, live)
        except (ServiceError, OSError) as err:
            log.error("configuration refused, the last good one stays in use: %s", err)
            self.state = self.state.model_copy(update={"problem": str(err)})
            return
        old, self.settings = self.settings, live
        applied, pending = differences(old, live), tuple(differences(live, wanted))
        self.state = ConfigurationState(loaded_at=utc_now(), restart_needed_for=pending, problem=None)
        log.info("configuration read again file=%s applied=%s", self._file, ", ".join(applied) or "nothing")
        if pending:
            log.warning("configuration: a restart is needed for %s", ", ".join(pending))
        if applied:
            plain = (_flat(settings, "json") for settings in (old, live))
            before, after = (redacted({name: values[name] for name in applied}) for values in plain)
            try:
                await store.write(note, "SIGHUP", CONFIGURATION, str(self._file), before=before, after=after)
            except StoreError as err:  # of a store that is damaged, which health has told
                log.error("the audit cannot note the configuration: %s", err)


def differences(one: Settings, other: Settings) -> list[str]:
    """Return the fields, as `section.field`, in which two configurations differ."""
    first, second = _flat(one), _flat(other)
    return [name for name in {**first, **second} if first.get(name) != second.get(name)]


def with_live(now: Settings, wanted: Settings) -> Settings:
    """Return the settings in use, with those of `wanted` that are marked as `Live`."""
    applied = {}
    for section, field in Settings.model_fields.items():
        old, new = getattr(now, section), getattr(wanted, section)
        if LIVE in field.metadata:
            applied[section] = new
        elif is_dataclass(old) and not isinstance(old, type):
            hints = get_type_hints(type(old), include_extras=True)
            names = [name for name, hint in hints.items() if LIVE in getattr(hint, "__metadata__", ())]
            applied[section] = replace(old, **{name: getattr(new, name) for name in names}) if names else old
    return now.model_copy(update=applied)


def _read(file: Path, now: Settings) -> tuple[Settings, Settings]:
    """Return the settings of the file, and what of them is to be used now; raise `ServiceError` if either is wrong."""
    wanted = load_settings(file)
    live = with_live(now, wanted)
    # parts of two good configurations can make a bad one: keys gone now, the address of the network until the restart
    for settings, where in ((wanted, ""), (live, " (together with what needs a restart)")):
        if wrong := "; ".join(problems(settings)):
            raise ServiceError(f"{file}{where}: {wrong}")
    return wanted, live


def _flat(settings: Settings, mode: Literal["python", "json"] = "python") -> Mapping[str, Any]:
    """Return all values by `section.field`; in Python's own, because as JSON two secrets are the same stars."""
    return {
        f"{section}.{name}": value
        for section, values in settings.model_dump(mode=mode).items()
        for name, value in (values or {}).items()
    }
