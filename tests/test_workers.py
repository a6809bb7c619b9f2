import hashlib
import os

import pytest
import torch
from toy import BrokenToyEnv, ToyEnv, toy_config

from mjris.learn.federation import State, average
from mjris.learn.workers import LocalCells, WorkerCells, open_cells


def digest(state: State) -> str:
    text = hashlib.sha256()
    for key in sorted(state):
        text.update(key.encode())
        text.update(state[key].numpy().tobytes())
    return text.hexdigest()


class Surroundings(ToyEnv):
    """Reports from the process it lives in, in place of a clearance."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        threads = torch.get_num_threads() if os.environ.get("MUJOCO_GL") == "egl" else -1
        return observation, reward, terminated, truncated, info | {"clearance_m": threads, "collisions": os.getpid()}


def run(workers: int, seed: int = 0) -> tuple[list[str], list]:
    """Digests of all rounds and the metrics of a federation of three cells."""
    config = toy_config(seed=seed, agent={"network": "paper"}, num_cells=3, workers=workers)
    cells = open_cells(config, ToyEnv)
    assert isinstance(cells, LocalCells if workers == 1 else WorkerCells)
    digests, metrics, merged = [], [], None
    for round_ in (1, 2, 3):
        results = cells.train(round_, merged)
        merged = average([state for state, _ in results])
        digests += [digest(state) for state, _ in results] + [digest(merged)]
        metrics += [rows for _, rows in results]
    cells.close()
    return digests, metrics


def test_workers_give_the_same_numbers_as_this_process():
    here = run(workers=1)
    assert run(workers=2) == here
    assert len(set(here[0])) == 12
    assert [rows[0].cell for rows in here[1]] == [0, 1, 2] * 3


def test_numbers_follow_the_seed():
    here = run(workers=1)
    assert run(workers=1) == here
    assert not set(run(workers=1, seed=1)[0]) & set(here[0])


def test_workers_are_other_processes_with_one_thread_and_this_environment(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    cells = open_cells(toy_config(num_cells=3, workers=2), Surroundings)
    results = cells.train(1, None)
    cells.close()
    pids = [rows[0].collisions // 10 for _, rows in results]
    assert pids[0] == pids[2] != pids[1]
    assert os.getpid() not in pids
    assert [rows[0].clearance_m for _, rows in results] == [1.0] * 3


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_in_a_cell_reaches_the_caller(workers: int):
    cells = open_cells(toy_config(workers=workers), BrokenToyEnv)
    with pytest.raises(ArithmeticError, match="the floor gave way"):
        cells.train(1, None)
    cells.close()


def no_env(config, cell):
    raise OSError(f"no floor {cell}")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_at_the_start_reaches_the_caller(workers: int):
    with pytest.raises(OSError, match="no floor 0"):
        open_cells(toy_config(workers=workers), no_env)


@pytest.mark.parametrize(
    ("asked", "cores", "opened"), [(0, 8, 2), (0, 2, 2), (2, 1, 2), (5, 1, 2), (0, 1, 1), (1, 8, 1)]
)
def test_no_more_workers_than_asked_for_or_cells(monkeypatch, asked: int, cores: int, opened: int):
    monkeypatch.setattr("mjris.learn.workers.CORES", cores)

    def several(config, workers: int, *rest) -> int:
        return workers

    def one(*args) -> int:
        return 1

    monkeypatch.setattr("mjris.learn.workers.WorkerCells", several)
    monkeypatch.setattr("mjris.learn.workers.LocalCells", one)
    assert open_cells(toy_config(num_cells=2, workers=asked), ToyEnv) == opened
