"""What processes take of the machine, from /proc, and how late results are."""

import os
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np


def rss_mb(pid: int) -> float:
    """Resident memory, with what is shared."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def own_mb(pid: int) -> float:
    """Memory that would be free again without this process: what is its alone (USS)."""
    fields = re.findall(r"^Private_\w+:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)
    return sum(map(int, fields)) * 1024 / 1e6


def pss_mb(pid: int) -> float:
    """Resident memory, of what is shared its part (PSS): the sum over processes is what they take together."""
    (kb,) = re.findall(r"^Pss: +(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)
    return int(kb) * 1024 / 1e6


def n_descriptors(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208 - a count


def n_threads(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/task"))  # noqa: PTH208 - a count


def cpu_s(pids: Iterable[int], *, with_ended_children: bool = False) -> float:
    """Processor time so far, of all their threads."""
    total = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        total += sum(map(int, fields[11 : 15 if with_ended_children else 13]))
    return total / os.sysconf("SC_CLK_TCK")


def thread_cpu_s(pid: int) -> dict[str, float]:
    """Processor time of its threads so far by their name, to the microsecond; those that have ended are not in it."""
    spent: defaultdict[str, float] = defaultdict(float)
    for task in Path(f"/proc/{pid}/task").iterdir():
        spent[(task / "comm").read_text().strip()] += int((task / "schedstat").read_text().split()[0]) / 1e9
    return spent


def percentiles(values: Sequence[float]) -> str:
    """Half, 95 %, 99 % and all are at most that."""
    if not len(values):
        return "-"
    return ", ".join(f"{value:.0f}" for value in np.quantile(values, [0.5, 0.95, 0.99, 1]))
