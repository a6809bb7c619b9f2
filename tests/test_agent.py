import io

import numpy as np
import pytest
import torch
from stable_baselines3 import DDPG
from torch import nn
from toy import ToyEnv, toy_config

from mjris.learn.agent import DecayingOUNoise, PaperPolicy, build_agent


def toy_agent(seed: int = 0, **agent) -> DDPG:
    config = toy_config(agent=agent, num_cells=1, episodes=6)
    return build_agent(config, ToyEnv(config), np.random.default_rng(seed))


def parameters(agent: DDPG) -> dict[str, torch.Tensor]:
    return {key: tensor.clone() for key, tensor in agent.policy.state_dict().items()}


def assert_equal(left: dict[str, torch.Tensor], right: dict[str, torch.Tensor]) -> None:
    assert left.keys() == right.keys()
    for key in left:
        assert torch.equal(left[key], right[key]), key


def test_paper_networks_have_the_papers_layers():
    agent = toy_agent(network="paper")  # 4MN = 4 · 2 · 4
    actor = [(type(layer), getattr(layer, "out_features", None)) for layer in agent.actor.mu.children()]
    critic = [(type(layer), getattr(layer, "out_features", None)) for layer in agent.critic.q_networks[0].children()]
    norm = (nn.BatchNorm1d, None)
    assert actor == [norm, (nn.Linear, 32), (nn.ReLU, None), norm, (nn.Linear, 2), (nn.Tanh, None)]
    assert critic == [norm, (nn.Linear, 16), (nn.ReLU, None), norm, (nn.Linear, 1)]
    assert agent.critic.n_critics == 1


def numpy_forward(state: dict[str, torch.Tensor], prefix: str, inputs: np.ndarray, batch_statistics: bool):
    """Batch norm, linear, ReLU, batch norm, linear from the textbook formulas in float64."""

    def get(name: str) -> np.ndarray:
        return state[f"{prefix}.{name}"].double().numpy()

    def norm(layer: int, x: np.ndarray) -> np.ndarray:
        if batch_statistics:
            mean, variance = x.mean(0), x.var(0)
        else:
            mean, variance = get(f"{layer}.running_mean"), get(f"{layer}.running_var")
        return (x - mean) / np.sqrt(variance + 1e-5) * get(f"{layer}.weight") + get(f"{layer}.bias")

    hidden = np.maximum(norm(0, inputs) @ get("1.weight").T + get("1.bias"), 0.0)
    return norm(3, hidden) @ get("4.weight").T + get("4.bias")


def test_paper_networks_compute_the_written_out_formula():
    agent = toy_agent(network="paper")
    agent.learn(60)
    state = parameters(agent)
    rng = np.random.default_rng(1)
    observation, action = rng.normal(size=(16, 2)), rng.uniform(-1, 1, (16, 2))
    tensors = torch.tensor(observation, dtype=torch.float32), torch.tensor(action, dtype=torch.float32)
    both = np.concatenate([observation, action], axis=1)
    for training in (True, False):
        agent.policy.set_training_mode(training)
        with torch.no_grad():
            acted, valued = agent.actor(tensors[0]).numpy(), agent.critic(*tensors)[0].numpy()
        expected = np.tanh(numpy_forward(state, "actor.mu", observation, training))
        np.testing.assert_allclose(acted, expected, atol=1e-5)
        np.testing.assert_allclose(valued, numpy_forward(state, "critic.qf0", both, training), rtol=1e-4, atol=1e-5)
        agent.policy.load_state_dict(state)  # training mode has moved the running statistics


def test_actor_is_judged_with_running_statistics():
    agent = toy_agent(network="paper")
    agent.learn(60)
    state = parameters(agent)
    rng = np.random.default_rng(1)
    observation = torch.tensor(rng.normal(size=(16, 2)), dtype=torch.float32)
    agent.policy.set_training_mode(True)
    action = agent.actor(observation)
    value = agent.critic.q1_forward(observation, action)
    assert agent.critic.training
    both = torch.cat([observation, action], dim=1).detach().numpy().astype(float)
    expected = numpy_forward(state, "critic.qf0", both, batch_statistics=False)
    np.testing.assert_allclose(value.detach().numpy(), expected, rtol=1e-4, atol=1e-5)

    def gradient(objective: torch.Tensor) -> float:
        gradients = torch.autograd.grad(objective, list(agent.actor.parameters()), retain_graph=True)
        return float(torch.cat([part.flatten() for part in gradients]).norm())

    # With the statistics of the batch the mean value is a constant, and the actor would have nothing to climb.
    assert gradient(agent.critic(observation, action)[0].mean()) < 1e-5
    assert gradient(value.mean()) > 1e-2


def test_a_single_observation_is_acted_on_with_running_statistics():
    agent = toy_agent(network="paper")
    agent.learn(60)
    state = parameters(agent)
    observation = np.array([0.3, -0.7], dtype=np.float32)
    action, _ = agent.predict(observation)
    expected = np.tanh(numpy_forward(state, "actor.mu", observation[None].astype(float), batch_statistics=False))
    np.testing.assert_allclose(action, expected[0], atol=1e-5)
    assert_equal(parameters(agent), state)


def test_updates_move_batch_statistics_and_targets_take_them_over():
    agent = toy_agent(network="paper")
    agent.learn(60)
    state = parameters(agent)
    for net in ("actor", "critic"):
        statistics = [key for key in state if key.startswith(f"{net}.") and "running" in key]
        assert len(statistics) == 4
        for key in statistics:
            fresh = torch.zeros_like(state[key]) if key.endswith("mean") else torch.ones_like(state[key])
            assert not torch.equal(state[key], fresh)
            assert torch.equal(state[key], state[key.replace(net, f"{net}_target", 1)])


def test_mlp_has_the_hidden_layers_asked_for():
    agent = toy_agent(hidden=(8, 4))
    assert not isinstance(agent.policy, PaperPolicy)
    shapes = [tuple(layer.weight.shape) for layer in agent.actor.mu.children() if isinstance(layer, nn.Linear)]
    assert shapes == [(8, 2), (4, 8), (2, 4)]


def test_agent_takes_the_configs_values():
    agent = toy_agent(learning_rate=2e-4, batch_size=7, discount=0.5, target_rate=0.3, buffer_size=99, warmup_slots=3)
    assert agent.actor.optimizer.param_groups[0]["lr"] == agent.critic.optimizer.param_groups[0]["lr"] == 2e-4
    assert (agent.batch_size, agent.gamma, agent.tau, agent.buffer_size, agent.learning_starts) == (7, 0.5, 0.3, 99, 3)
    assert agent.device.type == "cpu"


def test_initial_weights_follow_the_generator():
    assert_equal(parameters(toy_agent(seed=3)), parameters(toy_agent(seed=3)))
    three, four = parameters(toy_agent(seed=3)), parameters(toy_agent(seed=4))
    assert not torch.equal(three["actor.mu.0.weight"], four["actor.mu.0.weight"])


def episodes_of_noise(scale: float, total_slots: int, episodes: int, slots: int, seed: int = 0) -> np.ndarray:
    noise = DecayingOUNoise(3, scale, total_slots, np.random.default_rng(seed))
    samples = np.empty((episodes, slots, 3))
    for episode in range(episodes):
        noise.reset()
        for slot in range(slots):
            samples[episode, slot] = noise()
    return samples


def test_noise_has_the_stated_deviation_and_correlation():
    # A run so long that the decay does not show over these 100 000 slots.
    samples = episodes_of_noise(0.4, 10**12, episodes=5000, slots=20)
    np.testing.assert_allclose(samples.std(axis=(0, 2)), 0.4, rtol=0.03)  # the same from the first slot on
    np.testing.assert_allclose(samples.mean(axis=(0, 2)), 0.0, atol=0.015)
    for lag in (1, 5):
        correlation = np.mean(samples[:, lag:] * samples[:, :-lag]) / 0.4**2
        assert correlation == pytest.approx(np.exp(-0.15 * lag), abs=0.02)
    across_episodes = np.mean(samples[1:, 0] * samples[:-1, -1]) / 0.4**2
    assert across_episodes == pytest.approx(0.0, abs=0.03)


def test_noise_of_several_slots_is_that_of_as_many_calls():
    ahead, calls = (DecayingOUNoise(3, 0.4, 8, np.random.default_rng(0)) for _ in range(2))
    for slots in (3, 4, 5):
        np.testing.assert_array_equal(ahead.ahead(slots), [calls() for _ in range(slots)])
        if slots == 4:
            ahead.reset()
            calls.reset()


def test_noise_decays_linearly_over_the_run_and_stays_at_zero():
    noise = DecayingOUNoise(2, 0.4, 100, np.random.default_rng(0))
    scales, samples = [], []
    for slot in range(110):
        if slot % 10 == 0:
            noise.reset()
        scales.append(noise.scale)
        samples.append(noise())
    np.testing.assert_allclose(scales[:100], 0.4 * (1 - np.arange(100) / 100))
    assert scales[100:] == [0.0] * 10
    assert np.all(np.array(samples[:100]) != 0.0)
    assert np.all(np.array(samples[100:]) == 0.0)


def test_noise_follows_its_generator_and_double_resets_do_not_count():
    noise = DecayingOUNoise(3, 0.4, 40, np.random.default_rng(5))
    samples = []
    for slot in range(40):
        if slot % 20 == 0:
            noise.reset()
            noise.reset()
        samples.append(noise())
    np.testing.assert_array_equal(
        np.reshape(samples, (2, 20, 3)), episodes_of_noise(0.4, 40, 2, 20, seed=5).astype("f")
    )


@pytest.mark.parametrize("network", ["mlp", "paper"])
def test_learning_in_chunks_equals_one_long_call(network: str):
    whole, chunked = toy_agent(network=network), toy_agent(network=network)
    # A second build has seeded the global generators anew, so the long run must come after a seed of its own.
    whole.set_random_seed(7)
    whole.learn(60)
    chunked.set_random_seed(7)
    for episodes in (2, 1, 3):
        chunked.learn(episodes * 10, reset_num_timesteps=False)
    assert whole._n_updates == chunked._n_updates == 50  # and the warm-up of 10 slots came once
    assert_equal(parameters(whole), parameters(chunked))


def test_warmup_acts_at_random_and_leaves_the_weights():
    agent = toy_agent(warmup_slots=40, noise_scale=0.0)
    before = parameters(agent)
    agent.learn(40)
    assert_equal(before, parameters(agent))
    assert agent.replay_buffer is not None
    actions = agent.replay_buffer.actions[:40, 0]
    assert actions.min() < -0.8
    assert actions.max() > 0.8


def test_undiscounted_agent_trains_on_finite_values():
    agent = toy_agent(network="paper", discount=1.0)
    before = parameters(agent)
    agent.learn(60)
    after = parameters(agent)
    assert agent.gamma == 1.0
    assert all(torch.isfinite(tensor).all() for tensor in after.values())
    assert not torch.equal(before["actor.mu.1.weight"], after["actor.mu.1.weight"])


def test_saved_agent_acts_the_same_and_carries_no_replay_memory():
    agent = toy_agent(network="paper")
    agent.learn(60)
    file = io.BytesIO()
    agent.save(file)
    file.seek(0)
    loaded = DDPG.load(file, device="cpu")
    observations = np.random.default_rng(0).normal(size=(5, 2)).astype(np.float32)
    np.testing.assert_array_equal(loaded.predict(observations)[0], agent.predict(observations)[0])
    assert loaded.replay_buffer is not None
    assert loaded.replay_buffer.size() == 0


def mean_reward(agent: DDPG, random: bool) -> float:
    env = ToyEnv(toy_config())
    rng = np.random.default_rng(9)
    rewards = []
    for episode in range(20):
        observation, done = env.reset(seed=1000 + episode)[0], False
        while not done:
            action = rng.uniform(-1, 1, 2) if random else agent.predict(observation)[0]
            observation, reward, _, done, _ = env.step(action)
            rewards.append(reward)
    return float(np.mean(rewards))


@pytest.mark.parametrize("network", ["mlp", "paper"])
def test_agent_learns_to_reach_the_goal(network: str):
    config = toy_config(agent={"network": network}, num_cells=1, episodes=150)
    agent = build_agent(config, ToyEnv(config), np.random.default_rng(0))
    untrained = max(mean_reward(agent, random=False), mean_reward(agent, random=True))
    agent.learn(1500)
    trained = mean_reward(agent, random=False)
    assert trained > untrained + 0.4
    assert trained > 0.65


def test_caution_charges_the_actor_for_the_size_of_its_actions():
    rng = np.random.default_rng(2)
    observation = torch.tensor(rng.normal(size=(16, 2)), dtype=torch.float32)
    action = torch.tensor(rng.uniform(-1, 1, (16, 2)), dtype=torch.float32)
    bold, cautious = toy_agent(hidden=(8,)), toy_agent(hidden=(8,), caution=3.0)
    with torch.no_grad():
        plain = bold.critic(observation, action)[0]
        torch.testing.assert_close(bold.critic.q1_forward(observation, action), plain)
        torch.testing.assert_close(cautious.critic(observation, action)[0], plain)  # the critic learns the true values
        expected = plain / plain.abs().mean() - 3 * (action**2).mean(1, keepdim=True)
        torch.testing.assert_close(cautious.critic.q1_forward(observation, action), expected)


def test_a_cautious_agent_stays_near_action_zero():
    bold, cautious = toy_agent(hidden=(16,), warmup_slots=50), toy_agent(hidden=(16,), warmup_slots=50, caution=30.0)
    observation = np.random.default_rng(3).normal(size=(200, 2)).astype(np.float32)
    sizes = []
    for agent in (bold, cautious):
        agent.learn(600)
        sizes.append(np.abs(agent.predict(observation, deterministic=True)[0]).mean())
    assert sizes[1] < 0.5 * sizes[0]
