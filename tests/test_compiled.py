import os
import time

from mjris.compiled import _remove_unused


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
