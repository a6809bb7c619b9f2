"""Speed of the simulator and of federated training, as a table; ratios compare runs of the same minute.

python scripts/bench.py [--quick]
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from mjris.config import Config, preset
from mjris.env import OfficeVecEnv
from mjris.learn.run import train

CELLS = 64


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the work: a check that it runs, not a measure")
    quick = parser.parse_args().quick
    repeats, slots = (3, 5) if quick else (7, 50)
    table = Table("measured", "median", "least … most", "wanted")

    for name in ("paper", "office"):
        rates = kinematic_rates(preset(name), repeats, slots)
        table.add_row(f"kinematic, E = {CELLS}, {name} observation [slots/s]", *spread(rates, ",.0f"), "8,000")
    ours, bare = wheels_rates(preset("paper"), repeats, max(2, slots // 5))
    table.add_row(f"wheels, E = {CELLS} [slots/s]", *spread(ours, ",.0f"), "")
    table.add_row("bare Batch.step of the same model [slots/s]", *spread(bare, ",.0f"), "")
    table.add_row("wheels / bare", *spread([a / b for a, b in zip(ours, bare, strict=True)], ".2f"), "0.60")
    one, two = training_rates(3, 100 if not quick else 20)
    table.add_row("training, 4 cells, one process [agent-steps/s]", *spread(one, ",.0f"), "")
    table.add_row("training, 4 cells, two workers [agent-steps/s]", *spread(two, ",.0f"), "")
    table.add_row("two workers / one process", *spread([b / a for a, b in zip(one, two, strict=True)], ".2f"), "1.60")
    Console().print(table)


def kinematic_rates(config: Config, repeats: int, slots: int) -> list[float]:
    """Slots a second of a vectorised environment, everything included, under random actions."""
    config = replace(config, world=replace(config.world, drive="kinematic"))
    step = env_stepper(OfficeVecEnv(CELLS, config))
    step(5)
    return [CELLS * slots / seconds(lambda: step(slots)) for _ in range(repeats)]


def wheels_rates(config: Config, repeats: int, slots: int) -> tuple[list[float], list[float]]:
    """Slots a second of the wheels drive and of nothing but its physics, in turn."""
    config = replace(config, world=replace(config.world, drive="wheels"))
    env = OfficeVecEnv(CELLS, config)
    step = env_stepper(env)
    step(3)
    world = env.task.simulator.world
    substeps = round(config.world.slot_s / world.offices[0].model.opt.timestep)
    batch = Batch(world.offices[0].model, CELLS)
    batch.bind("qpos")[:] = world.batch.bind("qpos")
    batch.bind("mocap_pos")[:] = world.batch.bind("mocap_pos")
    batch.bind("ctrl")[:, :2] = 3.0
    ours, bare = [], []
    for _ in range(repeats):
        ours.append(CELLS * slots / seconds(lambda: step(slots)))
        bare.append(CELLS * slots / seconds(lambda: batch.step(nstep=substeps * slots)))
    return ours, bare


def training_rates(repeats: int, slots: int) -> tuple[list[float], list[float]]:
    """Agent-steps a second of four cells in one process and in two workers, in turn, start-up left out."""
    base = preset("office")
    rates: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(repeats):
        for workers, measured in rates.items():
            config = replace(
                base,
                task=replace(base.task, slots=slots),
                federation=replace(base.federation, num_cells=4, episodes=3, round_episodes=1, workers=workers),
            )
            measured.append(4 * 2 * slots / training_seconds(config))
    return rates[1], rates[2]


def training_seconds(config: Config) -> float:
    """From the end of the first round, when start-up and warm-up are behind, to the end of the last."""
    finished: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder) / "run", report=lambda _: finished.append(time.perf_counter()))
    return finished[-1] - finished[0]


def env_stepper(env: OfficeVecEnv) -> Callable[[int], None]:
    """Plays a number of slots with random actions drawn beforehand."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (20, env.num_envs, env.task.action_size)).astype(np.float32)
    env.reset()

    def step(slots: int) -> None:
        for slot in range(slots):
            env.step(actions[slot % len(actions)])

    return step


def seconds(work: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def spread(values: list[float], form: str) -> tuple[str, str]:
    """Median, and the range."""
    return format(statistics.median(values), form), f"{min(values):{form}} … {max(values):{form}}"


if __name__ == "__main__":
    sys.exit(main())
