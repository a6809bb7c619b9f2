"""Cells side by side: stacked or one by one in this process, or spread over worker processes.

The last two give the same numbers, the stack gives them but for rounding.
"""

from pathlib import Path
from typing import Literal, Protocol

import torch

from mjris.config import Config, ConfigError
from mjris.cores import CORES
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.federation import Cell, EnvFactory, State
from mjris.learn.remote import Remotes
from mjris.learn.spread import StackedCells, in_words, num_stacks
from mjris.learn.stacked import Results


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
    return "stacked" if make_env is OfficeEnv else "processes"


def describe(config: Config, device: str = "cpu", make_env: EnvFactory = OfficeEnv) -> str:
    """How the cells of a run learn, in a few words."""
    cells, workers = config.federation.num_cells, num_workers(config)
    if backend(config, make_env) == "stacked":
        return in_words(cells, num_stacks([config], make_env, device))
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
    return min(config.federation.workers or CORES, config.federation.num_cells)


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
    """Cells in worker processes: cell u lives in worker u modulo the number of workers."""

    def __init__(self, config: Config, workers: int, make_env: EnvFactory, log_dir: Path | None):
        self._num_cells, self._num_workers = config.federation.num_cells, workers
        shares = [range(w, self._num_cells, workers) for w in range(workers)]
        self._workers = Remotes(LocalCells, [(config, share, make_env, log_dir) for share in shares])

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell."""
        shares = self._workers.call("train", round_, params)
        return [shares[u % self._num_workers][u // self._num_workers] for u in range(self._num_cells)]

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell."""
        self._workers.call("save", folder, params)

    def close(self) -> None:
        """End the worker processes."""
        self._workers.close()
