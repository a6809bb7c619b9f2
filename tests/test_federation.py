import io
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3 import DDPG
from toy import BrokenToyEnv, ToyEnv, toy_config

from mjris.learn.agent import DecayingOUNoise, build_agent
from mjris.learn.federation import Cell, EpisodeRecorder, FederatedAveraging, average, num_rounds


def toy_agent(seed: int) -> DDPG:
    config = toy_config(agent={"network": "paper"}, episodes=4)
    return build_agent(config, ToyEnv(config), np.random.default_rng(seed))


def toy_cell(index: int = 0, **federation) -> Cell:
    return Cell(toy_config(agent={"network": "paper"}, **federation), index, ToyEnv)


def noise_of(agent: DDPG) -> DecayingOUNoise:
    assert isinstance(agent.action_noise, DecayingOUNoise)
    return agent.action_noise


def assert_equal(left, right) -> None:
    assert left.keys() == right.keys()
    for key in left:
        assert torch.equal(left[key], right[key]), key


def test_average_of_known_numbers():
    merged = average(
        [
            {"w": torch.tensor([1.0, 2.0]), "running_var": torch.tensor([4.0]), "batches": torch.tensor(3)},
            {"w": torch.tensor([3.0, -2.0]), "running_var": torch.tensor([1.0]), "batches": torch.tensor(5)},
            {"w": torch.tensor([5.0, 3.0]), "running_var": torch.tensor([1.0]), "batches": torch.tensor(9)},
        ]
    )
    assert_equal(
        merged,
        {"w": torch.tensor([3.0, 1.0]), "running_var": torch.tensor([2.0]), "batches": torch.tensor(6)},  # 17 / 3
    )
    assert merged["batches"].dtype == torch.int64
    assert merged["w"].dtype == torch.float32


def test_average_sums_in_double_precision():
    # In float32 the ones are lost beside 1e8.
    values = [1e8, 1.0, 1.0, 1.0, -1e8]
    merged = average([{"w": torch.tensor([value])} for value in values])
    assert merged["w"].item() == pytest.approx(0.6, rel=1e-7)


@given(
    st.lists(st.lists(st.floats(-1e6, 1e6, width=32), min_size=3, max_size=3), min_size=1, max_size=6),
    st.integers(0, 5),
)
def test_average_is_the_mean_whatever_the_order(rows: list[list[float]], shift: int):
    states = [{"w": torch.tensor(row, dtype=torch.float32)} for row in rows]
    merged = average(states)["w"].numpy()
    np.testing.assert_allclose(merged, np.mean(rows, axis=0), rtol=1e-6, atol=1e-9)
    shift %= len(states)
    np.testing.assert_allclose(average(states[shift:] + states[:shift])["w"].numpy(), merged, rtol=1e-6, atol=1e-9)


def test_average_of_equal_agents_changes_nothing_and_shares_no_memory():
    state = toy_agent(0).policy.state_dict()
    merged = average([state] * 3)
    assert_equal(merged, dict(state))
    merged["actor.mu.1.weight"].zero_()
    assert state["actor.mu.1.weight"].abs().sum() > 0


def test_average_refuses_what_does_not_match():
    one = {"w": torch.zeros(2), "b": torch.zeros(1)}
    with pytest.raises(ValueError, match="at least one"):
        average([])
    with pytest.raises(ValueError, match="b is not in every"):
        average([one, {"w": torch.zeros(2)}])
    with pytest.raises(ValueError, match=r"w has shapes \(2,\) and \(3,\)"):
        average([one, {"w": torch.zeros(3), "b": torch.zeros(1)}])
    for bad in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="b of state dict 1 has numbers that are not finite"):
            average([one, {"w": torch.zeros(2), "b": torch.tensor([bad])}, one])


def test_state_holds_four_networks_and_their_batch_statistics():
    keys = toy_agent(0).policy.state_dict().keys()
    for network in ("actor", "actor_target", "critic", "critic_target"):
        for entry in ("weight", "running_mean", "running_var", "num_batches_tracked"):
            assert any(key.startswith(f"{network}.") and key.endswith(entry) for key in keys)


def test_callback_loads_at_the_start_and_exports_at_the_end():
    source, agent = toy_agent(1), toy_agent(2)
    source.learn(40)  # so that running statistics and targets differ from fresh ones
    merged = {key: tensor.clone() for key, tensor in source.policy.state_dict().items()}
    seen = {}

    class Spy(FederatedAveraging):
        def _on_rollout_start(self) -> None:
            if not seen:
                seen.update({key: tensor.clone() for key, tensor in self.model.policy.state_dict().items()})

    exchange = Spy(merged)
    agent.learn(20, callback=exchange)
    assert_equal(seen, merged)
    assert_equal(exchange.exported, dict(agent.policy.state_dict()))
    assert not torch.equal(exchange.exported["actor.mu.1.weight"], merged["actor.mu.1.weight"])
    exported = exchange.exported["actor.mu.1.weight"].clone()
    agent.learn(10, reset_num_timesteps=False)
    assert torch.equal(exchange.exported["actor.mu.1.weight"], exported)


def test_optimizer_and_replay_memory_stay_local():
    agent = toy_agent(2)
    agent.learn(30)
    assert agent.replay_buffer is not None
    rewards = agent.replay_buffer.rewards[:30].copy()
    steps = agent.actor.optimizer.state_dict()["state"][0]
    before = {key: steps[key].clone() for key in ("step", "exp_avg", "exp_avg_sq")}
    exchange = FederatedAveraging(toy_agent(1).policy.state_dict())
    exchange.init_callback(agent)
    exchange.on_training_start({}, {})
    assert_equal(dict(agent.policy.state_dict()), dict(toy_agent(1).policy.state_dict()))
    after = agent.actor.optimizer.state_dict()["state"][0]
    assert_equal(before, {key: after[key] for key in before})
    assert before["step"] == 20
    assert before["exp_avg"].abs().sum() > 0
    np.testing.assert_array_equal(agent.replay_buffer.rewards[:30], rewards)


def test_recorder_reports_what_the_environment_gave():
    agent = toy_agent(0)
    recorder = EpisodeRecorder(3, 7, 1)
    agent.learn(20, callback=recorder)
    assert agent.replay_buffer is not None
    rewards = agent.replay_buffer.rewards[:20].reshape(2, 10)
    distances = 1.0 - rewards.astype(float)
    for index, row in enumerate(recorder.episodes):
        assert (row.round, row.episode, row.cell) == (3, 7 + index, 1)
        assert row.reward == pytest.approx(rewards[index].mean(), rel=1e-5)
        assert row.sum_rate_mbps == pytest.approx(np.exp(-distances[index]).mean(), rel=1e-5)
        assert row.bare_rate_mbps == pytest.approx(np.exp(-2 * distances[index]).mean(), rel=1e-5)
        assert row.gain_percent == pytest.approx(100 * (row.sum_rate_mbps / row.bare_rate_mbps - 1))
        assert row.qos_share == np.mean(distances[index] < 0.5)
        assert row.collisions == np.sum(distances[index] > 1.5)
        assert row.clearance_m == pytest.approx(distances[index].min(), rel=1e-4, abs=1e-6)
    assert len(recorder.episodes) == 2


def test_rounds_cover_the_episodes_and_the_last_may_be_short():
    cell = toy_cell(episodes=5, round_episodes=2)
    episodes = [[row.episode for row in cell.train(round_, None)[1]] for round_ in (1, 2, 3)]
    assert episodes == [[1, 2], [3, 4], [5]]
    assert num_rounds(toy_config(episodes=5, round_episodes=2)) == 3
    assert num_rounds(toy_config(episodes=4, round_episodes=2)) == 2
    assert cell._agent.num_timesteps == 50


def test_a_round_asked_for_again_is_not_trained_again():
    cell = toy_cell()
    first = cell.train(1, None)
    assert cell.train(1, None) == first
    assert cell._agent.num_timesteps == 20
    assert_equal(dict(cell._agent.policy.state_dict()), dict(first[0]))


@pytest.mark.parametrize("round_", [0, 1, 4])
def test_rounds_out_of_order_are_refused(round_: int):
    cell = toy_cell()
    cell.train(1, None)
    cell.train(2, None)
    with pytest.raises(ValueError, match=f"round {round_} is out of order after round 2"):
        cell.train(round_, None)


def test_a_round_that_failed_is_not_taken_up_again():
    cell = Cell(toy_config(), 1, BrokenToyEnv)
    with pytest.raises(ArithmeticError):
        cell.train(1, None)
    with pytest.raises(ValueError, match="round 1 is out of order after round 1"):
        cell.train(1, None)


def test_cells_do_not_depend_on_who_else_runs():
    alone = toy_cell(0)
    for round_ in (1, 2):
        expected = alone.train(round_, None)
    together = [toy_cell(0), toy_cell(1)]
    for round_ in (1, 2):
        results = [cell.train(round_, None) for cell in together]
    assert_equal(results[0][0], expected[0])
    assert results[0][1] == expected[1]
    assert not torch.equal(results[0][0]["actor.mu.1.weight"], results[1][0]["actor.mu.1.weight"])


def test_first_weights_are_each_cells_own_or_those_of_cell_0_and_noise_is_always_its_own():
    own, common = (
        [toy_cell(u, num_cells=3, first_weights=choice)._agent for u in range(3)] for choice in ("own", "common")
    )
    weights = [[agent.actor.state_dict()["mu.1.weight"] for agent in agents] for agents in (own, common)]
    assert all(torch.equal(weight, weights[0][0]) for weight in weights[1])
    assert not torch.equal(weights[0][1], weights[0][0])
    noise = [[noise_of(agent)().tolist() for agent in agents] for agents in (own, common)]
    assert noise[0] == noise[1]
    assert noise[0][0] != noise[0][1] != noise[0][2]


def test_cells_start_from_weights_of_their_own_but_share_the_seeds_of_their_environments():
    seeds: dict[int, list[int]] = {0: [], 1: []}

    class Listening(ToyEnv):
        def reset(self, *, seed=None, options=None):
            if seed is not None:
                seeds[self._cell].append(seed)
            return super().reset(seed=seed, options=options)

    cells = [Cell(toy_config(), u, Listening) for u in (0, 1)]
    weights = [cell._agent.actor.state_dict()["mu.0.weight"] for cell in cells]
    assert not torch.equal(*weights)
    for round_ in (1, 2):
        for cell in cells:
            cell.train(round_, None)
    assert seeds[0] == seeds[1]
    assert len(set(seeds[0])) == 2


def test_merged_parameters_are_saved_and_the_replay_memory_is_not(tmp_path: Path):
    cell = toy_cell()
    state, _ = cell.train(1, None)
    merged = {key: tensor * 2 for key, tensor in state.items()}
    cell.save(tmp_path / "cell_0.zip", merged)
    loaded = DDPG.load(io.BytesIO((tmp_path / "cell_0.zip").read_bytes()), device="cpu")
    assert_equal(dict(loaded.policy.state_dict()), merged)
    assert loaded.replay_buffer is not None
    assert loaded.replay_buffer.size() == 0
