"""The parts of deploy/demo without its environment: the client against a real daemon, the refusals of the script."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.daemon_process import PATIENCE_S, DaemonProcess
from support.small_recording import write_small_recording

DEPLOY = Path(__file__).parents[2] / "deploy"
N_STONES = 3


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    folder = tmp_path_factory.mktemp("demo")
    write_small_recording(folder / "recording", n_stones=N_STONES)
    with DaemonProcess(folder, folder / "recording") as daemon:
        daemon.hear("READY=1")
        yield daemon


@contextmanager
def watching(daemon: DaemonProcess, process: int, *options: str) -> Iterator[subprocess.Popen[str]]:
    base = daemon.url("").removesuffix("/api/v1")
    # a process started in the background, as a gate may be, ignores Ctrl-C, and so do those that it starts
    command = ["env", "--default-signal=INT", sys.executable, DEPLOY / "watch.py", base]
    command += ["--while-process", str(process), *options]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as watch:
        try:
            yield watch
        finally:
            watch.kill()


def read_rows(watch: subprocess.Popen[str]) -> None:
    """Return once all stones are printed."""
    assert watch.stdout is not None
    while not re.match(rf" *{N_STONES} ", watch.stdout.readline()):
        assert watch.poll() is None


def test_every_stone_is_printed_and_accounted_for(daemon: DaemonProcess):
    with watching(daemon, daemon.process.pid, "--once") as watch:
        out, errors = watch.communicate(timeout=PATIENCE_S)
    assert (watch.returncode, errors) == (0, "")
    rows = re.findall(r"^ +(\d+)  (\S+) .* (measured) +(\w+) +\d+\.\d ", out, re.MULTILINE)
    assert [int(seq) for seq, *_ in rows] == list(range(1, N_STONES + 1))
    assert [bundle for _, bundle, *_ in rows] == [result["bundle"] for result in daemon.results()]
    assert out.endswith(f"\n{N_STONES} triggers = {N_STONES} measured + 0 rejected + 0 lost\n")


def test_stones_of_a_stranger_are_not_printed(daemon: DaemonProcess):
    with subprocess.Popen([sys.executable, "-c", ""]) as own:
        own.wait()
    with watching(daemon, own.pid) as watch:
        assert watch.communicate(timeout=PATIENCE_S) == ("", "the daemon ended\n")
    assert watch.returncode == 1


def test_ctrl_c_ends_it_quietly(daemon: DaemonProcess):
    with watching(daemon, daemon.process.pid) as watch:
        read_rows(watch)
        watch.send_signal(signal.SIGINT)
        assert watch.communicate(timeout=PATIENCE_S) == ("", "")
    assert watch.returncode == 130


def test_it_ends_with_the_daemon(daemon: DaemonProcess):
    with watching(daemon, daemon.process.pid) as watch:
        read_rows(watch)
        daemon.stop()
        assert watch.communicate(timeout=PATIENCE_S) == ("", "the daemon ended\n")
    assert watch.returncode == 1


@pytest.mark.parametrize(
    "arguments", [["--twice"], ["--lens"], ["--lens", "f1"], ["--rate", "10"], ["--gige", "--rate", "quick"]]
)
def test_unknown_arguments_are_refused(arguments: list[str]):
    done = subprocess.run([DEPLOY / "demo", *arguments], check=False, capture_output=True, text=True)
    usage = "usage: deploy/demo [--gige [--rate HZ]] [--once] [--lens f2|f4|f8|sharp]\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", usage)
