from dataclasses import replace
from itertools import combinations

import gymnasium
import numpy as np
import pytest

from mjris import make_vec
from mjris.config import Config, ConfigError, preset
from mjris.simulation import streams
from mjris.simulation.streams import Purpose, generator, seeded, word


def test_all_streams_of_a_run_begin_in_other_states():
    """Of every purpose, alone and for some cells and rounds, none is another one's, and none that of a bare seed."""
    keys = [(purpose, *key) for purpose in Purpose for key in [(), *((u,) for u in range(4)), (0, 0), (0, 1), (1, 0)]]
    states = {key: tuple(generator(7, *key).integers(2**63, size=4)) for key in keys}
    states |= {"bare": tuple(np.random.default_rng(7).integers(2**63, size=4))}
    for one, other in combinations(states, 2):
        assert not set(states[one]) & set(states[other]), (one, other)


def test_seeds_of_rounds_and_cells_differ():
    words = [word(7, Purpose.LEARNING, cell, round_) for cell in range(20) for round_ in range(20)]
    assert len(set(words)) == len(words)


@pytest.mark.usefixtures("fresh_entropy")
def test_a_config_without_a_seed_gets_another_one_each_time():
    assert len({streams.fresh_seed() for _ in range(10)}) == 10
    assert seeded(Config(seed=3)).named_seed == 3
    assert seeded(Config()).named_seed != seeded(Config()).named_seed
    with pytest.raises(ConfigError, match=r"seed: none is given"):
        Config().named_seed  # noqa: B018


@pytest.mark.usefixtures("fresh_entropy")
def test_copies_that_nobody_seeds_play_episodes_of_their_own():
    envs = gymnasium.make_vec("mjris/Office-v0", num_envs=4, vectorization_mode="sync")
    observations, _ = envs.reset()
    observations = [*observations, *make_vec(2).reset(), *make_vec(2).reset()]
    for one, other in combinations(observations, 2):
        assert not np.array_equal(one, other)


def test_a_seed_of_the_config_or_of_the_reset_is_kept():
    config = replace(preset("classic"), seed=5)
    first = [gymnasium.make("mjris/Office-v0", config=config).reset()[0] for _ in range(2)]
    np.testing.assert_array_equal(*first)
    again = [gymnasium.make("mjris/Office-v0").reset(seed=5)[0] for _ in range(2)]
    np.testing.assert_array_equal(*again)
