# pyright: reportPrivateImportUsage=false
# Numba sets the names of its config while it is imported.
import os
import subprocess
import sys
import time

import numba

from mjris.jit.compiled import _cache_dir, _remove_unused

BEHIND_THE_END = """
import numpy as np
from mjris.jit.compiled import compiled

@compiled
def at(numbers, index):
    return numbers[index]

assert at(np.arange(3.0), 2) == 2
at(np.arange(3.0), 3)
"""


def test_only_results_that_nobody_began_with_for_a_day_are_removed(tmp_path):
    own, recent, unused = (tmp_path / f"compiled-{number:012x}" for number in range(3))
    foreign = tmp_path / "compiled-elsewhere"
    for folder in (own, recent, unused, foreign):
        folder.mkdir()
        (folder / "result").touch()
    now = time.time()
    os.utime(recent, (now - 3600, now - 3600))
    for folder in (unused, foreign):
        os.utime(folder, (now - 2 * 86400, now - 2 * 86400))
    _remove_unused(own)
    assert set(tmp_path.iterdir()) == {own, recent, foreign}


def test_indices_are_checked_if_asked_for(tmp_path):
    script = tmp_path / "behind.py"
    script.write_text(BEHIND_THE_END)
    path = os.pathsep.join(sys.path)
    checked = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": path}
    done = subprocess.run([sys.executable, str(script)], env=checked, capture_output=True, text=True)
    assert done.returncode == 1
    assert "IndexError" in done.stderr.splitlines()[-1]


def test_checked_and_unchecked_results_are_kept_apart(tmp_path, monkeypatch):
    folders = set()
    for checked in (None, 0, 1):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", checked)
        folders.add(_cache_dir.__wrapped__(str(tmp_path)))
    assert len(folders) == 2
