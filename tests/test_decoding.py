import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.decoding import ascending, cancelled, decodable, qos_first
from mjris.radio.equations import needed_share

SEEDS = st.integers(0, 2**32 - 1)
BANDWIDTH_HZ = 2.0


@given(SEEDS)
def test_powers_are_what_rates_take_and_the_rest_for_the_last(seed):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(6).reshape(2, 3)
    gains, least = 10 ** rng.uniform(-2, 3, 6), rng.uniform(0, 2, 6)
    order = ascending(clusters, gains)
    powers, rates = np.empty(6), np.empty(6)
    needed = np.array([needed_share(BANDWIDTH_HZ, rate) for rate in least])
    budgets = np.array([3.0, 5.0])
    qos_first(gains, order, budgets, needed, powers)
    for cluster, left in zip(order, budgets, strict=True):
        for user in cluster[:-1]:
            # t (1 + left e)/ (e (1 + t)) for the SINR t of the rate
            sinr = 2 ** (least[user] / BANDWIDTH_HZ) - 1
            wanted = sinr * (1 + left * gains[user]) / (gains[user] * (1 + sinr))
            assert powers[user] == pytest.approx(wanted if wanted <= left else 0, rel=1e-9)
            left -= powers[user]
        assert powers[cluster[-1]] == pytest.approx(left, rel=1e-9)
    cancelled(BANDWIDTH_HZ, gains, powers, order, rates)
    served = (powers > 0) & ~np.isin(np.arange(6), order[:, -1])
    np.testing.assert_allclose(rates[served], least[served], rtol=1e-9)


@given(SEEDS)
def test_rates_are_limited_by_whoever_decodes_later(seed):
    """By a loop over the formula, in any order of decoding."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(6).reshape(2, 3)
    gains, powers, found = 10 ** rng.uniform(-2, 3, 6), rng.uniform(0, 1, 6), np.empty(6)
    powers[rng.random(6) < 0.3] = 0
    cancelled(BANDWIDTH_HZ, gains, powers, order, found)
    for cluster in order:
        for place, user in enumerate(cluster):
            later = sum(powers[cluster[place + 1 :]])
            decoders = [user, *(by for by in cluster[place + 1 :] if powers[by] > 0)]
            sinr = min(gains[by] * powers[user] / (gains[by] * later + 1) for by in decoders)
            np.testing.assert_allclose(found[user], BANDWIDTH_HZ * math.log2(1 + sinr), rtol=1e-9)


@given(SEEDS)
def test_ascending_sorts_every_cluster(seed):
    rng = np.random.default_rng(seed)
    clusters, gains = rng.permutation(8).reshape(2, 4), rng.uniform(size=8)
    expected = [sorted(cluster, key=lambda user: gains[user]) for cluster in clusters]
    np.testing.assert_array_equal(ascending(clusters, gains), expected)


@given(SEEDS)
def test_decodable_is_the_least_gain_from_a_user_on(seed):
    rng = np.random.default_rng(seed)
    order, gains = rng.permutation(6).reshape(2, 3), rng.uniform(size=6)
    least = decodable(gains, order)
    for cluster in order:
        for place, user in enumerate(cluster):
            assert least[user] == gains[cluster[place:]].min()
