"""The configuration that the daemon runs with."""

from typing import Any

from fastapi import APIRouter, Depends
from pydantic import BaseModel, Field

from service.api.auth import require
from service.api.context import Context
from service.api.problems import problem_responses
from service.api.redaction import redacted
from service.api.settings import Scope

router = APIRouter(prefix="/config", tags=["configuration"])


class ConfigurationDocument(BaseModel):
    """All settings by section, defaults included."""

    settings: dict[str, Any] = Field(
        description="As `stonefall check-config --json` prints them; hashes, tokens and secrets are `redacted`"
    )


@router.get(
    "",
    response_model=ConfigurationDocument,
    dependencies=[Depends(require(Scope.CONFIGURE))],
    responses=problem_responses(),
)
async def configuration(context: Context) -> dict[str, Any]:
    """Return the settings that the daemon was started with; the file may have changed since.

    It names paths, addresses and devices of the plant, which readers of results need not know: scope `configure`.
    """
    return {"settings": redacted(context.control.configuration())}
