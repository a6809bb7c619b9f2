"""How loops over cells, people and bricks are compiled: array operations on so few numbers are all overhead."""

# pyright: reportAttributeAccessIssue=false, reportPrivateImportUsage=false
# Numba sets the names of its config while it is imported.

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable)


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers when it is first called, and keep the result on disk.

    A division by zero gives inf or nan, as in NumPy.
    """
    # Numba itself notices changes of the function's own file, but not of those that it calls or takes constants from.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache_dir(before))
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))
    finally:
        numba.config.CACHE_DIR = before


@cache
def _cache_dir(wanted: str) -> Path:
    """Where results are kept for this state of the package's sources: where Numba was told to, or with the package."""
    package = Path(__file__).parent
    stats = [(str(path.relative_to(package)), path.stat()) for path in sorted(package.rglob("*.py"))]
    state = repr([(name, stat.st_mtime_ns, stat.st_size) for name, stat in stats])
    own = package / "__pycache__" if os.access(package, os.W_OK) else Path.home() / ".cache" / "mjris"
    return (Path(wanted) if wanted else own) / f"compiled-{hashlib.sha256(state.encode()).hexdigest()[:12]}"
