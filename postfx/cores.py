"""How many threads can run at once."""

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
    return max(1, min([cores, *map(math.ceil, _quotas(_GROUPS, _OWN))]))


def _quotas(groups: Path, own: Path) -> Iterator[float]:
    """Cores whose time each limited control group around this process gets: `cpu.max` of version 2, `cpu.cfs_quota_us`
    over `cpu.cfs_period_us` of version 1 (the Linux kernel's cgroup-v2.rst and sched-bwc.rst)."""
    with suppress(OSError):
        for line in own.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or "cpu" in controllers.split(","):
                yield from _limits(groups / ("cpu" if controllers else ""), path)


def _limits(top: Path, path: str) -> Iterator[float]:
    """Of a group and those around it; in a container the path may be the host's, and only the top is there."""
    group = top / path.strip("/")
    for folder in (group, *(one for one in group.parents if one.is_relative_to(top))):
        for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
            with suppress(OSError, ValueError):  # no such file, or 'max'
                quota, period = map(int, " ".join((folder / name).read_text() for name in names).split())
                if quota > 0:  # -1: no limit
                    yield quota / period
