"""Zero forcing, decoding order and rates of NumPy arrays."""

import itertools

import literal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.access import decoding_order, noma_rates, oma_rates, zero_forcing
from mjris.radio.fading import complex_normal

BANDWIDTH = 1e6
NOISE = 1e-3
SHAPES = [(4, 2, 4), (4, 1, 2), (4, 4, 4), (6, 2, 3), (6, 3, 4), (1, 1, 1)]  # K, V, M


def random_case(rng, users, clusters, antennas, batch=(3,)):
    """Channels with losses that differ by 40 dB, random powers and clusters."""
    loss = 10 ** rng.uniform(-2, 0, (*batch, users, 1))
    channel = complex_normal(rng, (*batch, users, antennas)) * loss
    return channel, rng.uniform(0, 1, (*batch, users)), rng.permutation(users).reshape(clusters, -1)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(0, 3))
def test_beams_have_unit_norm_and_null_the_others(seed, rows, spare):
    rng = np.random.default_rng(seed)
    channel = complex_normal(rng, (5, rows, rows + spare)) * 10 ** rng.uniform(-4, 0, (5, rows, 1))
    beams = zero_forcing(channel)
    assert beams.shape == (5, rows + spare, rows)
    np.testing.assert_allclose(np.linalg.norm(beams, axis=-2), 1, rtol=1e-12)
    received = channel / np.linalg.norm(channel, axis=-1, keepdims=True) @ beams
    off_diagonal = received * (1 - np.eye(rows))
    conditioning = np.linalg.cond(channel / np.linalg.norm(channel, axis=-1, keepdims=True)) ** 2
    assert np.all(abs(off_diagonal).max(axis=(-2, -1)) < 1e-14 * conditioning)
    assert np.all(abs(np.diagonal(received, axis1=-2, axis2=-1)) > 0)


def test_a_single_beam_is_the_matched_filter():
    channel = complex_normal(np.random.default_rng(0), (1, 4))
    assert abs(channel @ zero_forcing(channel))[0, 0] == pytest.approx(np.linalg.norm(channel), rel=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-12, 1e-9, 1e-7, 1e-6]), st.integers(2, 3))
def test_beams_of_nearly_equal_channels_are_those_of_a_small_regularisation(seed, difference, rows):
    rng = np.random.default_rng(seed)
    channel = complex_normal(rng, (rows, 4))
    channel[1] = 3 * (channel[0] + difference * complex_normal(rng, (4,)))
    beams = zero_forcing(channel)
    assert np.isfinite(beams).all()
    np.testing.assert_allclose(np.linalg.norm(beams, axis=0), 1, rtol=1e-12)
    if difference == 0:
        # The pseudo-inverse: both get the matched filter within what is orthogonal to the third.
        inverse = np.linalg.pinv(channel / np.linalg.norm(channel, axis=1)[:, None])
        for beam, limit in zip(beams.T, inverse.T / np.linalg.norm(inverse, axis=0)[:, None], strict=True):
            assert abs(beam.conj() @ limit) == pytest.approx(1, abs=1e-5)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_regularisation_leaves_all_other_beams_as_they_are(seed, rows):
    rng = np.random.default_rng(seed)
    channel = complex_normal(rng, (rows, 4)) * 10 ** rng.uniform(-4, 0, (rows, 1))
    units = channel / np.linalg.norm(channel, axis=1, keepdims=True)
    expected = np.linalg.solve(units.conj() @ units.T, units.conj()).T
    expected /= np.linalg.norm(expected, axis=0)
    np.testing.assert_allclose(zero_forcing(channel), expected, atol=1e-12)


def test_more_users_than_antennas_are_refused():
    with pytest.raises(ValueError, match="3 users needs as many antennas, and there are 2"):
        zero_forcing(np.ones((3, 2), dtype=complex))


@pytest.mark.parametrize(("users", "num_clusters", "antennas"), SHAPES)
def test_noma_equals_the_loops(users, num_clusters, antennas):
    rng = np.random.default_rng(1)
    for _ in range(10):
        channel, power, clusters = random_case(rng, users, num_clusters, antennas)
        power = np.where(rng.random(power.shape) < 0.3, 0, power)
        rates = noma_rates(channel, power, clusters, BANDWIDTH, NOISE)
        order = rng.permuted(np.broadcast_to(clusters, (3, *clusters.shape)), axis=-1)
        static = noma_rates(channel, power, clusters, BANDWIDTH, NOISE, order)
        for cell in range(3):
            expected = literal.noma_rates(channel[cell], power[cell], clusters, BANDWIDTH, NOISE)
            np.testing.assert_allclose(rates[cell], expected, rtol=1e-9)
            expected = literal.noma_rates(channel[cell], power[cell], clusters, BANDWIDTH, NOISE, order[cell])
            np.testing.assert_allclose(static[cell], expected, rtol=1e-9)


@pytest.mark.parametrize(("users", "num_clusters", "antennas"), SHAPES)
def test_oma_equals_the_loops(users, num_clusters, antennas):
    rng = np.random.default_rng(2)
    for _ in range(10):
        channel, power, clusters = random_case(rng, users, num_clusters, antennas)
        rates = oma_rates(channel, power, clusters, BANDWIDTH, NOISE)
        for cell in range(3):
            expected = literal.oma_rates(channel[cell], power[cell], clusters, BANDWIDTH, NOISE)
            np.testing.assert_allclose(rates[cell], expected, rtol=1e-9)


def test_two_users_by_hand():
    # One antenna, effective gains 1 and 10, powers 5.5 and 4.5: 1 bit, and log2(1 + 45) bit.
    channel = np.array([[1.0 + 0j], [10**0.5]])
    rates = noma_rates(channel, np.array([5.5, 4.5]), np.array([[1, 0]]), 1.0, 1.0)
    np.testing.assert_allclose(rates, [1, np.log2(46)], rtol=1e-12)
    # With the wrong order the strong user's signal must be decoded by the weak one too.
    wrong = noma_rates(channel, np.array([5.5, 4.5]), np.array([[1, 0]]), 1.0, 1.0, np.array([[1, 0]]))
    np.testing.assert_allclose(wrong, [np.log2(6.5), np.log2(1 + 4.5 / 6.5)], rtol=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(4, 2), (3, 1), (6, 2), (4, 1)]))
def test_no_order_beats_the_dynamic_one(seed, shape):
    # Holds for any powers because a signal's rate is the least of its decoders': stack the powers, last decoded at the
    # bottom; at every height, the gain that counts is nowhere above that of the order by gain.
    users, num_clusters = shape
    channel, power, clusters = random_case(np.random.default_rng(seed), users, num_clusters, 3, batch=())
    best = noma_rates(channel, power, clusters, BANDWIDTH, NOISE).sum()
    for order in itertools.product(*(list(itertools.permutations(cluster)) for cluster in clusters)):
        assert noma_rates(channel, power, clusters, BANDWIDTH, NOISE, np.array(order)).sum() <= best * (1 + 1e-12)


def test_decoding_order_sorts_the_gains_and_is_the_dynamic_one():
    rng = np.random.default_rng(3)
    channel, power, clusters = random_case(rng, 6, 2, 4, batch=(20,))
    order = decoding_order(channel, power, clusters, NOISE)
    assert order.shape == (20, 2, 3)
    for cell in range(20):
        gains = literal.gains(channel[cell], channel[cell], power[cell], clusters, NOISE)
        assert order[cell].tolist() == literal.decoding_order(gains, clusters.tolist())
    dynamic = noma_rates(channel, power, clusters, BANDWIDTH, NOISE)
    np.testing.assert_array_equal(noma_rates(channel, power, clusters, BANDWIDTH, NOISE, order), dynamic)


@given(st.integers(0, 2**32 - 1))
def test_where_later_users_have_no_power_the_order_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    channel, power, clusters = random_case(rng, 6, 2, 4, batch=())
    power[clusters[:, 1:]] = 0
    expected = noma_rates(channel, power, clusters, BANDWIDTH, NOISE)
    for order in itertools.product(*(list(itertools.permutations(cluster)) for cluster in clusters)):
        np.testing.assert_array_equal(noma_rates(channel, power, clusters, BANDWIDTH, NOISE, np.array(order)), expected)


def test_one_order_serves_every_cell():
    channel, power, clusters = random_case(np.random.default_rng(4), 4, 2, 3, batch=(5,))
    shared = clusters[:, ::-1]
    repeated = np.broadcast_to(shared, (5, 2, 2))
    np.testing.assert_array_equal(
        noma_rates(channel, power[0], clusters, BANDWIDTH, NOISE, shared),
        noma_rates(channel, np.broadcast_to(power[0], (5, 4)), clusters, BANDWIDTH, NOISE, repeated),
    )


@given(st.integers(0, 2**32 - 1), st.sampled_from([noma_rates, oma_rates]))
def test_noise_counts_once(seed, rates):
    # Users with the same channel share the capacity of one: B log2(1 + P |h|^2 / noise), however it is split.
    rng = np.random.default_rng(seed)
    channel = np.repeat(complex_normal(rng, (1, 2)), 4, axis=0)
    power = np.full(4, 0.3) if rates is oma_rates else rng.uniform(0, 1, 4)
    capacity = BANDWIDTH * np.log2(1 + power.sum() * np.linalg.norm(channel[0]) ** 2 / NOISE)
    assert rates(channel, power, np.array([[2, 0, 3, 1]]), BANDWIDTH, NOISE).sum() == pytest.approx(capacity, rel=1e-9)


@pytest.mark.parametrize("rates", [noma_rates, oma_rates])
def test_rates_depend_on_the_ratio_of_power_to_noise_only(rates):
    channel, power, clusters = random_case(np.random.default_rng(5), 4, 2, 4)
    reference = rates(channel, power, clusters, BANDWIDTH, NOISE)
    np.testing.assert_allclose(rates(channel, 7 * power, clusters, BANDWIDTH, 7 * NOISE), reference, rtol=1e-12)
    np.testing.assert_allclose(rates(channel * 1j, power, clusters, 2 * BANDWIDTH, NOISE), 2 * reference, rtol=1e-9)
    assert np.all(rates(channel, 0 * power, clusters, BANDWIDTH, NOISE) == 0)


@pytest.mark.parametrize("rates", [noma_rates, oma_rates])
def test_bad_powers_and_clusters_are_refused(rates):
    channel, power, clusters = random_case(np.random.default_rng(6), 4, 2, 4, batch=())
    for bad in (np.array([0.1, -1e-9, 0.1, 0.1]), np.array([0.1, np.nan, 0.1, 0.1])):
        with pytest.raises(ValueError, match="power_w"):
            rates(channel, bad, clusters, BANDWIDTH, NOISE)
    for bad in ([[0, 1], [2, 2]], [[0, 1], [2, 4]], [[0, 1]], [0, 1, 2, 3]):
        with pytest.raises(ValueError, match="clusters"):
            rates(channel, power, np.array(bad), BANDWIDTH, NOISE)


@pytest.mark.parametrize("order", [[[0, 0], [2, 3]], [[2, 3], [0, 1]], [[0, 1, 2, 3]]])
def test_bad_orders_are_refused(order):
    channel, power, _ = random_case(np.random.default_rng(7), 4, 2, 4, batch=())
    with pytest.raises(ValueError, match="order"):
        noma_rates(channel, power, np.array([[0, 1], [2, 3]]), BANDWIDTH, NOISE, np.array(order))
