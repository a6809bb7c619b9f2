import os
from pathlib import Path

import pytest

from mjris.cores import usable_cores


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)


def write(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")


V1 = "4:memory:/a/b\n2:cpu,cpuacct:/a/b\n1:cpuset:/a"
CPU = "sys/fs/cgroup/cpu"


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 8),
        ({"proc/self/cgroup": "0::/"}, 8),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "max 100000"}, 8),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "300000 100000"}, 3),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "150000 100000"}, 2),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "5000 100000"}, 1),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "6400000 100000"}, 8),
        # The least of the group's own and of those above it; of others none.
        ({"proc/self/cgroup": "0::/a/b", "sys/fs/cgroup/a/cpu.max": "400000 100000"}, 4),
        (
            {
                "proc/self/cgroup": "0::/a/b",
                "sys/fs/cgroup/a/cpu.max": "400000 100000",
                "sys/fs/cgroup/a/b/cpu.max": "200000 50000",
                "sys/fs/cgroup/c/cpu.max": "100000 100000",
            },
            4,
        ),
        ({"proc/self/cgroup": V1, f"{CPU}/a/b/cpu.cfs_quota_us": "-1", f"{CPU}/a/b/cpu.cfs_period_us": "100000"}, 8),
        (
            {"proc/self/cgroup": V1, f"{CPU}/a/b/cpu.cfs_quota_us": "250000", f"{CPU}/a/b/cpu.cfs_period_us": "100000"},
            3,
        ),
        # A container sees the path of its host, and itself at the root.
        ({"proc/self/cgroup": V1, f"{CPU}/cpu.cfs_quota_us": "50000", f"{CPU}/cpu.cfs_period_us": "25000"}, 2),
    ],
)
def test_quotas_are_kept(tmp_path: Path, files: dict[str, str], cores: int):
    write(tmp_path, files)
    assert usable_cores(tmp_path) == cores


def test_affinity_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5})
    assert usable_cores(tmp_path) == 2


def test_where_there_is_no_affinity_all_cores_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    assert usable_cores(tmp_path) == 5
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cores(tmp_path) == 1
