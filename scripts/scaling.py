"""What a cell costs as there are more of them: simulating and training, time and memory; docs/scaling.csv and .png.

python scripts/scaling.py [--repeats R] [--most CELLS] [--out FOLDER]
"""

import multiprocessing
import os
import resource
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import pandas as pd
import tyro
from rich.progress import track

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is loaded
import measures

from mjris.config import Config, preset
from mjris.cores import CORES
from mjris.envs.sb3_vec import OfficeVecEnv

CELLS = (1, 4, 16, 64, 256)
_SLOTS = 50


@dataclass(frozen=True, kw_only=True)
class Options:
    """What to measure."""

    repeats: int = 5
    """Of which the median counts."""
    most: int = CELLS[-1]
    """Largest number of cells."""
    out: Path = Path("docs")
    """Where scaling.csv and scaling.png go."""


def main(options: Options) -> None:
    """Measure each case in a process of its own, so that its memory is its own."""
    cases = [
        (what, cells) for what in ("csi task", "classic task", "training") for cells in CELLS if cells <= options.most
    ]
    rows = []
    for what, cells in track(cases, "measuring"):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            seconds, memory = pool.submit(cost, what, cells, options.repeats).result()
        rows.append({"what": what, "cells": cells, "us_a_cell": 1e6 * seconds / cells, "memory_mib": memory})
    table = pd.DataFrame(rows)
    table.to_csv(options.out / "scaling.csv", index=False, float_format="%.4g")
    draw(table, options.out / "scaling.png")


def cost(what: str, cells: int, repeats: int) -> tuple[float, float]:
    """Seconds a slot of all cells takes, and the largest memory of this process and its workers together [MiB]."""
    if what == "training":
        spent = [training(cells) for _ in range(repeats)]
    else:
        config = preset("paper" if what == "csi task" else "classic")
        step = measures.stepper(OfficeVecEnv(cells, kinematic(config)))
        (times,) = measures.in_turn([lambda: step(_SLOTS)], repeats)
        spent = [time / _SLOTS for time in times]
    own, largest = (
        resource.getrusage(whose).ru_maxrss / 1024 for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    workers = min(CORES, cells) if what == "training" else 0
    return median(spent), own + workers * largest


def kinematic(config: Config) -> Config:
    """The config with the straight drive."""
    return replace(config, world=replace(config.world, drive="kinematic"))


def training(cells: int) -> float:
    """Seconds a slot, environment and update, of a federation of the classic preset."""
    config = preset("classic")
    config = replace(
        config,
        task=replace(config.task, slots=_SLOTS),
        agent=replace(config.agent, warmup_slots=_SLOTS),
        federation=replace(config.federation, num_cells=cells, backend="stacked", **measures.TWO_ROUNDS),
    )
    return measures.training_seconds(config) / (measures.ROUND_EPISODES * _SLOTS)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Cost a cell over the number of cells, both logarithmic."""
    from matplotlib.figure import Figure

    from mjris.show.palette import RANDOM, ROVER, STOPS

    figure = Figure(figsize=(6.4, 2.8), layout="constrained")
    time_axes, memory_axes = figure.subplots(1, 2)
    for (what, group), colour, mark in zip(
        table.groupby("what", sort=False), (STOPS, ROVER, RANDOM), "os^", strict=True
    ):
        time_axes.loglog(group["cells"], group["us_a_cell"], color=colour, marker=mark, label=what)
        memory_axes.semilogx(group["cells"], group["memory_mib"], color=colour, marker=mark, label=what)
    time_axes.set(xlabel="cells", ylabel="time of a slot, a cell [µs]")
    memory_axes.set(xlabel="cells", ylabel="memory of all processes [MiB]", ylim=(0, None))
    for axes in (time_axes, memory_axes):
        axes.set_xticks(table["cells"].unique(), table["cells"].unique())
        axes.grid(alpha=0.3)
    time_axes.legend(fontsize="small")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
