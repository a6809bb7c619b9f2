"""Where a run comes from: code, versions, machine and command, kept in its folder."""

import json
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from mjris.assets import assets_dir

PROVENANCE = "provenance.json"
_PACKAGES = ("numpy", "torch", "mujoco", "numba", "stable-baselines3", "gymnasium")
_SOURCES = Path(__file__).parents[1]


def write_provenance(folder: Path, backend: str) -> None:
    """Write provenance.json to a run folder whose training begins now; `backend` is how its cells learn, in words."""
    (folder / PROVENANCE).write_text(json.dumps(provenance(backend), indent=2) + "\n")


def provenance(backend: str) -> dict[str, Any]:
    """What is written: plain values by name.

    commit and dirty (whether package or assets differ from it) are null where the package is not one of the files of a
    git repository, or git is not there.
    """
    commit, dirty = _commit(_SOURCES)
    return {
        "commit": commit,
        "dirty": dirty,
        "mjris": _version("mjris"),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _PACKAGES},
        "backend": backend,
        "processor": _processor(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(sys.argv),
    }


def _commit(package: Path) -> tuple[str | None, bool | None]:
    """The commit that a package was checked out from, and whether it or the assets have changed since."""
    # Installed into a folder inside some other repository, it is none of that one's files.
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is None:
        return None, None
    commit, changes = _git(package, "rev-parse", "HEAD"), _git(package, "status", "--porcelain", ".", str(assets_dir()))
    return commit, None if changes is None else changes != ""


def _git(folder: Path, *words: str) -> str | None:
    """What git answers about a folder; None where it refuses or is missing."""
    try:
        answer = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=False)
    except OSError:
        return None
    return answer.stdout.strip() if answer.returncode == 0 else None


def _version(package: str) -> str | None:
    """The version of a package, None where it is only on the path and not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """The processor's name, as far as the system tells it."""
    table = Path("/proc/cpuinfo")
    lines = table.read_text().splitlines() if table.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
