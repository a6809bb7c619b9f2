"""Aligned phases, power splits and the QoS-first closed form."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.access import decoding_order, noma_rates
from mjris.radio.channel import Channels, effective_channel, ris_response
from mjris.radio.control import aligned_phases, qos_first_powers, split_powers
from mjris.radio.fading import complex_normal

CLUSTERS = np.array([[0, 3], [2, 1]])
SEEDS = st.integers(0, 2**32 - 1)


def random_channels(rng, batch=(3,), users=4, antennas=4, elements=16):
    shapes = ((users, antennas), (elements, antennas), (users, elements))
    return Channels(*(complex_normal(rng, (*batch, *shape)) for shape in shapes))


def weighted_gain(channels, phases, weights):
    channel = effective_channel(channels, ris_response(phases, 1.0))
    return (weights[:, None] * abs(channel) ** 2).sum(axis=(-2, -1))


@given(SEEDS)
def test_one_user_and_antenna_reach_the_exact_optimum(seed):
    channels = random_channels(np.random.default_rng(seed), users=1, antennas=1)
    optimum = (abs(channels.direct[:, 0, 0]) + abs(channels.reflected[:, 0] * channels.incident[..., 0]).sum(-1)) ** 2
    for iterations in (0, 3):
        gain = weighted_gain(channels, aligned_phases(channels, iterations=iterations), np.ones(1))
        np.testing.assert_allclose(gain, optimum, rtol=1e-9)


@given(SEEDS)
def test_alignment_never_loses_gain(seed):
    rng = np.random.default_rng(seed)
    channels, weights = random_channels(rng), rng.uniform(0, 1, 4)
    gains = [weighted_gain(channels, aligned_phases(channels, weights, n), weights) for n in range(6)]
    assert np.all(np.diff(gains, axis=0) >= -1e-12 * gains[-1])


def test_alignment_converges_to_a_stationary_point():
    channels = random_channels(np.random.default_rng(0), batch=())
    links = Channels(*map(torch.asarray, channels))
    phases = torch.tensor(aligned_phases(channels, iterations=2000), requires_grad=True)
    (abs(effective_channel(links, ris_response(phases, 1.0))) ** 2).sum().backward()
    assert phases.grad is not None
    np.testing.assert_allclose(phases.grad.numpy(), 0, atol=1e-6)


def test_weights_decide_who_is_served():
    channels = random_channels(np.random.default_rng(1), antennas=1)
    alone = Channels(channels.direct[:, 2:3], channels.incident, channels.reflected[:, 2:3])
    np.testing.assert_allclose(aligned_phases(channels, np.array([0.0, 0, 1, 0])), aligned_phases(alone), atol=1e-9)


def test_links_that_reach_nobody_leave_finite_phases():
    channels = Channels(np.zeros((2, 3), complex), np.zeros((5, 3), complex), np.zeros((2, 5), complex))
    np.testing.assert_array_equal(aligned_phases(channels), np.zeros(5))


@given(SEEDS, st.sampled_from(["noma", "oma"]), st.sampled_from([1, 2, 4]))
def test_split_never_exceeds_the_budget(seed, scheme, num_clusters):
    rng = np.random.default_rng(seed)
    shares, clusters = rng.uniform(0, 1, (5, 4)), rng.permutation(4).reshape(num_clusters, -1)
    powers = split_powers(shares, clusters, scheme, 0.1)
    assert np.all(powers >= 0)
    if scheme == "noma":
        assert np.all(powers[:, clusters].sum(-1) <= 0.1 / num_clusters * (1 + 1e-12))
    else:
        assert np.all(powers <= 0.1 / 4)
    assert np.all(powers.sum(-1) <= 0.1 * (1 + 1e-12))


def test_split_by_hand():
    shares = np.array([0.25, 1.0, 0.5, 0.5])
    np.testing.assert_allclose(split_powers(shares, CLUSTERS, "noma", 6.0), [0.75, 2, 1, 1.5], rtol=1e-14)
    np.testing.assert_allclose(split_powers(shares, CLUSTERS, "oma", 4.0), shares, rtol=1e-14)


def test_unknown_schemes_and_bad_clusters_are_refused():
    with pytest.raises(ValueError, match="noma, oma"):
        split_powers(np.ones(4), CLUSTERS, "tdma", 1.0)
    with pytest.raises(ValueError, match="noma, oma"):
        qos_first_powers(np.ones((4, 2), complex), CLUSTERS, "tdma", 1.0, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="clusters"):
        split_powers(np.ones(4), np.array([[0, 1], [1, 2]]), "noma", 1.0)


def test_qos_first_by_hand():
    # P = 10, gains 1 and 10, noise 1, at least 1 bit: powers 5.5 and 4.5, 6.52356 bit in all.
    channel, clusters = np.array([[1.0 + 0j], [10**0.5]]), np.array([[0, 1]])
    powers = qos_first_powers(channel, clusters, "noma", 10.0, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(powers, [5.5, 4.5], rtol=1e-9)
    assert noma_rates(channel, powers, clusters, 1.0, 1.0).sum() == pytest.approx(6.52356, abs=1e-5)


@pytest.mark.parametrize("num_users", [2, 3])
def test_qos_first_is_the_best_split_on_a_grid(num_users):
    rng = np.random.default_rng(2)
    clusters = np.arange(num_users)[None]
    shares = np.stack(np.meshgrid(*[np.linspace(0, 1, 101)] * (num_users - 1)), axis=-1).reshape(-1, num_users - 1)
    shares = np.concatenate([shares, 1 - shares.sum(-1, keepdims=True)], axis=-1)
    shares = shares[shares[:, -1] >= 0]
    for _ in range(5):
        channel = complex_normal(rng, (num_users, 2))
        rates = noma_rates(channel, 20 * shares, clusters, 1.0, 1.0)
        feasible = rates.sum(-1)[(rates >= 0.3).all(-1)]
        powers = qos_first_powers(channel, clusters, "noma", 20.0, 1.0, 1.0, 0.3)
        best = noma_rates(channel, powers, clusters, 1.0, 1.0)
        assert best.min() >= 0.3
        assert feasible.max() <= best.sum() <= feasible.max() + 0.3


@given(SEEDS, st.floats(0, 3), st.booleans())
def test_qos_first_meets_qos_where_power_lasts(seed, qos, static):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(6).reshape(2, 3)
    channel = complex_normal(rng, (4, 6, 3))
    order = rng.permuted(np.broadcast_to(clusters, (4, 2, 3)), axis=-1) if static else None
    powers = qos_first_powers(channel, clusters, "noma", 50.0, 1.0, 0.1, qos, order)
    np.testing.assert_allclose(powers[:, clusters].sum(-1), 25, rtol=1e-12)
    assert np.all(powers >= 0)
    if order is None:
        order = decoding_order(channel, powers, clusters, 0.1)
    rates = noma_rates(channel, powers, clusters, 1.0, 0.1, order)
    for cell, cluster in np.ndindex(4, 2):
        sequence = order[cell, cluster]
        if qos == 0:  # nobody needs anything: the strongest has all, in any order
            strongest = decoding_order(channel, powers, clusters, 0.1)[cell, cluster, -1]
            assert powers[cell, strongest] == pytest.approx(25, rel=1e-12)
            continue
        if static and (powers[cell, sequence] == 0).any():
            continue  # in another order all are taken to be served, and limit each other
        for place, user in enumerate(sequence[:-1]):
            if powers[cell, user] > 0:
                assert qos <= rates[cell, user] <= qos * (1 + 1e-9)
            else:  # all that was left to it would not have been enough
                trial = powers[cell].copy()
                trial[sequence[place:]] = 0
                trial[user] = 25 - trial[sequence].sum()
                assert noma_rates(channel[cell], trial, clusters, 1.0, 0.1, order[cell])[user] <= qos


def test_unreachable_qos_leaves_the_power_to_the_others():
    channel = np.array([[1.0 + 0j], [10**0.5]])
    np.testing.assert_array_equal(qos_first_powers(channel, np.array([[0, 1]]), "noma", 10.0, 1.0, 1.0, 4.0), [0, 10])
