"""What `scripts/bench.py` measures: each function plays its rivals in turn, so that their ratios are of one minute."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pymanopt
import torch
from mujoco.batch import Batch
from pymanopt.manifolds import ComplexCircle
from pymanopt.optimizers import ConjugateGradient
from stable_baselines3 import DDPG
from torch_merit import Problem, merit

from mjris.config import Config, preset
from mjris.envs.gym_env import OfficeEnv
from mjris.envs.sb3_vec import OfficeVecEnv
from mjris.eval.optimum import best_known
from mjris.learn.agent import build_agent, hidden_layers
from mjris.learn.run import train
from mjris.show.rollout import record
from mjris.show.video import write_video
from mjris.simulation.simulator import Simulator
from mjris.simulation.task import Task
from mjris.world.office import GROUP_BLOCKERS

CELLS = 64
ROUND_EPISODES = 4
"""Of trainings: shorter rounds would have more averages and checkpoints than the presets' own."""
TWO_ROUNDS = {"episodes": 2 * ROUND_EPISODES, "round_episodes": ROUND_EPISODES}
Times = list[float]


def in_turn(works: Sequence[Callable[[], object]], repeats: int) -> list[Times]:
    """Wall seconds of every work, each repeated, one after the other in every turn."""
    times: list[Times] = [[] for _ in works]
    for _ in range(repeats):
        for work, spent in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            spent.append(time.perf_counter() - start)
    return times


def rates(count: float, times: Times) -> list[float]:
    """How many a second, for so many in each time."""
    return [count / spent for spent in times]


def kinematic(config: Config, repeats: int, slots: int) -> list[list[float]]:
    """Slots a second of 64 cells in one process, in two, and of a single one; and of the bare matrices of one."""
    config = replace(config, world=replace(config.world, drive="kinematic"))
    envs = [OfficeVecEnv(CELLS, config), OfficeVecEnv(CELLS, config, 2), OfficeVecEnv(1, config)]
    steps = [stepper(env) for env in envs]
    alone = 10 * slots
    works = [partial(steps[0], slots), partial(steps[1], slots), partial(steps[2], alone)]
    times = in_turn([*works, bare_matrices(config, alone)], repeats)
    for env in envs:
        env.close()
    counts = CELLS * slots, CELLS * slots, alone, alone
    return [rates(count, spent) for count, spent in zip(counts, times, strict=True)]


def elements(config: Config, repeats: int, slots: int) -> list[list[float]]:
    """Milliseconds of a slot with 4 × 4 elements, and with 32 × 32, of one cell each at 28 GHz."""
    radio = replace(config.radio, carrier_hz=28e9)
    panels = [replace(config, radio=replace(radio, panel_rows=side, panel_cols=side)) for side in (4, 32)]
    envs = [OfficeVecEnv(1, each) for each in panels]
    times = in_turn([partial(stepper(env), slots) for env in envs], repeats)
    for env in envs:
        env.close()
    return [[1e3 * spent / slots for spent in own] for own in times]


def bare_matrices(config: Config, steps: int) -> Callable[[], None]:
    """What a matrix-only environment of the same M, N, K does in a step: cascaded channel, zero forcing, rates."""
    m, n, k, v = config.radio.num_antennas, config.radio.num_elements, config.world.num_users, config.radio.num_clusters
    rng = np.random.default_rng(0)

    def gaussian(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    direct, incident, reflected = gaussian(k, m), gaussian(n, m), gaussian(k, n)
    power, noise_w = config.radio.tx_power_w / k, config.radio.noise_w

    def work() -> None:
        for _ in range(steps):
            response = np.exp(1j * rng.uniform(-np.pi, np.pi, n))
            channel = direct + (reflected * response) @ incident
            heads = channel[:: k // v]
            beams = np.linalg.pinv(heads)
            beams /= np.linalg.norm(beams, axis=0)
            received = np.abs(channel @ beams) ** 2 * power
            own = received[np.arange(k), np.arange(k) // (k // v)]
            np.log2(1 + own / (received.sum(1) - own + noise_w)).sum()

    return work


def wheels(config: Config, repeats: int, slots: int) -> list[list[float]]:
    """Slots a second of the wheels drive and of nothing but its physics."""
    config = replace(config, world=replace(config.world, drive="wheels"))
    step = stepper(OfficeVecEnv(CELLS, config))
    world = Simulator(config, CELLS).world
    substeps = round(config.world.slot_s / world.offices[0].model.opt.timestep)
    batch = Batch(world.offices[0].model, CELLS)
    batch.bind("qpos")[:] = world.batch.bind("qpos")
    batch.bind("mocap_pos")[:] = world.batch.bind("mocap_pos")
    batch.bind("ctrl")[:, :2] = 3.0
    times = in_turn([partial(step, slots), lambda: batch.step(nstep=substeps * slots)], repeats)
    return [rates(CELLS * slots, spent) for spent in times]


def sight(repeats: int, calls: int) -> list[list[float]]:
    """Links a second of 64 cells, all their obstacles counted; and first hits a second of MuJoCo's rays on them."""
    world = Simulator(preset("classic"), CELLS).world
    rng = np.random.default_rng(0)
    start, end = rng.uniform(0, world.office(0).layout.room.size, (2, CELLS, 9, 3))
    direction = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    groups = (np.arange(mujoco.mjNGROUP) == GROUP_BLOCKERS).astype(np.uint8)  # pyright: ignore[reportAttributeAccessIssue]
    batch = Batch(world.offices[0].model, CELLS)
    world.sight.blockers(start, end)
    times = in_turn(
        [
            lambda: [world.sight.blockers(start, end) for _ in range(calls)],
            lambda: [batch.ray(start, direction, groups) for _ in range(calls)],
        ],
        repeats,
    )
    return [rates(start[..., 0].size * calls, spent) for spent in times]


def federation(base: Config, repeats: int, cells: int, slots: int, ways: Sequence[dict[str, Any]]) -> list[list[float]]:
    """Agent-steps a second of stock SB3 agents one after another, and of each way to train ours, start-up left out."""
    # The warm-up is over with the first episode, and the time of its round is left out.
    base = replace(base, task=replace(base.task, slots=slots), agent=replace(base.agent, warmup_slots=slots))

    def trained(way: dict[str, Any]) -> float:
        return training_seconds(
            replace(
                base,
                federation=replace(base.federation, num_cells=cells, **TWO_ROUNDS, **way),
            )
        )

    measured: list[list[float]] = [[] for _ in range(1 + len(ways))]
    for _ in range(repeats):
        # One agent after another: each has the speed of one.
        measured[0].append(slots / stock_seconds(base, slots))
        for way, rate in zip(ways, measured[1:], strict=True):
            rate.append(cells * ROUND_EPISODES * slots / trained(way))
    return measured


def stock_seconds(config: Config, slots: int) -> float:
    """Seconds that a stock agent takes for so many slots of its own `OfficeEnv`, with an update in each.

    Stock is SB3's `DDPG("MlpPolicy")` with an optimizer and a buffer of its own, and layers and batches of our sizes.
    """
    torch.set_num_threads(1)
    agent = DDPG(
        "MlpPolicy",
        OfficeEnv(config),
        batch_size=config.agent.batch_size,
        learning_starts=slots // 2,
        policy_kwargs={"net_arch": hidden_layers(config)},
        device="cpu",
    )
    agent.learn(slots)
    start = time.perf_counter()
    agent.learn(slots, reset_num_timesteps=False)
    return time.perf_counter() - start


def training_seconds(config: Config) -> float:
    """From the end of the first round, when start-up and warm-up are behind, to the end of the last."""
    finished: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder) / "run", report=lambda _: finished.append(time.perf_counter()))
    return finished[-1] - finished[0]


def optimum(repeats: int) -> list[Times]:
    """Seconds a slot of pymanopt from one start, of our search from all of its starts, and of an agent's decisions."""
    config = preset("classic")
    task = Task(replace(config, radio=replace(config.radio, difference_factor=1.0)), 4 * CELLS)
    simulator = task.simulator
    channels, radio, clusters = simulator.scene.channels, config.radio, simulator.clusters
    qos_bps, users = config.task.qos_bps, config.world.num_users
    manifold, optimizer = ComplexCircle(radio.num_elements), ConjugateGradient(verbosity=0)
    problem = Problem(torch.as_tensor(clusters), radio, qos_bps)

    def search(slot: int) -> None:
        direct, incident, reflected = (torch.asarray(link[slot : slot + 1]) for link in channels)

        @pymanopt.function.pytorch(manifold)
        def loss(response: torch.Tensor) -> torch.Tensor:
            sum_rate, shortfall = merit(problem, direct + (reflected * response) @ incident, problem.full_budgets)
            return (10 * shortfall - sum_rate / radio.bandwidth_hz).sum()

        optimizer.run(pymanopt.Problem(manifold, loss))

    agent = build_agent(config, OfficeEnv(config), np.random.default_rng(0))
    observation = task.observe()

    def act() -> None:
        weights = 10.0 ** agent.predict(observation, deterministic=True)[0][:, 2 : 2 + users]
        phases = simulator.reference_phases(weights)
        simulator.reference_powers(simulator.effective_channel(phases))

    act()
    slots = [4, 4 * CELLS, 4 * CELLS]
    works: list[Callable[[], object]] = [
        lambda: [search(slot) for slot in range(slots[0])],
        lambda: best_known(channels, clusters, radio, qos_bps, np.random.default_rng(0)),
        act,
    ]
    times = in_turn(works, repeats)
    return [[seconds / count for seconds in spent] for count, spent in zip(slots, times, strict=True)]


def filming(repeats: int, slots: int) -> list[float]:
    """Frames a second of a video of 640 × 480, encoding included."""
    config = preset("classic")
    task = Task(config)
    rollout = record(task, lambda observation: np.zeros((len(observation), task.action_size)), slots, 0)
    office = task.simulator.world.office(0)
    with tempfile.TemporaryDirectory() as folder:
        video = Path(folder) / "video.mp4"
        (times,) = in_turn([lambda: write_video(config, office, rollout, video, width=640, height=480)], repeats)
    return rates(rollout.frames, times)


def starting(repeats: int) -> list[Times]:
    """Seconds of `mjris --help` and of `import mjris`, Python's own start included."""
    command = str(Path(sys.executable).with_name("mjris"))
    calls = [[command, "--help"], [sys.executable, "-c", "import mjris"]]
    return in_turn([partial(subprocess.run, call, check=True, capture_output=True) for call in calls], repeats)


def stepper(env: OfficeVecEnv) -> Callable[[int], None]:
    """Plays a number of slots with random actions drawn beforehand."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (20, env.num_envs, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset()

    def step(slots: int) -> None:
        for slot in range(slots):
            env.step(actions[slot % len(actions)])

    step(5)
    return step
