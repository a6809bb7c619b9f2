"""How loops over cells, people and bricks are compiled: array operations on so few numbers are all overhead."""

# pyright: reportAttributeAccessIssue=false, reportPrivateImportUsage=false
# Numba sets the names of its config while it is imported.

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable)

_UNUSED_S = 24 * 3600
"""Results that no process has begun with for so long are removed."""


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers when it is first called, and keep the result on disk.

    A division by zero gives inf or nan, as in NumPy.
    """
    return _compiled(function, forceinline=False, fastmath=False)


def reducing(function: F) -> F:
    """`compiled`, and sums may be taken in any order, so that those of many numbers are done in vectors."""
    return _compiled(function, forceinline=False, fastmath={"reassoc", "contract", "nsz"})


def inlined(function: F) -> F:
    """`compiled`, and again into each of its callers: only loops that call nothing are done in vectors."""
    return _compiled(function, forceinline=True, fastmath=False)


def _compiled(function: F, forceinline: bool, fastmath: bool | set[str]) -> F:
    # Numba itself notices changes of the function's own file, but not of those that it calls or takes constants from.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache_dir(before))
    try:
        return cast(
            F, numba.njit(cache=True, error_model="numpy", forceinline=forceinline, fastmath=fastmath)(function)
        )
    finally:
        numba.config.CACHE_DIR = before


@cache
def _cache_dir(wanted: str) -> Path:
    """Where results are kept for this state of the package's sources: where Numba was told to, or with the package."""
    package = Path(__file__).parent.parent
    stats = [(str(path.relative_to(package)), path.stat()) for path in sorted(package.rglob("*.py"))]
    # With and without NUMBA_BOUNDSCHECK=1, which has indices checked, the same source gives different results.
    checked = bool(numba.config.BOUNDSCHECK)
    state = repr([checked, *((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats)])
    own = package / "__pycache__" if os.access(package, os.W_OK) else Path.home() / ".cache" / "mjris"
    folder = (Path(wanted) if wanted else own) / f"compiled-{hashlib.sha256(state.encode()).hexdigest()[:12]}"
    folder.mkdir(parents=True, exist_ok=True)
    folder.touch()
    _remove_unused(folder)
    return folder


def _remove_unused(folder: Path) -> None:
    """Remove the results of other states of the sources, unless a process may still run that began with them."""
    for other in folder.parent.glob("compiled-" + 12 * "[0-9a-f]"):
        # Whoever begins touches its folder; another process may remove the same one at the same time.
        with suppress(FileNotFoundError):
            if time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)
