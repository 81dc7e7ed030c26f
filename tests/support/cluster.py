"""A cluster of dask on this machine, started as in the guide: a scheduler, and workers that can be killed."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from support.daemon_process import descendants_of
from support.eventually import eventually

DASK = Path(sys.executable).with_name("dask")
QUIET = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")


class LocalCluster:
    """Start the scheduler and its workers as a context manager; the folders of worker N are `worker-N`."""

    def __init__(self, folder: Path, *, n_workers: int) -> None:
        self._folder = folder
        self._n_workers = n_workers
        self._scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self._address = ""

    def __enter__(self) -> Self:
        self._folder.mkdir(parents=True, exist_ok=True)
        file = self._folder / "scheduler.json"
        try:
            self._scheduler = self._start(
                "scheduler", "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file
            )
            eventually(lambda: file.exists() and bool(file.read_text()))
            self._address = json.loads(file.read_text())["address"]
            for _ in range(self._n_workers):
                self._add_worker()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    @property
    def executor(self) -> str:
        return self._address.replace("tcp://", "dask://")

    def _add_worker(self) -> None:
        number = len(self.workers)
        self.workers.append(
            self._start(
                f"worker-{number}", "worker", self._address, "--host", "127.0.0.1", "--nthreads", "1",
                "--local-directory", self._room(number), "--no-nanny",
            )
        )  # fmt: skip

    def _room(self, number: int) -> Path:
        return self._folder / f"worker-{number}"

    def jobs(self, number: int) -> list[Path]:
        """Return the folders of the bundles that the worker's processes measure at this moment."""
        while True:
            with suppress(FileNotFoundError):  # a file went while its folder was looked through: once more
                return list(self._room(number).glob("**/stonefall/bundle-*/out"))

    def kill_worker(self, number: int) -> None:
        """Kill it as a machine dies: what it had started ends by itself."""
        started = descendants_of(self.workers[number].pid)
        self.workers[number].kill()
        self.workers[number].wait()
        eventually(lambda: not any(Path(f"/proc/{pid}").exists() for pid in started))

    def kill_scheduler(self) -> None:
        assert self._scheduler is not None
        self._scheduler.kill()
        self._scheduler.wait()

    def _start(self, name: str, *arguments: str | Path) -> subprocess.Popen[bytes]:
        with (self._folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [DASK, *arguments, *QUIET], stdout=log, stderr=log, cwd=self._folder, env=os.environ
            )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        processes = [each for each in (*self.workers, self._scheduler) if each is not None]
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
