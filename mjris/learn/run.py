"""A training run: rounds of local training and averaging, written to a run folder."""

import csv
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path

from mjris.config import Config, ConfigError
from mjris.cores import CORES
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.federation import EnvFactory, EpisodeMetrics, State, average, num_rounds
from mjris.learn.provenance import write_provenance
from mjris.learn.spread import in_words, num_stacks, open_runs
from mjris.learn.stacked import Results, members_of
from mjris.learn.workers import check_device, describe, open_cells
from mjris.simulation.streams import seeded

Report = Callable[[list[EpisodeMetrics]], None]
"""Is called after every round with the metrics of its episodes."""


def _silent(metrics: list[EpisodeMetrics]) -> None:
    """Report nothing."""


def train(
    config: Config, out: Path, *, report: Report = _silent, make_env: EnvFactory = OfficeEnv, device: str = "cpu"
) -> None:
    """Train all cells of `config` and write the run folder `out`.

    The folder gets config.json and provenance.json first and, after every round, the episodes' rows in metrics.csv and
    checkpoints/round_NNNN/cell_U.zip, which hold the averaged agents where there is averaging; tensorboard/cell_U
    follows while training. A config without a seed gets a fresh one. Stacked agents learn on `device`, "cpu" or "cuda".
    Raises `ConfigError` where `out` exists and is not an empty folder, or `device` cannot be used, and `Diverged` where
    an agent's losses or parameters are not finite any more: then the round is lost, and those before it are kept.
    """
    _check_new(out)
    config = seeded(config)
    # What is wrong with the layout or the task shows here, before anything is written.
    make_env(config, 0).close()
    check_device(config, make_env, device)
    _begin_folder(config, out, describe(config, device, make_env))
    with closing(open_cells(config, make_env, out / "tensorboard", device)) as cells:
        merged = None
        for round_ in range(1, num_rounds(config) + 1):
            results = cells.train(round_, merged)
            merged = _average(config, results)
            report(_write_round(out, round_, results, partial(cells.save, params=merged)))


def train_many(
    configs: Sequence[Config],
    outs: Sequence[Path],
    *,
    report: Report = _silent,
    make_env: EnvFactory = OfficeEnv,
    cores: int = CORES,
) -> None:
    """`train` several runs stacked, whatever their `federation.backend`; agents are averaged within their run.

    `report` gets the episodes of all runs; no more than `cores` are used. Raises `ConfigError` also where the configs
    differ in what a stack must have in common, see `StackedRuns`.
    """
    configs = [seeded(config) for config in configs]
    if len(set(outs)) < len(configs):
        raise ConfigError(f"out: {len(configs)} runs need a folder each")
    for out in outs:
        _check_new(out)
    log_dirs = [out / "tensorboard" for out in outs]
    with closing(open_runs(configs, make_env, log_dirs, cores=cores)) as runs:
        backend = in_words(len(members_of(configs)), num_stacks(configs, make_env, cores=cores))
        for config, out in zip(configs, outs, strict=True):
            _begin_folder(config, out, backend)
        merged: list[State | None] = [None] * len(configs)
        for round_ in range(1, num_rounds(configs[0]) + 1):
            everything = runs.train(round_, merged)
            merged = [_average(config, results) for config, results in zip(configs, everything, strict=True)]
            metrics = []
            for run, (out, results) in enumerate(zip(outs, everything, strict=True)):
                metrics += _write_round(out, round_, results, partial(runs.save, run, params=merged[run]))
            report(metrics)


def _begin_folder(config: Config, out: Path, backend: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    write_provenance(out, backend)
    (out / "config.json").write_text(config.to_json())
    _write_header(out / "metrics.csv")


def _average(config: Config, results: Results) -> State | None:
    """The averaged parameters of a run's cells, None where there is no averaging."""
    if not config.federation.averaging or len(results) == 1:
        return None
    return average([state for state, _ in results])


def _write_round(out: Path, round_: int, results: Results, save: Callable[[Path], None]) -> list[EpisodeMetrics]:
    """Write a round's metrics and checkpoints: its episodes, in order."""
    metrics = sorted((row for _, rows in results for row in rows), key=lambda row: (row.episode, row.cell))
    _append(out / "metrics.csv", metrics)
    # The folder appears under its name only when it is complete.
    unfinished = out / "checkpoints" / "unfinished"
    unfinished.mkdir(parents=True)
    save(unfinished)
    unfinished.rename(unfinished.with_name(f"round_{round_:04d}"))
    return metrics


def _check_new(out: Path) -> None:
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise ConfigError(f"out: {out} is not allowed: it exists already, and a run needs a new or empty folder")


def _write_header(path: Path) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerow(field.name for field in fields(EpisodeMetrics))


def _append(path: Path, metrics: list[EpisodeMetrics]) -> None:
    with path.open("a", newline="") as file:
        csv.writer(file).writerows(asdict(row).values() for row in metrics)
