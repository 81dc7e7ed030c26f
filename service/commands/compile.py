"""`stonefall compile`: compile the loops that the first start would compile."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from service.configuration.segmentation_settings import plan_segmenter
from service.configuration.settings import Settings, load_settings
from service.processing.measure_job import WorkerContext, prepare
from service.processing.worker_pool import WorkerPool


def command(
    config: Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")],
) -> None:
    """Compile all loops ahead of the first start, into the cache that the daemon uses (NUMBA_CACHE_DIR).

    Run it after every installation, as the user that the daemon runs as.
    """
    asyncio.run(_compile(load_settings(config)))


async def _compile(settings: Settings) -> None:
    context = WorkerContext(
        parameters=settings.pipeline,
        is_simulated=False,
        segmentation=plan_segmenter(settings.segmentation),
    )
    workers = settings.workers
    async with WorkerPool(
        slots=workers.slots, deadline_s=workers.deadline_s, prepare=prepare, context=context
    ):
        pass
