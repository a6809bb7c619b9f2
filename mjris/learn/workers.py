"""Cells side by side: stacked or one by one in this process, or spread over worker processes.

The last two give the same numbers, the stack gives them but for rounding.
"""

import multiprocessing
import os
from collections.abc import Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Literal, Protocol, TypeVar

import numpy as np
import torch

from mjris.config import Config, ConfigError
from mjris.env import OfficeEnv
from mjris.learn.federation import Cell, EnvFactory, EpisodeMetrics, State
from mjris.learn.stacked import Results, StackedCells

T = TypeVar("T")
Arrays = Mapping[str, np.ndarray]
"""A `State` on its way between processes; torch would send tensors through shared file descriptors instead."""


_STACK_GAIN = 3
"""Worker processes that a stack outruns, as measured on the office preset with one thread."""


class Cells(Protocol):
    """All cells of a run."""

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell, in the order of the cells."""
        ...

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell u to cell_u.zip in `folder`, which must exist."""
        ...

    def close(self) -> None:
        """Release environments, files and processes."""
        ...


def backend(config: Config, make_env: EnvFactory = OfficeEnv) -> Literal["stacked", "processes"]:
    """How the cells of `config` will learn: as asked for, or else the faster way on this machine.

    Only offices are stepped together; other environments gain little from a stack.
    """
    if config.federation.backend != "auto":
        return config.federation.backend
    return "stacked" if make_env is OfficeEnv and num_workers(config) <= _STACK_GAIN else "processes"


def describe(config: Config) -> str:
    """How the cells of a run learn, in a few words."""
    cells, workers = config.federation.num_cells, num_workers(config)
    if backend(config) == "stacked":
        return f"{cells} cells learn as one stack in this process"
    if workers == 1:
        return f"{cells} cells learn one after the other in this process"
    return f"{cells} cells learn in {workers} worker processes"


def check_device(config: Config, make_env: EnvFactory, device: str) -> None:
    """Raise `ConfigError` for a device that is not there, or that the cells of `config` have no use for."""
    if device != "cpu" and backend(config, make_env) != "stacked":
        raise ConfigError(f"device: {device!r} is not allowed: only a stack of agents learns elsewhere than on the CPU")
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device: 'cuda' is not allowed: torch finds none here")


def num_workers(config: Config) -> int:
    """Worker processes of the processes backend."""
    return min(config.federation.workers or os.cpu_count() or 1, config.federation.num_cells)


def open_cells(config: Config, make_env: EnvFactory, log_dir: Path | None = None, device: str = "cpu") -> Cells:
    """The cells of `config`, stacked in this process, or cell by cell in it or in workers, as `federation` says.

    `make_env` must be importable by name where there are workers. With `log_dir`, cell u logs to cell_u in it. The
    agents of a stack learn on `device`.
    """
    if backend(config, make_env) == "stacked":
        return StackedCells(config, make_env, log_dir, device)
    if num_workers(config) == 1:
        return LocalCells(config, range(config.federation.num_cells), make_env, log_dir)
    return WorkerCells(config, num_workers(config), make_env, log_dir)


class LocalCells:
    """Cells in this process, one after the other."""

    def __init__(self, config: Config, indices: range, make_env: EnvFactory, log_dir: Path | None):
        # One thread everywhere: more do not help networks of this size, and the order of sums stays the same.
        torch.set_num_threads(1)
        self._cells = {u: Cell(config, u, make_env, log_dir and log_dir / f"cell_{u}") for u in indices}

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell."""
        return [cell.train(round_, params) for cell in self._cells.values()]

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell."""
        for u, cell in self._cells.items():
            cell.save(folder / f"cell_{u}.zip", params)

    def close(self) -> None:
        """`Cell.close` of every cell."""
        for cell in self._cells.values():
            cell.close()


class WorkerCells:
    """Cells in worker processes: cell u lives in worker u modulo the number of workers.

    An exception in a worker is raised here, once the other workers have finished what they were asked for.
    """

    def __init__(self, config: Config, workers: int, make_env: EnvFactory, log_dir: Path | None):
        self._num_cells = config.federation.num_cells
        # One executor a worker, because a pool of several gives no say in which of them a cell stays.
        # Spawned, because a fork of a process in which torch and OpenGL have threads may hang.
        context = multiprocessing.get_context("spawn")
        self._workers = [ProcessPoolExecutor(max_workers=1, mp_context=context) for _ in range(workers)]
        try:
            _wait(
                [
                    pool.submit(_open, config, range(w, self._num_cells, workers), make_env, log_dir)
                    for w, pool in enumerate(self._workers)
                ]
            )
        except BaseException:
            self.close()
            raise

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell."""
        arrays = None if params is None else _to_arrays(params)
        shares = _wait([pool.submit(_train, round_, arrays) for pool in self._workers])
        workers = len(self._workers)
        results = (shares[u % workers][u // workers] for u in range(self._num_cells))
        return [(_to_tensors(local), metrics) for local, metrics in results]

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell."""
        arrays = None if params is None else _to_arrays(params)
        _wait([pool.submit(_save, folder, arrays) for pool in self._workers])

    def close(self) -> None:
        """End the worker processes."""
        for pool in self._workers:
            pool.shutdown(cancel_futures=True)


def _wait(futures: list[Future[T]]) -> list[T]:
    """The results of all futures; raises the first exception."""
    return [future.result() for future in futures]


# What follows runs in the workers, each of which keeps the cells of its own here.
_own: LocalCells


def _open(config: Config, indices: range, make_env: EnvFactory, log_dir: Path | None) -> None:
    global _own
    _own = LocalCells(config, indices, make_env, log_dir)


def _train(round_: int, arrays: Arrays | None) -> list[tuple[Arrays, list[EpisodeMetrics]]]:
    results = _own.train(round_, None if arrays is None else _to_tensors(arrays))
    return [(_to_arrays(state), metrics) for state, metrics in results]


def _save(folder: Path, arrays: Arrays | None) -> None:
    _own.save(folder, None if arrays is None else _to_tensors(arrays))


def _to_arrays(state: State) -> Arrays:
    return {key: tensor.numpy() for key, tensor in state.items()}


def _to_tensors(arrays: Arrays) -> State:
    return {key: torch.as_tensor(array) for key, array in arrays.items()}
