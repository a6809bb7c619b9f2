"""Mistakes that public code for RIS and reinforcement learning has made, each looked for from outside."""

from dataclasses import replace

import numpy as np
import pytest

from mjris.config import Config, Radio, World, preset
from mjris.envs.gym_env import OfficeEnv
from mjris.simulation.simulator import Simulator
from mjris.simulation.task import Task

SCHEMES = ["noma", "oma"]


def kinematic(name: str, **radio) -> Config:
    config = preset(name)
    return replace(config, world=replace(config.world, drive="kinematic"), radio=replace(config.radio, **radio))


def wild_actions(task: Task, rng: np.random.Generator) -> np.ndarray:
    """Actions far beyond the box, as an agent with much noise gives them."""
    return rng.normal(0, 5, (task.simulator.num_cells, task.action_size))


@pytest.mark.parametrize("name", ["paper", "office"])
def test_reflection_coefficients_off_the_unit_circle(name):
    # Network outputs taken for real and imaginary parts give |φ_n| ≠ 1, and a panel that amplifies.
    task, rng = Task(kinematic(name), cells=4), np.random.default_rng(0)
    for _ in range(5):
        _, phases, *_ = task.decode(wild_actions(task, rng))
        assert phases.dtype == np.float64
        known = task.simulator.scene.known
        turned = known.direct + (known.reflected * np.exp(1j * phases)[:, None]) @ known.incident
        np.testing.assert_allclose(task.simulator.effective_channel(phases), turned, rtol=1e-9, atol=1e-15)
        task.step(wild_actions(task, rng))


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ["paper", "office"])
def test_transmit_power_above_the_budget(name, scheme):
    # Powers that are clipped one by one, or not at all, add up to more than the AP has.
    task, rng = Task(kinematic(name, scheme=scheme), cells=8), np.random.default_rng(1)
    for _ in range(10):
        action = wild_actions(task, rng)
        powers = task.decode(action)[2]
        assert (powers >= 0).all()
        budget_w = {"paper": 0.1, "office": 0.01}[name]  # 20 and 10 dBm
        assert powers.sum(-1).max() <= budget_w * (1 + 1e-9)
        assert powers.sum(-1).max() > 0.5 * budget_w  # not because hardly anything is transmitted
        assert task.step(action).slot.constraints.power.all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_noise_that_is_counted_twice_or_never(scheme):
    # One user, nobody to interfere: the rate is B log2(1 + P ‖h‖² / noise), noise being density times bandwidth.
    radio = Radio(num_clusters=1, scheme=scheme, bandwidth_hz=2e6, noise_dbm_per_mhz=-60.0)
    simulator = Simulator(Config(world=World(drive="kinematic", num_users=1), radio=radio), cells=5)
    phases = np.random.default_rng(2).uniform(-3, 3, (5, 16))
    gain = (abs(simulator.effective_channel(phases)) ** 2).sum((-2, -1))
    rates = simulator.step(np.zeros((5, 2)), phases, np.full((5, 1), 0.1)).rates_bps
    np.testing.assert_allclose(rates[:, 0], 2e6 * np.log2(1 + 0.1 * gain / 2e-9), rtol=1e-9)
    # Twice the noise shows: it does not stand for rounding.
    assert not np.allclose(rates[:, 0], 2e6 * np.log2(1 + 0.1 * gain / 4e-9), rtol=1e-3)


@pytest.mark.parametrize("name", ["paper", "office"])
def test_observations_whose_parts_differ_by_orders_of_magnitude(name):
    # Channels of 1e-4 beside positions of 10 m and losses of 80 dB leave a network blind to the channels.
    task, rng = Task(kinematic(name), cells=16), np.random.default_rng(3)
    seen = [task.reset(seed=1)]
    for _ in range(20):
        seen.append(task.step(rng.uniform(-1, 1, (16, task.action_size))).observation)
    spread = np.concatenate(seen).std(0)
    assert np.isfinite(spread).all()
    assert spread.min() > 0.02
    assert spread.max() < 5


@pytest.mark.parametrize("name", ["paper", "office"])
def test_a_seed_that_reset_ignores(name):
    env = OfficeEnv(kinematic(name))
    actions = np.random.default_rng(4).uniform(-1, 1, (4, *(env.action_space.shape or ())))

    def episode(seed: int) -> tuple[np.ndarray, list[float]]:
        first, _ = env.reset(seed=seed)
        played = [env.step(action) for action in actions]
        return np.stack([first, *(step[0] for step in played)]), [float(step[1]) for step in played]

    first, other, again = episode(11), episode(12), episode(11)  # with an episode in between
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1] == again[1]
    assert not np.allclose(first[0][0], other[0][0])
    assert first[1] != other[1]
    # Without a seed the next episode is another one.
    assert not np.allclose(env.reset()[0], again[0][0])
