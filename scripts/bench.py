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
import pymanopt
import torch
from mujoco.batch import Batch
from pymanopt.manifolds import ComplexCircle
from pymanopt.optimizers import ConjugateGradient
from rich.console import Console
from rich.table import Table

from mjris.config import Config, preset
from mjris.env import OfficeEnv, OfficeVecEnv
from mjris.eval.optimum import best_known
from mjris.learn.agent import build_agent
from mjris.learn.run import train
from mjris.radio.access import noma_rates
from mjris.radio.channel import Channels, effective_channel
from mjris.radio.control import qos_first_powers
from mjris.simulator import Simulator
from mjris.task import Task

CELLS = 64


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the work: a check that it runs, not a measure")
    quick = parser.parse_args().quick
    repeats, slots = (3, 5) if quick else (7, 50)
    table = Table("measured", "median", "least … most", "wanted")

    for name, length, wanted in (("paper", slots, "8,000"), ("office", max(2, slots // 5), "")):
        one, two = kinematic_rates(preset(name), repeats, length)
        title = f"kinematic, E = {CELLS}, {name} task"
        table.add_row(f"{title}, one process \\[slots/s]", *spread(one, ",.0f"), "")
        table.add_row(f"{title}, two processes \\[slots/s]", *spread(two, ",.0f"), wanted)
    ours, bare = wheels_rates(preset("paper"), repeats, max(2, slots // 5))
    table.add_row(f"wheels, E = {CELLS} \\[slots/s]", *spread(ours, ",.0f"), "")
    table.add_row("bare Batch.step of the same model \\[slots/s]", *spread(bare, ",.0f"), "")
    table.add_row("wheels / bare", *spread(ratios(ours, bare), ".2f"), "0.60")
    one, two, stack = training_rates(3, 100 if not quick else 20)
    table.add_row("training, 4 cells, one process \\[agent-steps/s]", *spread(one, ",.0f"), "")
    table.add_row("training, 4 cells, two workers \\[agent-steps/s]", *spread(two, ",.0f"), "")
    table.add_row("training, 4 cells, one stack \\[agent-steps/s]", *spread(stack, ",.0f"), "")
    table.add_row("two workers / one process", *spread(ratios(two, one), ".2f"), "1.60")
    table.add_row("one stack / one process", *spread(ratios(stack, one), ".2f"), "")
    theirs, ours = optimum_seconds(3)
    table.add_row("reference optimum \\[ms a slot]", *spread([1e3 * time for time in ours], ".1f"), "")
    table.add_row("pymanopt, one start \\[ms a slot]", *spread([1e3 * time for time in theirs], ".0f"), "")
    table.add_row("pymanopt / reference optimum", *spread(ratios(theirs, ours), ".0f"), "10")
    acting = acting_seconds(3)
    table.add_row("agent's phases and powers \\[ms a slot]", *spread([1e3 * time for time in acting], ".2f"), "")
    table.add_row("reference optimum / agent's", *spread(ratios(ours, acting), ".0f"), "20")
    Console().print(table)


def kinematic_rates(config: Config, repeats: int, slots: int) -> tuple[list[float], list[float]]:
    """Slots a second in one process and in two, everything included, under random actions, in turn."""
    config = replace(config, world=replace(config.world, drive="kinematic"))
    envs = [OfficeVecEnv(CELLS, config, processes) for processes in (1, 2)]
    steps = [env_stepper(env) for env in envs]
    rates: tuple[list[float], list[float]] = [], []
    for step in steps:
        step(5)
    for _ in range(repeats):
        for measured, step in zip(rates, steps, strict=True):
            measured.append(CELLS * slots / seconds(lambda step=step: step(slots)))
    for env in envs:
        env.close()
    return rates


def wheels_rates(config: Config, repeats: int, slots: int) -> tuple[list[float], list[float]]:
    """Slots a second of the wheels drive and of nothing but its physics, in turn."""
    config = replace(config, world=replace(config.world, drive="wheels"))
    env = OfficeVecEnv(CELLS, config)
    step = env_stepper(env)
    step(3)
    world = Simulator(config, CELLS).world
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


def training_rates(repeats: int, slots: int) -> tuple[list[float], list[float], list[float]]:
    """Agent-steps a second of four cells in one process, two workers and one stack, in turn, start-up left out."""
    base = preset("office")
    ways = [{"backend": "processes", "workers": 1}, {"backend": "processes", "workers": 2}, {"backend": "stacked"}]
    rates: list[list[float]] = [[], [], []]
    for _ in range(repeats):
        for way, measured in zip(ways, rates, strict=True):
            config = replace(
                base,
                task=replace(base.task, slots=slots),
                federation=replace(base.federation, num_cells=4, episodes=3, round_episodes=1, **way),
            )
            measured.append(4 * 2 * slots / training_seconds(config))
    return rates[0], rates[1], rates[2]


def optimum_seconds(repeats: int) -> tuple[list[float], list[float]]:
    """Seconds a slot of pymanopt's conjugate gradient from one start, and of ours from all of its starts, in turn."""
    config = preset("office")
    simulator = Simulator(replace(config, radio=replace(config.radio, difference_factor=1.0)), 4 * CELLS)
    channels, radio, clusters = simulator.scene.channels, config.radio, simulator.clusters
    qos_bps = config.task.qos_bps
    manifold, optimizer = ComplexCircle(radio.num_elements), ConjugateGradient(verbosity=0)

    def search(slot: int) -> None:
        links = Channels(*(torch.asarray(link[slot]) for link in channels))

        @pymanopt.function.pytorch(manifold)
        def loss(response: torch.Tensor) -> torch.Tensor:
            h = effective_channel(links, response)
            budget = clusters, radio.scheme, radio.tx_power_w, radio.bandwidth_hz, radio.noise_w, qos_bps
            powers = qos_first_powers(h, *budget)
            return -noma_rates(h, powers, clusters, radio.bandwidth_hz, radio.noise_w).sum() / radio.bandwidth_hz

        optimizer.run(pymanopt.Problem(manifold, loss))

    theirs, ours = [], []
    for _ in range(repeats):
        theirs.append(seconds(lambda: [search(slot) for slot in range(4)]) / 4)
        rng = np.random.default_rng(0)
        ours.append(seconds(lambda rng=rng: best_known(channels, clusters, radio, qos_bps, rng)) / (4 * CELLS))
    return theirs, ours


def acting_seconds(repeats: int) -> list[float]:
    """Seconds a slot of an untrained agent's network, and of the phases and powers that its actions stand for."""
    config = preset("office")
    task = Task(replace(config, radio=replace(config.radio, difference_factor=1.0)), 4 * CELLS)
    agent = build_agent(config, OfficeEnv(config), np.random.default_rng(0))
    observation, users = task.observe(), config.world.num_users

    def act() -> None:
        weights = 10.0 ** agent.predict(observation, deterministic=True)[0][:, 2 : 2 + users]
        phases = task.simulator.reference_phases(weights)
        task.simulator.reference_powers(task.simulator.effective_channel(phases))

    act()
    return [seconds(act) / (4 * CELLS) for _ in range(repeats)]


def ratios(values: list[float], others: list[float]) -> list[float]:
    """Each value by that of the same turn."""
    return [a / b for a, b in zip(values, others, strict=True)]


def training_seconds(config: Config) -> float:
    """From the end of the first round, when start-up and warm-up are behind, to the end of the last."""
    finished: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder) / "run", report=lambda _: finished.append(time.perf_counter()))
    return finished[-1] - finished[0]


def env_stepper(env: OfficeVecEnv) -> Callable[[int], None]:
    """Plays a number of slots with random actions drawn beforehand."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (20, env.num_envs, *(env.action_space.shape or ()))).astype(np.float32)
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
