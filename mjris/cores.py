"""How many cores this process may use, which may be fewer than the machine has."""

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath


def usable_cores(root: Path = Path("/")) -> int:
    """The cores that affinity and the CPU quotas of this process's control groups leave it, at least 1.

    A quota of one and a half cores counts as two. The files of the control groups are those under `root`.
    """
    # Only Linux has affinities.
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [quota for folder in _control_groups(root) if (quota := _quota(folder)) is not None]
    return max(1, min([allowed, *map(math.ceil, quotas)]))


def _control_groups(root: Path) -> Iterator[Path]:
    """Folders of the control groups that share out the CPU: this process's own, and those above it."""
    table, mounts = root / "proc" / "self" / "cgroup", root / "sys" / "fs" / "cgroup"
    for line in table.read_text().splitlines() if table.exists() else ():
        _, controllers, path = line.split(":", 2)
        # Version 2 names no controllers; version 1 has a mount for each.
        if controllers == "" or "cpu" in controllers.split(","):
            mount = mounts / "cpu" if controllers else mounts
            own = PurePosixPath(path.removeprefix("/"))
            # In a container, the path may be that of the host, whose root is mounted here.
            yield from (mount / group for group in (own, *own.parents))


def _quota(folder: Path) -> float | None:
    """The quota of a control group [cores], None where there is none."""
    both, quota, period = (folder / name for name in ("cpu.max", "cpu.cfs_quota_us", "cpu.cfs_period_us"))
    if both.exists():
        words = both.read_text().split()
    elif quota.exists() and period.exists():
        words = [quota.read_text().strip(), period.read_text().strip()]
    else:
        return None
    # Version 2 calls no quota "max", and version 1 calls it -1.
    return None if words[0] in ("max", "-1") else int(words[0]) / int(words[1])


CORES = usable_cores()
"""Those of this process when it began."""
