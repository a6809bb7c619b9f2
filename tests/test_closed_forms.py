"""Closed-form phases."""

import literal
import numpy as np
import pytest
from cases import (
    CLUSTERS,
    aligned_phases,
    effective_channel,
    qos_aligned_phases,
    random_channels,
    random_clusters,
    system,
)
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Radio
from mjris.radio.links import Channels
from mjris.radio.powers import qos_or_sum
from mjris.radio.surface import cascade

SEEDS = st.integers(0, 2**32 - 1)


def weighted_gain(channels, phases, weights):
    channel = effective_channel(channels, phases)
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
    phases, paths = aligned_phases(channels, iterations=2000), cascade(channels)
    # d/dθ_n of Σ ‖h‖², with dh/dθ_n = j e^{jθ_n} times the path over the element
    moved = 1j * np.exp(1j * phases)[:, None, None] * paths
    gradient = 2 * (effective_channel(channels, phases).conj() * moved).sum((1, 2)).real
    np.testing.assert_allclose(gradient, 0, atol=1e-6)


def test_weights_decide_who_is_served():
    channels = random_channels(np.random.default_rng(1), antennas=1)
    alone = Channels(channels.direct[:, 2:3], channels.incident, channels.reflected[:, 2:3])
    np.testing.assert_allclose(aligned_phases(channels, np.array([0.0, 0, 1, 0])), aligned_phases(alone), atol=1e-9)


def test_links_that_reach_nobody_leave_finite_phases():
    channels = Channels(np.zeros((2, 3), complex), np.zeros((5, 3), complex), np.zeros((2, 5), complex))
    np.testing.assert_array_equal(aligned_phases(channels), np.zeros(5))


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.5), ("oma", 2.5)])
@given(seed=SEEDS)
def test_aligned_phases_are_the_literal_ones(scheme, qos, seed):
    rng = np.random.default_rng(seed)
    channels = random_channels(rng, batch=(5,), elements=9)
    served = system(scheme, 5.0, 1.0, 0.1, qos, random_clusters(rng, 2, 2))
    weights = 10 ** rng.uniform(-1, 1, (5, 4))
    found = qos_aligned_phases(served, channels, weights, iterations=4)
    for cell in range(5):
        direct, incident, reflected = (link[cell] for link in channels)
        expected = literal.qos_aligned_phases(served, Radio(), direct, incident, reflected, weights[cell], iterations=4)
        np.testing.assert_allclose(np.exp(1j * found[cell]), np.exp(1j * np.array(expected)), atol=1e-6)


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.5), ("oma", 2.5)])
def test_qos_aligned_phases_beat_aligned_ones(scheme, qos):
    rng = np.random.default_rng(5)
    channels = random_channels(rng, batch=(200,))
    channels = channels._replace(reflected=0.3 * channels.reflected)
    served = system(scheme, 5.0, 1.0, 0.1, qos, CLUSTERS)

    def score(phases):
        _, rates = qos_or_sum(served, effective_channel(channels, phases))
        return (rates >= qos).all(-1) * 1e6 + rates.sum(-1)

    plain, better = score(aligned_phases(channels)), score(qos_aligned_phases(served, channels))
    assert (better >= plain - 1e-9).mean() > 0.95
    assert (better > plain + 1e-3).mean() > 0.5
    assert (better > 1e6).sum() > (plain > 1e6).sum()
    random = score(rng.uniform(-np.pi, np.pi, (200, 16)))
    assert better.mean() > random.mean()


def test_weights_decide_whom_the_panel_serves():
    channels = random_channels(np.random.default_rng(6), batch=(100,))
    served = system("noma", 5.0, 1.0, 0.1, 0.0, CLUSTERS)
    for user in range(4):
        weights = np.where(np.arange(4) == user, 1e3, 1.0) * np.ones((100, 1))
        phases = qos_aligned_phases(served, channels, weights, iterations=1)
        gain = (abs(effective_channel(channels, phases)) ** 2).sum(-1)
        assert gain.mean(0).argmax() == user


@given(SEEDS)
def test_phases_for_a_given_order_are_scored_in_it(seed):
    """Knowing the order never serves fewer than not knowing it, but for what seven steps find by chance."""
    rng = np.random.default_rng(seed)
    channels = random_channels(rng, batch=(40,))
    channels = channels._replace(reflected=0.5 * channels.reflected)
    served = system("noma", 5.0, 1.0, 0.1, 0.3, CLUSTERS)
    order = np.stack([rng.permuted(CLUSTERS, axis=1) for _ in range(40)])

    def score(phases):
        found = qos_or_sum(served, effective_channel(channels, phases), None, order)[1]
        return (found >= 0.3).all(-1) * 1e6 + found.sum(-1)

    aware = score(qos_aligned_phases(served, channels, None, order))
    unaware = score(qos_aligned_phases(served, channels))
    assert (aware >= unaware * (1 - 1e-9)).mean() > 0.8
    assert aware.mean() > unaware.mean() * (1 - 1e-9)
