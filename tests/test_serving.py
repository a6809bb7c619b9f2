"""Rates, and what follows from what is known."""

import literal
import numpy as np
import pytest
from cases import CLUSTERS, random_clusters, system
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.access import noma_rates, oma_rates
from mjris.radio.fading import complex_normal
from mjris.radio.serving import rates

SEEDS = st.integers(0, 2**32 - 1)
SHAPES = st.sampled_from([(1, 1, 1), (1, 4, 2), (2, 2, 3), (3, 2, 3), (2, 3, 4), (4, 1, 4)])


@given(SEEDS, SHAPES)
def test_rates_are_those_of_access(seed, shape):
    num_clusters, size, antennas = shape
    rng = np.random.default_rng(seed)
    clusters = random_clusters(rng, num_clusters, size)
    channel = complex_normal(rng, (2, 3, num_clusters * size, antennas))
    channel *= rng.uniform(0.01, 1, (2, 3, 1, 1))
    powers = rng.uniform(0, 1, channel.shape[:-1])
    order = np.stack([rng.permuted(clusters, axis=1) for _ in range(6)])
    noma, oma = (system(scheme, 5.0, 2.0, 0.1, 0.0, clusters) for scheme in ("noma", "oma"))
    arguments = channel, powers, clusters, 2.0, 0.1
    np.testing.assert_allclose(rates(noma, channel, powers), noma_rates(*arguments), rtol=1e-9)
    np.testing.assert_allclose(rates(oma, channel, powers), oma_rates(*arguments), rtol=1e-9)
    flat = channel.reshape(6, -1, antennas), powers.reshape(6, -1)
    expected = noma_rates(*flat, clusters, 2.0, 0.1, order)
    np.testing.assert_allclose(rates(noma, *flat, order), expected, rtol=1e-9)


def test_bad_powers():
    channel = complex_normal(np.random.default_rng(0), (2, 4, 4))
    for bad in (-0.1, np.nan):
        with pytest.raises(ValueError, match="power_w"):
            rates(system("noma", 1.0, 1.0, 1.0, 0.0), channel, np.array([0.1, 0.1, bad, 0.1]))


@pytest.mark.parametrize("scheme", ["noma", "oma"])
@pytest.mark.parametrize("difference", [0.0, 1e-9, 1e-7])
def test_nearly_equal_channels_spoil_nobody_elses_cell(scheme, difference):
    rng = np.random.default_rng(0)
    channel = complex_normal(rng, (3, 4, 4))
    arguments = system(scheme, 1.0, 1.0, 0.1, 0.0)
    expected = rates(arguments, channel, np.ones((3, 4)))
    channel[1, 1:] = channel[1, :1] + difference * complex_normal(rng, (3, 4))
    found = rates(arguments, channel, np.ones((3, 4)))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])
    # No more than one user would have of its whole cluster's power.
    most = np.log2(1 + 2 * (abs(channel[1]) ** 2).sum(-1).max() / 0.1)
    assert found[1].sum() <= 2 * most


def test_orders_of_another_number_of_cells_are_refused():
    with pytest.raises(ValueError, match="order: an array of shape"):
        rates(system("noma", 1.0, 1.0, 1.0, 0.0), np.ones((3, 4, 4), complex), np.ones((3, 4)), CLUSTERS[None])


@given(SEEDS, st.sampled_from(["noma", "oma"]))
def test_beams_and_order_follow_from_what_is_known_and_rates_from_what_is(seed, scheme):
    """Beams of the estimate, in the order of the gains that it promises, over other channels."""
    rng = np.random.default_rng(seed)
    known = complex_normal(rng, (4, 4)) * 10 ** rng.uniform(-1, 0, (4, 1))
    truth = known + 0.3 * complex_normal(rng, (4, 4)) * abs(known)
    powers, noise = rng.uniform(0, 1, 4), 0.01
    served = system(scheme, 4.0, 1.0, noise, 0.0)
    found = rates(served, truth, powers, known=known)
    np.testing.assert_allclose(found, literal.rates_of(served, truth, powers, known=known), rtol=1e-9)
