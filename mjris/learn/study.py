"""Many training runs in a folder, each kept under a hash of its config: what is finished is not trained again."""

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

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

    Runs of a stack differ in their seeds only. Training happens in a folder beside, which is deleted at the next try
    if it was interrupted; a run appears under its name when it is complete. Raises what `train_many` raises.
    """
    stacks: dict[Config, list[Config]] = {}
    for config in dict.fromkeys(configs):
        if not run_folder(config, folder).is_dir():
            stacks.setdefault(replace(config, seed=0), []).append(config)
    unfinished = folder / "unfinished"
    shutil.rmtree(unfinished, ignore_errors=True)
    for number, stack in enumerate(stacks.values(), 1):
        outs = [run_folder(config, unfinished) for config in stack]
        train_many(
            stack, outs, report=lambda metrics, number=number: report(number, len(stacks), metrics), make_env=make_env
        )
        for config, out in zip(stack, outs, strict=True):
            out.rename(run_folder(config, folder))
    shutil.rmtree(unfinished, ignore_errors=True)
    return [run_folder(config, folder) for config in configs]
