"""The compiled slot against `access` and `control`, and the closed forms that only it has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.access import cluster_beams, decoding_order, noma_rates, oma_rates, zero_forcing
from mjris.radio.alignment import qos_aligned_phases
from mjris.radio.channel import Channels, effective_channel, ris_response
from mjris.radio.control import aligned_phases, qos_first_powers
from mjris.radio.control import split_powers as split_by_arrays
from mjris.radio.fading import complex_normal
from mjris.radio.serving import System, qos_or_sum, rates, split_powers

CLUSTERS = np.array([[0, 3], [2, 1]])
SEEDS = st.integers(0, 2**32 - 1)
SHAPES = st.sampled_from([(1, 1, 1), (1, 4, 2), (2, 2, 3), (3, 2, 3), (2, 3, 4), (4, 1, 4)])


def system(scheme, tx_power_w, bandwidth_hz, noise_w, qos_bps, clusters=CLUSTERS, selects=False) -> System:
    return System(clusters, scheme == "oma", tx_power_w, bandwidth_hz, noise_w, qos_bps, selects)


def random_channels(rng, batch=(3,), users=4, antennas=4, elements=16):
    shapes = ((users, antennas), (elements, antennas), (users, elements))
    return Channels(*(complex_normal(rng, (*batch, *shape)) for shape in shapes))


def random_clusters(rng, num_clusters, size):
    return rng.permutation(num_clusters * size).reshape(num_clusters, size)


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


@given(SEEDS, st.sampled_from(["noma", "oma"]))
def test_shares_of_powers_are_those_of_control(seed, scheme):
    rng = np.random.default_rng(seed)
    clusters, shares = random_clusters(rng, 2, 3), rng.uniform(0, rng.uniform(0.1, 1), (5, 6))
    expected = split_by_arrays(shares, clusters, scheme, 5.0)
    found = split_powers(system(scheme, 5.0, 1.0, 1.0, 0.0, clusters), shares)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_bad_powers():
    channel = complex_normal(np.random.default_rng(0), (2, 4, 4))
    for bad in (-0.1, np.nan):
        with pytest.raises(ValueError, match="power_w"):
            rates(system("noma", 1.0, 1.0, 1.0, 0.0), channel, np.array([0.1, 0.1, bad, 0.1]))


def slow_serve(served: System, channel, qos_bps):
    """Powers and rates of one choice of least rates, and everybody's beam [..., K, M], by `access` and `control`."""
    scheme, clusters = "oma" if served.oma else "noma", served.clusters
    powers = qos_first_powers(
        channel, clusters, scheme, served.tx_power_w, served.bandwidth_hz, served.noise_w, qos_bps
    )
    found = (oma_rates if served.oma else noma_rates)(channel, powers, clusters, served.bandwidth_hz, served.noise_w)
    beams = np.empty(channel.shape, complex)
    if served.oma:
        for band in clusters.T:
            beams[..., band, :] = np.swapaxes(zero_forcing(channel[..., band, :]), -1, -2)
    else:
        for users, beam in zip(clusters, np.moveaxis(cluster_beams(channel, clusters), -1, 0), strict=True):
            beams[..., users, :] = beam[..., None, :]
    return powers, found, beams


def slow_phases(served: System, channels: Channels, weights, iterations=7):
    """`qos_aligned_phases` of all cells at once, from array operations."""
    strength = (abs(channels.direct) ** 2).sum(-1)
    best, phases = np.full(len(strength), -np.inf), np.zeros(channels.incident.shape[:2])
    for rank in range(served.clusters.shape[1]):
        chosen = np.zeros(strength.shape, bool)
        for users in served.clusters:
            at = users[np.argsort(-strength[:, users], axis=1)[:, rank]]
            chosen[np.arange(len(at)), at] = True
        response = ris_response(
            aligned_phases(channels, np.where(chosen, weights, -1 / weights) / strength, iterations=0), 1.0
        )
        raised = weights.copy()
        for iteration in range(iterations):
            channel = effective_channel(channels, response)
            _, found, beams = slow_serve(served, channel, served.qos_bps)
            _, unserved, _ = slow_serve(served, channel, 0.0)
            met = (found >= served.qos_bps).all(-1)
            found = np.where(met[:, None], found, unserved)
            score = found.sum(-1) + 1e12 * met
            phases = np.where((score > best)[:, None], np.angle(response), phases)
            best = np.maximum(best, score)
            own = (channel * beams).sum(-1)
            if iteration >= 2:
                raised = np.where(found < served.qos_bps, 2 * raised, raised)
            toward = raised * own.conj() if iteration < 2 else raised / own
            through = channels.reflected * np.einsum("enm,ekm->ekn", channels.incident, beams)
            pull = (toward[..., None] * through).sum(1)
            response = pull.conj() / abs(pull)
    return phases


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.5), ("oma", 2.5)])
@given(seed=SEEDS)
def test_aligned_phases_are_those_of_slow_arrays(scheme, qos, seed):
    rng = np.random.default_rng(seed)
    channels = random_channels(rng, batch=(5,), elements=9)
    served = system(scheme, 5.0, 1.0, 0.1, qos, random_clusters(rng, 2, 2))
    weights = 10 ** rng.uniform(-1, 1, (5, 4))
    expected = slow_phases(served, channels, weights, iterations=4)
    found = qos_aligned_phases(served, channels, weights, iterations=4)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * expected), atol=1e-6)


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.6), ("oma", 4.0)])
def test_qos_or_sum_serves_all_or_maximises_the_sum(scheme, qos):
    channel = complex_normal(np.random.default_rng(3), (200, 4, 3))
    arguments = (50.0, 1.0, 0.1, qos)
    rates_of = noma_rates if scheme == "noma" else oma_rates
    powers, rates = qos_or_sum(system(scheme, *arguments), channel)
    np.testing.assert_allclose(rates, rates_of(channel, powers, CLUSTERS, 1.0, 0.1), rtol=1e-9)
    first = qos_first_powers(channel, CLUSTERS, scheme, *arguments)
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


@pytest.mark.parametrize(("scheme", "qos"), [("noma", 0.5), ("oma", 2.5)])
def test_qos_aligned_phases_beat_aligned_ones(scheme, qos):
    rng = np.random.default_rng(5)
    channels = random_channels(rng, batch=(200,))
    channels = channels._replace(reflected=0.3 * channels.reflected)
    served = system(scheme, 5.0, 1.0, 0.1, qos)

    def score(phases):
        _, rates = qos_or_sum(served, effective_channel(channels, ris_response(phases, 1.0)))
        return (rates >= qos).all(-1) * 1e6 + rates.sum(-1)

    plain, better = score(aligned_phases(channels)), score(qos_aligned_phases(served, channels))
    assert (better >= plain - 1e-9).mean() > 0.95
    assert (better > plain + 1e-3).mean() > 0.5
    assert (better > 1e6).sum() > (plain > 1e6).sum()
    random = score(rng.uniform(-np.pi, np.pi, (200, 16)))
    assert better.mean() > random.mean()


def test_weights_decide_whom_the_panel_serves():
    channels = random_channels(np.random.default_rng(6), batch=(100,))
    served = system("noma", 5.0, 1.0, 0.1, 0.0)
    for user in range(4):
        weights = np.where(np.arange(4) == user, 1e3, 1.0) * np.ones((100, 1))
        phases = qos_aligned_phases(served, channels, weights, iterations=1)
        gain = (abs(effective_channel(channels, ris_response(phases, 1.0))) ** 2).sum(-1)
        assert gain.mean(0).argmax() == user


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


@given(SEEDS)
def test_phases_for_a_given_order_are_scored_in_it(seed):
    """Knowing the order never serves fewer than not knowing it, but for what seven steps find by chance."""
    rng = np.random.default_rng(seed)
    channels = random_channels(rng, batch=(40,))
    channels = channels._replace(reflected=0.5 * channels.reflected)
    served = system("noma", 5.0, 1.0, 0.1, 0.3)
    order = np.stack([rng.permuted(CLUSTERS, axis=1) for _ in range(40)])

    def score(phases):
        found = qos_or_sum(served, effective_channel(channels, ris_response(phases, 1.0)), None, order)[1]
        return (found >= 0.3).all(-1) * 1e6 + found.sum(-1)

    aware = score(qos_aligned_phases(served, channels, None, order))
    unaware = score(qos_aligned_phases(served, channels))
    assert (aware >= unaware * (1 - 1e-9)).mean() > 0.8
    assert aware.mean() > unaware.mean() * (1 - 1e-9)


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
