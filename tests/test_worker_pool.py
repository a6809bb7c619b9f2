import numpy as np
import pytest

from mjris.config import preset
from mjris.envs.worker_pool import Part, SpreadTask
from mjris.simulation.streams import CellId

CELLS = [CellId(3, cell) for cell in range(3)]


@pytest.fixture
def spread():
    task = SpreadTask(preset("paper"), CELLS, 2)
    yield task
    task.close()


def test_parts_that_have_travelled_are_those_of_one_process(spread):
    alone = SpreadTask(preset("paper"), CELLS, 1)
    np.testing.assert_array_equal(spread.reset(None), alone.reset(None))
    rng = np.random.default_rng(0)
    slots = []
    for _ in range(3):
        action = rng.uniform(-1, 1, (3, spread.action_size))
        parts, (expected,) = spread.step(action), alone.step(action)
        slots.append((parts[1], parts[1].arrays()[2].copy()))
        columns = zip(*(part.arrays() for part in parts), strict=True)
        for found, wanted in zip(columns, expected.arrays(), strict=True):
            np.testing.assert_array_equal(np.concatenate(found), wanted)
        again = Part.of(expected.arrays())
        assert again.columns.constraints._asdict().keys() == expected.columns.constraints._asdict().keys()
        assert again.columns.clearance_m is expected.columns.clearance_m
    # What was given stays as it was while later slots are written over the same memory.
    for part, rates_bps in slots:
        np.testing.assert_array_equal(part.columns.rates_bps, rates_bps)
    assert not np.array_equal(slots[0][1], slots[1][1])


def test_a_worker_that_is_killed_is_told_in_one_sentence(spread):
    spread.reset(None)
    action = np.zeros((3, spread.action_size))
    spread.step(action)
    (worker,) = spread._others
    worker._process.kill()
    worker._process.join()
    for _ in range(2):
        with pytest.raises(RuntimeError, match="a worker process of the environment has ended by itself"):
            spread.step(action)


def test_what_goes_wrong_in_a_worker_is_raised_here(spread):
    spread.reset(None)
    (worker,) = spread._others
    worker.ask("step", np.zeros((1, 3)))
    with pytest.raises(ValueError, match="action: an array of shape"):
        worker.answer()
