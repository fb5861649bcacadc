"""What this process may use of its machine: cores and memory, as affinity and control groups limit them."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_GROUPS, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def usable_cores() -> int:
    """Cores that this process may use: those of its affinity, or the time of fewer that its container gets."""
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    times = _limits("cpu", ("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))
    return max(1, min([cores, *(math.ceil(quota / period) for quota, period in times if quota > 0)]))  # -1: no limit


def usable_memory() -> int:
    """Bytes that this process may have: those of the machine, or fewer that its container gets."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min([machine, *(most for most, in _limits("memory", ("memory.max",), ("memory.limit_in_bytes",)))])


def _limits(controller: str, *names: tuple[str, ...]) -> Iterator[list[int]]:
    """The numbers in files of these names, together, of each limited control group around this process, of version 2
    and 1 (the Linux kernel's cgroup-v2.rst, sched-bwc.rst and cgroup-v1/memory.rst)."""
    with suppress(OSError):
        for line in _OWN.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                for folder in _around(_GROUPS / (controller if controllers else ""), path):
                    yield from _numbers(folder, names)


def _around(top: Path, path: str) -> Iterator[Path]:
    """A group and those around it; in a container the path may be the host's, and only the top is there."""
    group = top / path.strip("/")
    yield from (group, *(one for one in group.parents if one.is_relative_to(top)))


def _numbers(folder: Path, names: tuple[tuple[str, ...], ...]) -> Iterator[list[int]]:
    for together in names:
        with suppress(OSError, ValueError):  # no such file, or 'max'
            yield [int(word) for name in together for word in (folder / name).read_text().split()]
