"""The configuration that the daemon runs with."""

from typing import Any

from fastapi import APIRouter
from pydantic import Field

from service.base.redaction import redacted
from service.base.status import ConfigurationState
from service.configuration.settings import Settings
from service.web.auth import CONFIGURABLE
from service.web.context import Context

router = APIRouter(prefix="/config", tags=["configuration"])


class ConfigurationDocument(ConfigurationState):
    """All settings in use by section, defaults included, and what became of their file."""

    settings: dict[str, Any] = Field(
        description="As `stonefall check-config --json` prints them; hashes, tokens, secrets and most of URLs"
        " are `redacted`"
    )


@router.get("", response_model=ConfigurationDocument, dependencies=CONFIGURABLE)
async def configuration(context: Context) -> dict[str, Any]:
    """Get the settings that the daemon works with: of its start, or of the last reload (SIGHUP).

    It names paths, addresses and devices of the plant, which readers of results need not know: scope `configure`.
    """
    settings = context.part(Settings).model_dump(mode="json")
    return {"settings": redacted(settings), **context.part(ConfigurationState).model_dump()}
