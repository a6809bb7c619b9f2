import multiprocessing
import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import mjris
from mjris.config import Config, ConfigError, preset
from mjris.envs.gym_env import OfficeEnv
from mjris.envs.sb3_vec import OfficeVecEnv
from mjris.radio import closed_forms, serving
from mjris.radio.powers import qos_or_sum
from mjris.simulation.outlook import bare_values, best_goals, place_values
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task

INFO = {
    "rates_bps",
    "sum_rate_bps",
    "bare_sum_rate_bps",
    "qos_met",
    "blockers",
    "clearance_m",
    "collisions",
    "constraints",
}


def changed(base: Config, **fields) -> Config:
    """The config with fields changed wherever they belong: changed(c, scheme="oma", slots=5)."""
    for part in ("world", "radio", "task"):
        section = getattr(base, part)
        mine = {name: value for name, value in fields.items() if hasattr(section, name)}
        base = replace(base, **{part: replace(section, **mine)})
    return base


OFFICE = preset("classic")
TASK = Task(changed(OFFICE, motion="displacement", phase_control="elements", power_reference="even"))
QOS_TASKS = [Task(changed(OFFICE, scheme=scheme)) for scheme in ("noma", "oma")]


@pytest.mark.parametrize("scheme", ["noma", "oma"])
@pytest.mark.parametrize("name", ["paper", "office", "demo", "classic"])
def test_checkers_of_gymnasium_and_sb3(name, scheme):
    env = OfficeEnv(changed(preset(name), scheme=scheme))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(infinity|same dtype|spec).*")
        check_env(env, skip_render_check=True)
        sb3_check_env(env, warn=False)


def test_made_by_gymnasium_with_everything_in_info():
    env = gym.make("mjris/Office-v0", config=changed(OFFICE, slots=3))
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    for slot in range(3):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert (terminated, truncated) == (False, slot == 2)
        assert set(info) >= INFO
        assert info["rates_bps"].shape == info["qos_met"].shape == (4,)
        assert info["sum_rate_bps"] == pytest.approx(info["rates_bps"].sum())
        assert info["bare_sum_rate_bps"] > 0
        np.testing.assert_array_equal(info["qos_met"], info["rates_bps"] >= 10e3)
        assert info["blockers"].shape == (9,)
        assert info["clearance_m"] > 0
        assert info["collisions"] == 0
        assert np.isfinite(float(reward))


@pytest.mark.parametrize(("name", "processes"), [("paper", 1), ("classic", 1), ("classic", 2)])
def test_vec_env_is_single_environments_side_by_side(name, processes):
    config = changed(preset(name), slots=4, difference_factor=0.5, phases="random" if name == "paper" else "learned")
    vec = OfficeVecEnv(3, config, processes)
    vec.seed(17)
    singles = [OfficeEnv(config, cell=e) for e in range(3)]
    together = vec.reset()
    alone = np.stack([env.reset(seed=17)[0] for env in singles])
    rng = np.random.default_rng(3)
    assert isinstance(together, np.ndarray)
    np.testing.assert_allclose(together, alone, atol=1e-5)
    for slot in range(10):
        actions = rng.uniform(-1, 1, (3, *(vec.action_space.shape or ()))).astype(np.float32)
        vec.step_async(actions)
        together, rewards, dones, infos = vec.step_wait()
        assert isinstance(together, np.ndarray)
        for e, env in enumerate(singles):
            observation, reward, terminated, truncated, info = env.step(actions[e])
            assert dones[e] == (terminated or truncated) == (slot % 4 == 3)
            if terminated or truncated:
                np.testing.assert_allclose(infos[e]["terminal_observation"], observation, atol=1e-5)
                assert terminated == (name == "paper")
                assert infos[e]["TimeLimit.truncated"] == truncated
                observation, _ = env.reset()
            np.testing.assert_allclose(together[e], observation, atol=1e-5)
            assert rewards[e] == pytest.approx(reward, rel=1e-5, abs=1e-5)
            np.testing.assert_allclose(infos[e]["rates_bps"], info["rates_bps"], rtol=1e-9)
    vec.close()
    assert not multiprocessing.active_children()


def test_cells_of_several_runs_are_those_of_each():
    config = changed(OFFICE, layout_jitter_m=0.3)
    cells = [CellId(5, 0), CellId(5, 1), CellId(9, 1)]
    vec = OfficeVecEnv(cells, config)
    singles = [OfficeEnv(replace(config, seed=seed), number) for seed, number in cells]
    rng = np.random.default_rng(3)
    for seeds in (None, [20, 20, 21]):
        vec.seed(seeds)
        vec.reset()
        for env, seed in zip(singles, seeds or [None] * 3, strict=True):
            env.reset(seed=seed)
        for _ in range(3):
            actions = rng.uniform(-1, 1, (3, *(vec.action_space.shape or ())))
            infos = vec.step(actions)[3]
            for info, env, action in zip(infos, singles, actions, strict=True):
                np.testing.assert_allclose(info["rates_bps"], env.step(action)[4]["rates_bps"], rtol=1e-9)


@pytest.mark.parametrize("processes", [0, 3])
def test_no_more_processes_than_cells(processes):
    with pytest.raises(ConfigError, match=f"processes: {processes} is not allowed: there are 2 cells"):
        mjris.make_vec(2, processes=processes)


def test_make_vec():
    vec = mjris.make_vec(2)
    assert isinstance(vec, mjris.OfficeVecEnv)
    observation = vec.reset()
    assert isinstance(observation, np.ndarray)
    assert observation.shape == (2, *(vec.observation_space.shape or ()))
    assert vec.config == preset("office")


def play(config: Config, slots: int, cells: int = 4, scale: float = 1.0):
    """Outcomes of random actions within ± `scale`."""
    task, rng = Task(config, cells), np.random.default_rng(0)
    return [task.step(rng.uniform(-scale, scale, (cells, task.action_size))) for _ in range(slots)]


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 30), st.booleans())
def test_power_and_displacement_never_exceed_their_budgets(seed, scale, signs):
    action = np.random.default_rng(seed).uniform(-scale, scale, (1, TASK.action_size))
    action = np.sign(action) if signs else action
    for task in (TASK, *QOS_TASKS):
        move, phases, powers, *_ = task.decode(action[:, : task.action_size])
        radio = task.config.radio
        budget = radio.tx_power_w * (1 + 1e-12)
        assert (powers >= 0).all()
        assert powers.sum() <= budget
        if radio.scheme == "noma":
            assert (powers[:, task.simulator.clusters].sum(-1) <= budget / radio.num_clusters).all()
        else:
            assert (powers <= budget / powers.shape[1]).all()
        assert np.linalg.norm(move) <= 0.5 + 1e-12
        assert np.isfinite(phases).all()


def test_plain_actions_mean_what_they_say():
    action = np.zeros((1, TASK.action_size))
    action[0, :2] = 0.6, -0.8
    action[0, 2:18] = np.linspace(-1, 1, 16)
    action[0, 18:] = 0.0, -0.5, -1.0, 1.0
    move, phases, powers, *_ = TASK.decode(action)
    np.testing.assert_allclose(move, [[0.3, -0.4]])
    np.testing.assert_allclose(phases[0], np.pi * np.linspace(-1, 1, 16))
    np.testing.assert_allclose(powers[0], [0.05 * 0.5, 0.05 * 0.25, 0, 0.05])


def test_waypoints_are_moved_from_the_goal_of_the_map():
    task = Task(OFFICE, cells=8)
    task.reset(0)
    simulator = task.simulator
    goal, _ = best_goals(simulator)
    action = np.zeros((8, task.action_size))
    np.testing.assert_array_equal(task.decode(action)[0], simulator.terrain.way_toward(goal))
    angle = np.arange(8) * np.pi / 4
    action[:, :2] = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    moved = goal + 4 * 0.5 * action[:, :2]
    np.testing.assert_allclose(task.decode(action)[0], simulator.terrain.way_toward(moved), atol=1e-9)
    plain = Task(OFFICE, cells=8)
    plain.reset(0)
    for _ in range(30):
        # Always to the same place, as far as an action can move what the map says.
        offset = (10.0, 3.0) - best_goals(simulator)[0]
        length = np.linalg.norm(offset, axis=-1, keepdims=True)
        action[:, :2] = offset / np.sqrt(4 * np.maximum(length, 4))
        assert (task.step(action).slot.collisions == 0).all()
        plain.step(np.zeros_like(action))
    away, unmoved = (np.linalg.norm(each.simulator.scene.rover_xy - (10.0, 3.0), axis=-1) for each in (task, plain))
    assert np.median(unmoved - away) > 2


def test_pan_is_one_more_action_from_the_bisector():
    task = Task(changed(OFFICE, pan="action"), cells=4)
    assert task.action_size == 11
    action = np.zeros((4, 11))
    action[:, -1] = -0.5, 0, 0.25, 1
    task.step(action)
    simulator = task.simulator
    turned = simulator.scene.panel_heading - simulator.bisector(simulator.world.fleet.xy)
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * np.pi * action[:, -1]), atol=1e-9)


def test_no_power_action_costs_a_user_its_qos():
    task = Task(OFFICE, cells=32)
    simulator = task.simulator
    rng = np.random.default_rng(3)
    served = 0
    for _ in range(10):
        _, phases, powers, *_ = task.decode(rng.uniform(-1.0, 1.0, (32, task.action_size)))
        effective = simulator.effective_channel(phases)
        _, best = simulator.reference_powers(effective)
        possible = (best >= OFFICE.task.qos_bps).all(-1)
        assert np.all(simulator.rates(effective, powers)[possible] >= OFFICE.task.qos_bps)
        served += possible.sum()
        simulator.reset()
    assert served > 30


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_action_zero_is_the_closed_forms(scheme):
    task = Task(changed(OFFICE, scheme=scheme), cells=3)
    simulator = task.simulator
    move, phases, powers, *_ = task.decode(np.zeros((3, task.action_size)))
    np.testing.assert_array_equal(move, simulator.terrain.way_toward(best_goals(simulator)[0]))
    system = serving.System.of(task.config.radio, simulator.clusters, task.config.task.qos_bps)
    aligned = closed_forms.qos_aligned_phases(system, simulator.surface, simulator.scene.known)
    np.testing.assert_allclose(phases, aligned)
    wanted = np.full(4, 1.05 * task.config.task.qos_bps)
    best, _ = qos_or_sum(system, simulator.effective_channel(aligned), wanted)
    np.testing.assert_allclose(powers, best, rtol=1e-12)


def value(rates_bps: np.ndarray) -> np.ndarray:
    """The paper's reward [Mb/s], user by user."""
    return np.array([sum(rates) / (1 if min(rates) >= 10e3 * (1 - 1e-9) else 2) / 1e6 for rates in rates_bps])


def test_rewards():
    for kind in ("sum_rate", "gain"):
        missed = []
        free = changed(OFFICE, reward=kind)
        for outcome in [*play(free, 10), *play(free, 20, scale=0)]:
            bare = value(outcome.slot.bare_rates_bps) if kind == "gain" else 0
            np.testing.assert_allclose(outcome.reward, value(outcome.slot.rates_bps) - bare, atol=1e-12)
            missed.append(~outcome.slot.qos_met.all(-1))
        assert 0 < np.mean(missed) < 1


def test_the_map_as_a_potential_shapes_rewards_and_adds_up_to_its_ends():
    plain, shaped = Task(changed(OFFICE), cells=3), Task(changed(OFFICE, map_potential=4.0), cells=3)
    rng = np.random.default_rng(0)
    discount, total, factor = OFFICE.agent.discount, np.zeros(3), 1.0

    def potential() -> np.ndarray:
        made = shaped.simulator
        return 4e-6 * (place_values(made, made.scene.rover_xy[:, None])[:, 0] - bare_values(made))

    first = potential()
    for _ in range(10):
        action = rng.uniform(-1, 1, (3, plain.action_size))
        total += factor * (shaped.step(action).reward - plain.step(action).reward)
        factor *= discount
    np.testing.assert_allclose(total, factor * potential() - first, atol=1e-9)
    assert np.abs(total).max() > 0.05


def test_random_phases_are_reproducible_and_ignore_the_action():
    config = changed(OFFICE, phases="random")
    first, again, other = (Task(config, 2) for _ in range(3))
    other.reset(seed=99)
    phases = [task.decode(np.full((2, task.action_size), 0.3 * i))[1] for i, task in enumerate((first, again, other))]
    np.testing.assert_array_equal(phases[0], phases[1])
    assert not np.allclose(phases[0], phases[2])
    assert not np.allclose(phases[0][0], phases[0][1])
    assert not np.allclose(first.decode(np.zeros((2, first.action_size)))[1], phases[0])
    assert abs(phases[0]).max() <= np.pi


@pytest.mark.parametrize("mode", ["mobile", "fixed", "none"])
def test_modes_of_the_ris(mode):
    config = changed(OFFICE, ris=mode)
    outcomes = play(config, 10)
    moved = np.linalg.norm([outcome.slot.displacement_m for outcome in outcomes], axis=-1)
    assert moved.max() <= 0.5 + 1e-9
    assert (moved > 0).any() == (mode == "mobile")


def test_none_with_the_closed_form_powers_gains_nothing():
    task = Task(changed(OFFICE, ris="none", scheme="oma"), cells=4)
    for _ in range(5):
        np.testing.assert_allclose(task.step(np.zeros((4, task.action_size))).reward, 0, atol=1e-12)


def test_closed_forms_on_a_fixed_ris_gain_something():
    task = Task(changed(OFFICE, ris="fixed"), cells=8)
    rewards = [task.step(np.zeros((8, task.action_size))).reward for _ in range(30)]
    assert np.mean(rewards) > 0.02


@pytest.mark.parametrize("name", ["paper", "office"])
def test_rewards_do_not_collapse_after_the_first_episode(name):
    vec = OfficeVecEnv(24, changed(preset(name), slots=15, drive="kinematic"))
    rng = np.random.default_rng(0)
    vec.reset()
    episodes = []
    for _ in range(3):
        rewards = [vec.step(rng.uniform(-1, 1, (24, *(vec.action_space.shape or ()))))[1] for _ in range(15)]
        episodes.append(np.mean(rewards, 0))
    for later in episodes[1:]:
        spread = np.hypot(later.std(), episodes[0].std()) / np.sqrt(24)
        assert abs(later.mean() - episodes[0].mean()) < 4 * spread
        assert 0.3 < later.std() / episodes[0].std() < 3
        assert not np.allclose(later, episodes[0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_and_nothing_has_happened(value):
    env, vec = OfficeEnv(OFFICE), OfficeVecEnv(4, OFFICE, processes=2)
    env.reset(seed=0)
    vec.reset()
    action, actions = np.zeros(10), np.zeros((4, 10))
    action[3], actions[2, 7] = value, value
    with pytest.raises(ValueError, match=r"action: .* in entry 3 of cell 0 is not allowed"):
        env.step(action)
    with pytest.raises(ValueError, match=r"action: .* in entry 7 of cell 2 is not allowed"):
        vec.step(actions)
    untouched = OfficeEnv(OFFICE)
    untouched.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.zeros(10))[0], untouched.step(np.zeros(10))[0])
    vec.step(np.zeros((4, 10)))
    vec.close()


@pytest.mark.parametrize("shape", [(7,), (11,), (22,), (1, 10), (), (10, 1)])
def test_actions_of_other_shapes_are_refused(shape):
    env, vec = OfficeEnv(OFFICE), OfficeVecEnv(4, OFFICE)
    with pytest.raises(ValueError, match=r"action: an array of shape .* is not allowed: it must be \(10,\)"):
        env.step(np.zeros(shape))
    for wrong in (shape, (4, 9), (3, 10)):
        with pytest.raises(ValueError, match=r"action: an array of shape .* is not allowed: it must be \(4, 10\)"):
            vec.step(np.zeros(wrong))


def test_many_users_and_a_short_action():
    made = changed(
        OFFICE, layout="open", num_users=24, num_clusters=4, power_reference="even", phase_control="elements"
    )
    task = Task(made)
    with pytest.raises(ValueError, match="action"):
        task.step(np.zeros((1, 10)))


def test_terminal_episodes_observe_the_time_that_is_left_and_others_do_not():
    for name in ("paper", "office"):
        ends = changed(preset(name), slots=4, end="terminal", drive="kinematic")
        env, open_ended = OfficeEnv(ends), OfficeEnv(changed(replace(ends, agent=OFFICE.agent), end="time_limit"))
        assert env.observation_space.shape == (open_ended.task.observation_size + 1,)
        for episode in range(2):
            seen, _ = env.reset(seed=episode)
            same, _ = open_ended.reset(seed=episode)
            for slot in range(4):
                np.testing.assert_array_equal(seen[:-1], same)
                assert seen[-1] == pytest.approx(1 - slot / 4)
                action = np.zeros(env.task.action_size)
                seen, _, terminated, truncated, _ = env.step(action)
                assert (terminated, truncated) == (slot == 3, False)
                same, _, terminated, truncated, _ = open_ended.step(action)
                assert (terminated, truncated) == (False, slot == 3)
            assert seen[-1] == 0


def test_shaping_adds_up_to_the_potential_of_the_start_where_episodes_truly_end():
    ending = changed(OFFICE, slots=5, end="terminal")
    plain, shaped = Task(ending, cells=3), Task(changed(ending, map_potential=4.0), cells=3)
    made, rng = shaped.simulator, np.random.default_rng(0)
    first = 4e-6 * (place_values(made, made.scene.rover_xy[:, None])[:, 0] - bare_values(made))
    total, factor = np.zeros(3), 1.0
    for _ in range(5):
        action = rng.uniform(-1, 1, (3, plain.action_size))
        total += factor * (shaped.step(action).reward - plain.step(action).reward)
        factor *= ending.agent.discount
    np.testing.assert_allclose(total, -first, atol=1e-9)


def test_people_and_rovers_moved_by_hand_get_a_goal_of_their_own():
    """What is observed after a look is what a simulator that begins there observes."""
    task = Task(OFFICE, cells=2)
    before = task.observe()
    simulator, cells = task.simulator, np.arange(2)
    simulator.world.fleet.place(cells, np.array([[7.0, 9.0], [3.0, 10.0]]), np.zeros(2))
    # Nothing is mixed until the simulator looks: goal and scene are both of before.
    np.testing.assert_array_equal(task.observe(), before)
    simulator.look()
    np.testing.assert_array_equal(task._goals()[0], best_goals(simulator)[0])
    moved = task.observe()
    simulator.world.crowd.place(cells, simulator.world.crowd.xy[:, ::-1].copy())
    np.testing.assert_array_equal(task.observe(), moved)
    simulator.look()
    np.testing.assert_array_equal(task._goals()[0], best_goals(simulator)[0])
    assert not np.allclose(task.observe(), moved)
