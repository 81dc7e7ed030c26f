import asyncio
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S, eventually, soon
from support.extents import first_quick
from support.worker_jobs import (
    TRACEBACK,
    Stumble,
    greeting_and_pid,
    prepare,
    share,
    stay,
    stumble,
    wait_for,
)

from service.processing.worker_pool import WorkerPool
from service.processing.worker_slot import JobLostError, WorkerStartError


def pool_of(slots: int, deadline_s: float = 10.0) -> WorkerPool:
    return WorkerPool(slots=slots, deadline_s=deadline_s, prepare=prepare, context="hello")


async def test_each_slot_is_one_warm_process_of_its_own():
    async with pool_of(2) as pool:
        answers = await asyncio.gather(*(pool.run(partial(greeting_and_pid, f"job {i}")) for i in range(6)))
        assert [text for text, _ in answers] == [f"hello job {i}" for i in range(6)]
        assert {pid for _, pid in answers} == set(pool.pids)
        assert len(set(pool.pids)) == 2
        assert os.getpid() not in pool.pids


WAYS = {"kill": "worker_crash", "crash": "worker_crash", "hog": "worker_crash", "raise": "worker_crash"}
WAYS |= {"hang": "deadline", "loop": "deadline"}
"""Ways in which a job fails, and the reason of its loss."""


def deadline_s(way: str) -> float:
    return 1.0 if WAYS[way] == "deadline" else 60.0


@pytest.mark.parametrize("way", first_quick(WAYS))
async def test_one_failure_costs_one_retry_in_a_fresh_process(way: str, tmp_path: Path):
    async with pool_of(1, deadline_s(way)) as pool:
        (before,) = pool.pids
        assert await pool.run(partial(stumble, Stumble(tmp_path, way, failures=1))) == "done"
        first, second = noted_pids(tmp_path)
        assert first == before
        assert [second] == pool.pids
        assert pool.restarts == 1
        assert WAYS[way] in (pool.trouble or "")
        await asyncio.to_thread(eventually, lambda: not process_exists(first))


@pytest.mark.parametrize("way", first_quick(WAYS))
async def test_the_second_failure_loses_this_job_alone(way: str, tmp_path: Path):
    async with pool_of(1, deadline_s(way)) as pool:
        with pytest.raises(JobLostError) as lost:
            await pool.run(partial(stumble, Stumble(tmp_path, way, failures=9)))
        assert lost.value.reason == WAYS[way]
        assert len(noted_pids(tmp_path)) == 2
        text, _ = await pool.run(partial(greeting_and_pid, "again"))
        assert text == "hello again"


async def test_the_traceback_is_for_the_journal_and_its_last_line_for_clients(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    async with pool_of(1) as pool:
        with pytest.raises(JobLostError) as lost:
            await pool.run(partial(stumble, Stumble(tmp_path, "raise", failures=2)))
    assert lost.value.detail == "FileNotFoundError: 3 mm/s: 'mesh.ply'"
    assert [TRACEBACK in entry.message for entry in caplog.records if entry.levelname == "ERROR"] == [
        True
    ] * 2


async def test_a_host_without_a_free_file_is_not_taken_for_a_fault_of_the_job(tmp_path: Path):
    async with pool_of(1) as pool:
        for way, is_hosts in (("no file", True), ("raise", False)):
            notes = tmp_path / way
            notes.mkdir()
            with pytest.raises(JobLostError) as lost:
                await pool.run(partial(stumble, Stumble(notes, way, failures=2)))
            assert lost.value.is_hosts == is_hosts


async def test_a_worker_killed_while_idle_is_replaced():
    async with pool_of(1) as pool:
        (pid,) = pool.pids
        os.kill(pid, signal.SIGKILL)
        text, other = await pool.run(partial(greeting_and_pid, "still here"))
        assert text == "hello still here"
        assert other != pid


@pytest.mark.full
async def test_a_killed_fork_server_costs_retries_and_no_process_stays_behind():
    async with pool_of(2) as pool:
        before = list(pool.pids)
        for is_with_a_worker in (False, True) * 5:
            for pid in [*fork_servers(), *pool.pids[: int(is_with_a_worker)]]:
                os.kill(pid, signal.SIGKILL)
            answers = await asyncio.gather(
                *(pool.run(partial(greeting_and_pid, f"job {i}")) for i in range(4))
            )
            assert [text for text, _ in answers] == [f"hello job {i}" for i in range(4)]
            before += pool.pids
        eventually(lambda: not any(process_exists(pid) for pid in set(before) - set(pool.pids)))


def fork_servers() -> list[int]:
    """The one that runs; none when it was killed and no process was started since."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(FileNotFoundError, ProcessLookupError):
            parent = int((path / "stat").read_text().rsplit(") ", 1)[1].split()[1])
            if parent == os.getpid() and b"forkserver" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


async def test_without_memory_the_kernel_kills_a_worker_first():
    async with pool_of(1) as pool:
        (pid,) = pool.pids
        own = await asyncio.to_thread(Path("/proc/self/oom_score_adj").read_text)
        assert int((Path("/proc") / str(pid) / "oom_score_adj").read_text()) > int(own)


async def test_processes_share_what_is_to_be_compiled_and_are_renewed_while_a_job_comes(tmp_path: Path):
    pool = WorkerPool(slots=2, deadline_s=PATIENCE_S, prepare=share, context=tmp_path)
    await pool.start()
    before = pool.pids
    (tmp_path / "hold").touch()
    renewing = asyncio.create_task(pool.renew(idle_s=0))
    while len(multiprocessing.active_children()) < 3:  # noqa: ASYNC110 - there is no event to wait for
        await asyncio.sleep(0.01)
    job = asyncio.create_task(pool.run(partial(wait_for, tmp_path / "go")))
    await asyncio.sleep(0.1)
    (tmp_path / "hold").unlink()
    await asyncio.sleep(0.1)
    assert pool.pids == before
    (tmp_path / "go").touch()
    assert await job in before
    await renewing
    assert len(pool.pids) == 2
    assert not set(before) & set(pool.pids)
    pool.close()


async def test_a_process_is_renewed_when_there_is_nothing_to_measure(tmp_path: Path):
    pool = WorkerPool(slots=2, deadline_s=PATIENCE_S, prepare=share, context=tmp_path)
    await pool.start()
    before = pool.pids
    renewing = asyncio.create_task(pool.renew(idle_s=PATIENCE_S))
    (tmp_path / "go").touch()
    for _ in range(8):  # closer than calm
        await pool.run(partial(wait_for, tmp_path / "go"))
        await asyncio.sleep(0.01)
        assert len(multiprocessing.active_children()) == 2
    assert pool.pids == before
    renewing.cancel()
    await asyncio.wait([renewing])
    await pool.renew(idle_s=0.1)
    assert not set(before) & set(pool.pids)
    pool.close()


async def test_a_worker_that_cannot_be_renewed_stays(tmp_path: Path):
    pool = WorkerPool(slots=1, deadline_s=PATIENCE_S, prepare=share, context=tmp_path)
    await pool.start()
    before = pool.pids
    (tmp_path / "broken").touch()
    (tmp_path / "go").touch()
    await pool.renew(idle_s=0)
    assert [await pool.run(partial(wait_for, tmp_path / "go"))] == before
    pool.close()


def test_what_workers_are_forked_with_has_no_thread():
    code = "import os, sys, pipeline.particle; sys.exit(len(os.listdir('/proc/self/task')))"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 1


async def test_a_worker_that_cannot_start_is_fatal():
    pool = WorkerPool(slots=1, deadline_s=5, prepare=prepare, context="die")
    with pytest.raises(WorkerStartError):
        await pool.start()


async def test_a_worker_that_cannot_be_replaced_is_tried_until_it_can(tmp_path: Path):
    """As where the kernel kills each new process for want of memory: that ended the daemon."""
    (notes := tmp_path / "notes").mkdir()
    pool = WorkerPool(slots=1, deadline_s=PATIENCE_S, prepare=share, context=tmp_path, retry_s=0.01)
    await pool.start()
    (tmp_path / "broken").touch()
    job = asyncio.create_task(pool.run(partial(stumble, Stumble(notes, "kill", 1))))
    await soon(lambda: "failed to start 3 times" in (pool.trouble or ""))
    assert not job.done()
    (tmp_path / "broken").unlink()
    assert await job == "done"
    pool.close()


async def test_processes_that_rest_come_again_with_the_next_job_and_not_after_the_end():
    pool = WorkerPool(slots=2, deadline_s=PATIENCE_S, prepare=prepare, context="hello", rest_s=0.0)
    pids = []
    for number in range(2):
        assert pool.pids == []
        text, pid = await pool.run(partial(greeting_and_pid, f"job {number}"))
        assert text == f"hello job {number}"
        pids.append(pid)
        await soon(lambda: pool.pids == [])
    assert len(set(pids)) == 2
    pool.close()
    with pytest.raises(asyncio.CancelledError):
        await pool.run(partial(greeting_and_pid, "late"))
    assert pool.pids == []


async def test_closing_ends_what_runs(tmp_path: Path):
    pool = pool_of(1, PATIENCE_S)
    job = asyncio.create_task(pool.run(partial(stumble, Stumble(tmp_path, "hang", failures=1))))
    await soon(lambda: noted_pids(tmp_path) != [])
    pool.close()
    await asyncio.wait([job])
    assert job.cancelled()
    assert (pool.pids, pool.restarts) == ([], 0)


async def test_a_job_that_is_given_up_while_its_process_starts_leaves_none_unprepared(tmp_path: Path):
    pool = WorkerPool(slots=1, deadline_s=PATIENCE_S, prepare=share, context=tmp_path)
    (tmp_path / "hold").touch()
    (tmp_path / "go").touch()
    given_up = asyncio.create_task(pool.run(partial(wait_for, tmp_path / "go")))
    await soon(lambda: pool.pids != [])
    (before,) = pool.pids
    given_up.cancel()
    await asyncio.wait([given_up])
    (tmp_path / "hold").unlink()
    assert await pool.run(partial(wait_for, tmp_path / "go")) != before
    assert {"a", "b", "c"} <= set(await asyncio.to_thread(os.listdir, tmp_path))
    pool.close()


async def test_what_takes_long_has_a_process_of_its_own(tmp_path: Path):
    async with pool_of(1, PATIENCE_S) as pool:
        assert await pool.run(partial(stumble, Stumble(tmp_path, "kill", 0))) == "done"
    (pid,) = noted_pids(tmp_path)
    assert pid != os.getpid()
    others = set(multiprocessing.active_children())

    async def stay_apart() -> None:
        async with pool_of(1, 60.0) as pool:
            await pool.run(partial(stay))

    staying = asyncio.create_task(stay_apart())
    while not (started := set(multiprocessing.active_children()) - others):  # noqa: ASYNC110 - there is no event to wait for
        await asyncio.sleep(0.01)
    staying.cancel()
    await asyncio.wait([staying])
    async with asyncio.timeout(PATIENCE_S):
        while any(process_exists(each) for each in [pid, *(process.pid for process in started)]):  # noqa: ASYNC110 - as above
            await asyncio.sleep(0.01)


DAEMON = """
import asyncio, sys
from functools import partial
from service.processing.worker_pool import WorkerPool
from support.worker_jobs import prepare, stay

async def main():
    pool = WorkerPool(slots=2, deadline_s=60, prepare=prepare, context="hello")
    await pool.start()
    print(*pool.pids, flush=True)
    await pool.run(partial(stay))

if __name__ == "__main__":
    asyncio.run(main())
"""


def test_no_worker_outlives_a_killed_daemon(tmp_path: Path):
    script = tmp_path / "fake_daemon.py"
    script.write_text(DAEMON)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, env=environment) as daemon:
        assert daemon.stdout is not None
        pids = [int(pid) for pid in daemon.stdout.readline().split()]
        assert len(pids) == 2
        assert all(process_exists(pid) for pid in pids)
        daemon.kill()
    deadline = time.monotonic() + 10
    while any(process_exists(pid) for pid in pids):
        assert time.monotonic() < deadline, "orphaned workers"
        time.sleep(0.01)


def noted_pids(notes: Path) -> list[int]:
    """Who attempted, in order."""
    return [int(note.name.split("-")[1]) for note in sorted(notes.iterdir())]


def process_exists(pid: int) -> bool:
    """Return whether the process runs; an unreaped zombie does not."""
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except FileNotFoundError:
        return False
