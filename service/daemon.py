"""The composition root: builds the parts, runs them in one task group, ends them in order.

The first SIGTERM or SIGINT stops the rig, measures what it has seen and exits 0; the second one gives up
what is not measured yet. Whatever a part cannot handle ends the group, and with it the process.
"""

import asyncio
import logging
import shutil
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import uvicorn

from drivers.recording import open_recording
from drivers.rig_file import read_rig
from pipeline.frames import CameraId
from service.acquisition import Acquisition
from service.api.app import create_app
from service.api.server import server_config
from service.control import AcquisitionState, AcquisitionTarget, CameraStatus, Health
from service.errors import ServiceError
from service.health import Facts, assess
from service.processing import Processing, ProcessingContext
from service.settings import Settings
from service.spool import Spool
from service.store import open_store
from service.supervision import Heartbeats
from service.systemd import ServiceManager
from service.worker_job import WorkerContext, initialize
from service.workers import WorkerPool

log = logging.getLogger(__name__)

DRAIN_S = 30.0
"""How long bundles already seen may take after SIGTERM before they are given up."""
