"""Many runs in a folder, each kept under a hash of its config: what is finished is not trained again."""

import gc
import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mjris.config import Config
from mjris.cores import CORES
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.federation import EnvFactory, EpisodeMetrics
from mjris.learn.run import train_many
from mjris.world.panels import all_elements

Report = Callable[[int, int], None]
"""Is called now and then with how many episodes of all missing runs are over, and how many there are."""

_MOST_AGENTS = 20
"""Agents of a stack: more cost as much each, and an interruption loses the stacks that are not finished."""
_GLANCE_S = 0.5
"""How often the progress of the stacks is looked at [s]."""


def run_folder(config: Config, folder: Path) -> Path:
    """Where the run of a config is kept: under the first 12 digits of the hash of its JSON.

    Raises `ConfigError` for a config without a seed, whose run could not be found again.
    """
    config.named_seed  # noqa: B018 - raises
    return folder / hashlib.sha256(config.to_json().encode()).hexdigest()[:12]


def train_missing(
    configs: Sequence[Config], folder: Path, *, report: Report, make_env: EnvFactory = OfficeEnv
) -> list[Path]:
    """The run folders of `configs`, in order; runs that are not there are trained, like ones together in a stack.

    One stack learns on each core, in a process of its own; `make_env` must be importable by name. Training happens in
    temporary folders beside; runs appear under their names when their stack is complete. Raises what `train_many`
    raises, when the stacks that have begun are over.
    """
    missing = [config for config in dict.fromkeys(configs) if not run_folder(config, folder).is_dir()]
    folder.mkdir(parents=True, exist_ok=True)
    total = sum(config.federation.num_cells * config.federation.episodes for config in missing)
    context = get_context("spawn")
    queue: SimpleQueue[int] = context.SimpleQueue()
    with ProcessPoolExecutor(CORES, context, _listen_to, (queue,)) as pool:
        stacks = [pool.submit(_train_stack, stack, folder, make_env) for stack in _stacks(missing, CORES)]
        try:
            _wait(stacks, queue, lambda done: report(done, total))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [run_folder(config, folder) for config in configs]


def _wait(stacks: Sequence[Future[None]], queue: "SimpleQueue[int]", report: Callable[[int], None]) -> None:
    """Until all stacks are over; raises what one of them raises."""
    done, running = 0, set(stacks)
    while running:
        over, running = wait(running, _GLANCE_S)
        while not queue.empty():
            done += queue.get()
        report(done)
        for stack in over:
            stack.result()


def _stacks(configs: Sequence[Config], cores: int) -> list[list[Config]]:
    """Configs that can share a stack, in stacks of about equal sizes, for every core as many."""
    alike: dict[Any, list[Config]] = {}
    for config in configs:
        alike.setdefault(_shape(config), []).append(config)
    stacks = []
    for group in alike.values():
        agents = len(group) * group[0].federation.num_cells
        parts = min(len(group), cores * -(-agents // (cores * _MOST_AGENTS)))
        stacks += [group[part::parts] for part in range(parts)]
    return stacks


def _shape(config: Config) -> tuple[Any, ...]:
    """What the configs of a stack must have in common, see `StackedRuns`: sections, and what sizes follow from."""
    world, radio, task = config.world, config.radio, config.task
    sizes = world.num_users, world.pan == "action", radio.num_antennas, all_elements(config)
    agent = replace(config.agent, learning_rate=1.0)  # which may differ
    return agent, config.federation, task.slots, task.observation, task.phase_control, *sizes


# What follows runs in the processes that train.
_queue: "SimpleQueue[int]"


def _listen_to(queue: "SimpleQueue[int]") -> None:
    """Tell the main process through `queue` how many episodes are over."""
    global _queue
    _queue = queue


def _train_stack(stack: Sequence[Config], folder: Path, make_env: EnvFactory) -> None:
    def report(metrics: list[EpisodeMetrics]) -> None:
        _queue.put(len(metrics))

    with TemporaryDirectory(prefix="unfinished_", dir=folder) as unfinished:
        outs = [run_folder(config, Path(unfinished)) for config in stack]
        train_many(stack, outs, report=report, make_env=make_env, cores=1)
        for config, out in zip(stack, outs, strict=True):
            out.rename(run_folder(config, folder))
    # Agents refer to themselves in circles, and hold some 100 MiB a stack.
    gc.collect()
