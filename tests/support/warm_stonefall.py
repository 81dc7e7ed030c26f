"""The program `stonefall`, forked from a process that has imported it: a start costs 2 s of a processor less.

It runs in a process of its own, with its own descriptors, environment, signals and exit code; only its imports are
done, also those of the server that its workers are forked from. What forks has one thread, as it must.
"""

import asyncio
import atexit
import ctypes
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from itertools import count, pairwise
from multiprocessing import util
from pathlib import Path
from typing import Any

PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal to get when the parent ends."""


MOST_HELD_S = 1.0
"""Longest callback of an event loop, processor seconds; a coroutine that spun took five."""
HELD = "held the event loop for"


class WarmStonefall:
    """`stonefall` with some arguments; what tests use of `subprocess.Popen`."""

    def __init__(
        self,
        arguments: Sequence[str | Path],
        *,
        out: Path,
        log: Path,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
    ) -> None:
        """Start it; its stdout is appended to the file `out`, its stderr to `log`."""
        self.args = ["stonefall", *map(str, arguments)]
        self.returncode: int | None = None
        self._out, self._log = out, log
        self.pid: int = _server().ask(
            {
                "run": self.args,
                "out": str(out.absolute()),
                "log": str(log.absolute()),
                "environment": dict(os.environ if environment is None else environment),
                "folder": str(folder or Path.cwd()),
            }
        )
        self._pidfd = os.pidfd_open(self.pid)  # until it is waited for it is a zombie at most

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        return self._wait(0)

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code once it has ended; raise `subprocess.TimeoutExpired` if it has not in time."""
        if (code := self._wait(timeout)) is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for the end; return stdout and stderr."""
        self.wait(timeout)
        return self._out.read_text(), self._log.read_text()

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _wait(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._pidfd], [], [], timeout)[0]:
            self.returncode = _server().ask({"wait": self.pid})
            os.close(self._pidfd)
        return self.returncode


def start_stonefall(*arguments: str | Path, folder: Path | None = None) -> WarmStonefall:
    """Start a command whose output is asked for later, by `communicate`."""
    kept = Path(tempfile.mkdtemp(prefix="warm-", dir=_folder()))
    return WarmStonefall(arguments, out=kept / "out", log=kept / "log", folder=folder)


def run_stonefall(
    *arguments: str | Path, folder: Path | None = None, check: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end and return what came of it; with `check` it must exit with 0."""
    process = start_stonefall(*arguments, folder=folder)
    printed, told = process.communicate()
    done = subprocess.CompletedProcess(process.args, process.wait(), printed, told)
    if check:
        assert done.returncode == 0, done
    return done


@cache
def _folder() -> str:
    """Return a folder for what commands print, removed when this process ends."""
    folder = tempfile.TemporaryDirectory(prefix="stonefall-tests-", ignore_cleanup_errors=True)
    atexit.register(folder.cleanup)
    return folder.name


class _Server:
    """The server as its clients see it, one in each process of tests."""

    def __init__(self) -> None:
        one_thread = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | one_thread,
        )
        self._asking = threading.Lock()
        self._numbers = count()
        atexit.register(self._process.communicate)  # its input ends, and with it the server

    def ask(self, request: Mapping[str, Any]) -> int:
        asked, answered = self._process.stdin, self._process.stdout
        assert asked is not None
        assert answered is not None
        with self._asking:
            number = next(self._numbers)
            asked.write(json.dumps({**request, "number": number}) + "\n")
            asked.flush()
            while True:  # before it may come what a test did not wait for that was ended meanwhile
                of_number, answer = map(int, answered.readline().split())
                if of_number == number:
                    return answer


_server = cache(_Server)


def _serve() -> bool:
    """Fork a process for each request to run something; return True in it, False when no more is asked for."""
    for line in sys.stdin:
        request = json.loads(line)
        if "wait" in request:
            _, status = os.waitpid(request["wait"], 0)
            answer = os.waitstatus_to_exitcode(status)
        elif (answer := os.fork()) == 0:
            _exchange(request)
            return True
        sys.stdout.write(f"{request['number']} {answer}\n")
        sys.stdout.flush()
    return False


def _exchange(request: Mapping[str, Any]) -> None:
    """Exchange what this process has inherited for what the request says; it is killed when the server ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
    for own, path in ((0, os.devnull), (1, request["out"]), (2, request["log"])):
        theirs = os.open(path, flags if own else os.O_RDONLY)
        os.dup2(theirs, own)
        os.close(theirs)
    sys.argv = request["run"]
    util.spawnv_passfds = partial(_forked, util.spawnv_passfds)  # type: ignore[attr-defined]  # not in its stubs


def _told(run: Callable[[asyncio.Handle], None]) -> Callable[[asyncio.Handle], None]:
    """Return `run` that says on stderr which callback of an event loop has held it."""

    def run_and_tell(handle: asyncio.Handle) -> None:
        start_s = time.thread_time()
        run(handle)
        if (used_s := time.thread_time() - start_s) > MOST_HELD_S:
            sys.stderr.write(f"{handle} {HELD} {used_s:.1f} s of processor time\n")
            sys.stderr.flush()

    return run_and_tell


def _forked(spawn: Callable[..., int], path: bytes, arguments: Sequence[str], kept: Sequence[int]) -> int:
    """Fork multiprocessing's fork server from this process instead of a new one, while it has one thread."""
    code = arguments[-1]
    if "forkserver" not in code or len([*Path("/proc/self/task").iterdir()]) > 1:
        return spawn(path, arguments, kept)
    if (pid := os.fork()) == 0:
        for first, next_kept in pairwise((2, *sorted(kept), os.sysconf("SC_OPEN_MAX"))):
            os.closerange(first + 1, next_kept)
        try:
            exec(code, {})  # noqa: S102 - the code that it would be started with
        finally:  # nothing of the program that forked it
            os._exit(0)
    return pid


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[2])
    from service.processing.compiled_code import isolate_numba_cache

    isolate_numba_cache()
    import service.commands.cli
    import service.daemon.rest.app
    import service.daemon.run
    import service.processing.measure_job
    import service.processing.worker_imports
    import service.store  # so that nothing is left to import after the fork
    import service.web.reader_process
    from service.processing.worker_process import freeze_gc

    for command in service.commands.cli.COMMANDS.values():
        __import__(command)
    build = service.daemon.rest.app.build_routes
    routes = build()
    routes.openapi()  # what FastAPI makes at first use
    service.daemon.rest.app.build_routes = lambda prefix="": build(prefix) if prefix else routes
    # stones get measured and who looks gets an answer also beside processes that compute
    service.processing.measure_job.NICENESS, service.web.reader_process.NICENESS = 1, 2
    asyncio.Handle._run = _told(asyncio.Handle._run)  # type: ignore[attr-defined,method-assign]  # not in its stubs
    freeze_gc()
    if _serve():
        sys.exit(service.commands.cli.main())
