"""The agents of one or several runs as stacks, one in every process."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mjris.config import Config
from mjris.cores import CORES
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.federation import EnvFactory, State
from mjris.learn.remote import Remotes
from mjris.learn.stacked import Results, StackedRuns, members_of


def open_runs(
    configs: Sequence[Config],
    make_env: EnvFactory,
    log_dirs: Sequence[Path | None],
    device: str = "cpu",
    cores: int = CORES,
) -> "StackedRuns | SpreadRuns":
    """`StackedRuns` in this process or, where that is faster, in as many as `num_stacks` says."""
    processes = num_stacks(configs, make_env, device, cores)
    if processes == 1:
        return StackedRuns(configs, make_env, log_dirs, device)
    return SpreadRuns(configs, make_env, log_dirs, processes)


def num_stacks(
    configs: Sequence[Config], make_env: EnvFactory = OfficeEnv, device: str = "cpu", cores: int = CORES
) -> int:
    """Stacks for the agents of these runs: one a core, or no more than `federation.workers` says.

    One where environments are no offices, which gain little, or agents learn elsewhere than on the CPU.
    """
    if make_env is not OfficeEnv or device != "cpu":
        return 1
    return min(configs[0].federation.workers or cores, cores, len(members_of(configs)))


def in_words(cells: int, stacks: int) -> str:
    """How cells learn in so many stacks, in a few words."""
    if stacks > 1:
        return f"{cells} cells learn as {stacks} stacks, one in each worker process"
    return f"{cells} cells learn as one stack in this process"


class SpreadRuns:
    """`StackedRuns` in parts, each in a worker process: within a round, agents need nothing of each other."""

    def __init__(
        self, configs: Sequence[Config], make_env: EnvFactory, log_dirs: Sequence[Path | None], processes: int
    ):
        members = members_of(configs)
        shares = [[members[i] for i in part] for part in np.array_split(np.arange(len(members)), processes)]
        self._stacks = Remotes(StackedRuns, [(configs, make_env, log_dirs, "cpu", share) for share in shares])

    def train(self, round_: int, params: Sequence[State | None]) -> list[Results]:
        """`StackedRuns.train`."""
        shares = self._stacks.call("train", round_, params)
        # Shares are in the order of runs and cells.
        return [[result for results in run for result in results] for run in zip(*shares, strict=True)]

    def save(self, run: int, folder: Path, params: State | None) -> None:
        """`StackedRuns.save`."""
        self._stacks.call("save", run, folder, params)

    def close(self) -> None:
        """End the processes."""
        self._stacks.close()


class StackedCells:
    """All cells of one run, in lockstep."""

    def __init__(self, config: Config, make_env: EnvFactory, log_dir: Path | None, device: str = "cpu"):
        self._runs = open_runs([config], make_env, [log_dir], device)

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell."""
        return self._runs.train(round_, [params])[0]

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell."""
        self._runs.save(0, folder, params)

    def close(self) -> None:
        """`Cell.close` of every cell."""
        self._runs.close()
