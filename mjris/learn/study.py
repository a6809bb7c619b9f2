"""Many training runs in a folder, each kept under a hash of its config: what is finished is not trained again."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from mjris.config import Config
from mjris.env import OfficeEnv
from mjris.learn.federation import EnvFactory, EpisodeMetrics
from mjris.learn.run import train_many

Report = Callable[[int, int, list[EpisodeMetrics]], None]
"""Is called after every round with the stack's number, how many there are, and the metrics of its episodes."""


def run_folder(config: Config, folder: Path) -> Path:
    """Where the run of a config is kept: under the first 12 digits of the hash of its JSON."""
    return folder / hashlib.sha256(config.to_json().encode()).hexdigest()[:12]


def train_missing(
    configs: Sequence[Config], folder: Path, *, report: Report, make_env: EnvFactory = OfficeEnv
) -> list[Path]:
    """The run folders of `configs`, in order; runs that are not there are trained, like ones together in a stack.

    Runs of a stack differ in their seeds only. Training happens in a temporary folder beside; a run appears under its
    name when it is complete. Raises what `train_many` raises.
    """
    stacks: dict[Config, list[Config]] = {}
    for config in dict.fromkeys(configs):
        if not run_folder(config, folder).is_dir():
            stacks.setdefault(replace(config, seed=0), []).append(config)
    folder.mkdir(parents=True, exist_ok=True)
    for number, stack in enumerate(stacks.values(), 1):
        with TemporaryDirectory(prefix="unfinished_", dir=folder) as unfinished:
            outs = [run_folder(config, Path(unfinished)) for config in stack]
            progress = partial(report, number, len(stacks))
            train_many(stack, outs, report=progress, make_env=make_env)
            for config, out in zip(stack, outs, strict=True):
                out.rename(run_folder(config, folder))
    return [run_folder(config, folder) for config in configs]
