"""Powers in closed form."""

import numpy as np
import pytest
from cases import CLUSTERS, qos_first_powers, system
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.access import decoding_order, noma_rates, oma_rates
from mjris.radio.fading import complex_normal
from mjris.radio.powers import qos_or_sum, split_powers
from mjris.radio.serving import rates

SEEDS = st.integers(0, 2**32 - 1)
SHAPES = st.sampled_from([(1, 1, 1), (1, 4, 2), (2, 2, 3), (3, 2, 3), (2, 3, 4), (4, 1, 4)])


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.6), ("oma", 4.0)])
def test_qos_or_sum_serves_all_or_maximises_the_sum(scheme, qos):
    channel = complex_normal(np.random.default_rng(3), (200, 4, 3))
    arguments = (50.0, 1.0, 0.1, qos)
    rates_of = noma_rates if scheme == "noma" else oma_rates
    powers, rates = qos_or_sum(system(scheme, *arguments), channel)
    np.testing.assert_allclose(rates, rates_of(channel, powers, CLUSTERS, 1.0, 0.1), rtol=1e-9)
    first = qos_first_powers(channel, CLUSTERS, *arguments) if scheme == "noma" else np.full(powers.shape, 12.5)
    served = (rates_of(channel, first, CLUSTERS, 1.0, 0.1) >= qos).all(-1)
    assert 0.1 < served.mean() < 0.9
    np.testing.assert_allclose(powers[served], first[served])
    if scheme == "noma":
        strongest = decoding_order(channel, powers, CLUSTERS, 0.1)[~served][..., -1]
        alone = np.zeros((strongest.shape[0], 4))
        np.put_along_axis(alone, strongest, 25.0, -1)
        np.testing.assert_allclose(powers[~served], alone)


def test_a_margin_is_taken_where_it_can_be_had_and_never_costs_qos():
    channel = complex_normal(np.random.default_rng(4), (300, 4, 3))
    arguments = (50.0, 1.0, 0.1, 0.6)
    _, plain = qos_or_sum(system("noma", *arguments), channel)
    _, wide = qos_or_sum(system("noma", *arguments), channel, np.full(4, 0.9))
    served = (plain >= 0.6).all(-1)
    np.testing.assert_array_equal((wide >= 0.6).all(-1), served)
    roomy = (qos_or_sum(system("noma", 50.0, 1.0, 0.1, 0.9), channel)[1] >= 0.9).all(-1)
    assert 0 < roomy.sum() < served.sum()
    np.testing.assert_array_equal((wide >= 0.9 - 1e-9).all(-1), roomy)


def test_every_user_may_want_a_rate_of_its_own():
    channel = complex_normal(np.random.default_rng(7), (50, 4, 3))
    wanted = np.random.default_rng(8).uniform(0.05, 0.1, (50, 4))
    powers, rates = qos_or_sum(system("noma", 500.0, 1.0, 0.1, 0.05), channel, wanted)
    order = decoding_order(channel, powers, CLUSTERS, 0.1)
    for cell in np.flatnonzero((rates >= wanted * (1 - 1e-9)).all(-1)):
        first = order[cell, :, 0]
        np.testing.assert_allclose(rates[cell, first], wanted[cell, first], rtol=1e-9)
    assert (rates >= wanted * (1 - 1e-9)).all(-1).mean() > 0.5


def best_on_a_grid(channel, clusters, order, qos, budget):
    """The most in eq. (R) over a fine grid of powers of one cluster of two users, all of its budget spent."""
    shares = np.linspace(0, 1, 2001)[:, None]
    powers = budget * np.concatenate([shares, 1 - shares], 1)
    found = noma_rates(np.broadcast_to(channel, (len(powers), *channel.shape)), powers, clusters, 1.0, 0.1, order)
    met = (found >= qos).all(-1)
    return found.sum(-1)[met].max() if met.any() else found.sum(-1).max()


@given(SEEDS)
def test_powers_for_a_given_order_are_the_best_on_a_grid(seed):
    rng = np.random.default_rng(seed)
    clusters, qos = np.array([[0, 1]]), 0.5
    channel = complex_normal(rng, (1, 2, 2))
    order = rng.permutation(2)[None, None]
    _, found = qos_or_sum(system("noma", 5.0, 1.0, 0.1, qos, clusters), channel, None, order)
    best = best_on_a_grid(channel[0], clusters, order[0], qos, 5.0)
    assert found.sum() >= best * (1 - 1e-3)


def test_a_scheduler_that_selects_serves_all_as_oma_or_the_strongest_as_noma():
    channel = complex_normal(np.random.default_rng(3), (200, 4, 3))
    arguments = 50.0, 1.0, 0.1, 4.0
    plain, selecting = (system("oma", *arguments, selects=selects) for selects in (False, True))
    powers, found = qos_or_sum(selecting, channel)
    _, all_served = qos_or_sum(plain, channel)
    met = (all_served >= 4.0).all(-1)
    assert 0.1 < met.mean() < 0.9
    np.testing.assert_array_equal(found[met], all_served[met])
    alone_powers, alone = qos_or_sum(system("noma", *arguments[:3], 0.0), channel)
    selected = ~met & (alone.sum(-1) > all_served.sum(-1))
    assert selected.sum() > 0.5 * (~met).sum()
    np.testing.assert_array_equal(powers[selected], alone_powers[selected])
    np.testing.assert_allclose(found[selected], alone[selected], rtol=1e-12)
    np.testing.assert_array_equal(found[~selected], all_served[~selected])
    np.testing.assert_allclose(rates(selecting, channel, powers), found, rtol=1e-12)


@given(SEEDS, st.sampled_from(["noma", "oma"]), st.sampled_from([1, 2, 4]))
def test_split_never_exceeds_the_budget(seed, scheme, num_clusters):
    rng = np.random.default_rng(seed)
    shares, clusters = rng.uniform(0, 1, (5, 4)), rng.permutation(4).reshape(num_clusters, -1)
    powers = split_powers(system(scheme, 0.1, 1.0, 1.0, 0.0, clusters), shares)
    assert np.all(powers >= 0)
    if scheme == "noma":
        assert np.all(powers[:, clusters].sum(-1) <= 0.1 / num_clusters * (1 + 1e-12))
    else:
        assert np.all(powers <= 0.1 / 4)
    assert np.all(powers.sum(-1) <= 0.1 * (1 + 1e-12))


def test_split_by_hand():
    shares = np.array([[0.25, 1.0, 0.5, 0.5]])
    np.testing.assert_allclose(
        split_powers(system("noma", 6.0, 1.0, 1.0, 0.0), shares)[0], [0.75, 2, 1, 1.5], rtol=1e-14
    )
    np.testing.assert_allclose(split_powers(system("oma", 4.0, 1.0, 1.0, 0.0), shares)[0], shares[0], rtol=1e-14)


def test_qos_first_by_hand():
    # P = 10, gains 1 and 10, noise 1, at least 1 bit: powers 5.5 and 4.5, 6.52356 bit in all.
    channel, clusters = np.array([[1.0 + 0j], [10**0.5]]), np.array([[0, 1]])
    powers = qos_first_powers(channel, clusters, 10.0, 1.0, 1.0, 1.0)
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
        powers = qos_first_powers(channel, clusters, 20.0, 1.0, 1.0, 0.3)
        best = noma_rates(channel, powers, clusters, 1.0, 1.0)
        assert best.min() >= 0.3
        assert feasible.max() <= best.sum() <= feasible.max() + 0.3


@given(SEEDS, st.floats(0, 3), st.booleans())
def test_qos_first_meets_qos_where_power_lasts(seed, qos, static):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(6).reshape(2, 3)
    channel = complex_normal(rng, (4, 6, 3))
    order = rng.permuted(np.broadcast_to(clusters, (4, 2, 3)), axis=-1) if static else None
    powers = qos_first_powers(channel, clusters, 50.0, 1.0, 0.1, qos, order)
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
    np.testing.assert_array_equal(qos_first_powers(channel, np.array([[0, 1]]), 10.0, 1.0, 1.0, 4.0), [0, 10])
