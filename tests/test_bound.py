"""The upper bound: tight where a closed form is known, and above everything that can be reached."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import effective_channel
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from mjris.config import Hardware, Radio
from mjris.eval.bound import upper_bound
from mjris.eval.optimum import best_known
from mjris.radio import surface
from mjris.radio.access import noma_rates, oma_rates
from mjris.radio.ascent import Effort
from mjris.radio.closed_forms import aligned_phases
from mjris.radio.fading import complex_normal
from mjris.radio.links import Channels
from mjris.radio.powers import qos_or_sum, split_powers
from mjris.radio.serving import System
from mjris.radio.surface import Surface

SEEDS = st.integers(0, 2**32 - 1)
SCHEMES = st.sampled_from(["noma", "oma"])
BAND = 1e6


def unit_radio(power_w=10.0, **changes):
    """A noise power of 1 W in the band of 1 MHz."""
    return Radio(noise_dbm_per_mhz=30.0, bandwidth_hz=BAND, tx_power_dbm=10 * np.log10(power_w) + 30, **changes)


def random_channels(rng, batch=(3,), users=4, antennas=4, elements=6):
    """Users whose losses differ by up to 30 dB, and a reflected path that is weak, alike or strong."""
    loss = 10 ** rng.uniform(-1.5, 0, (*batch, users, 1))
    reflection = 10 ** rng.uniform(-2, 0.5, (*batch, users, 1))
    return Channels(
        complex_normal(rng, (*batch, users, antennas)) * loss,
        complex_normal(rng, (*batch, elements, antennas)),
        complex_normal(rng, (*batch, users, elements)) * loss * reflection,
    )


def sum_rates(channels, phases, powers, clusters, radio):
    channels = Channels(*(np.broadcast_to(link, (*phases.shape[:-1], *link.shape[-2:])) for link in channels))
    effective = effective_channel(channels, phases, radio.element_amplitude)
    rates = oma_rates if radio.scheme == "oma" else noma_rates
    return rates(effective, powers, clusters, radio.bandwidth_hz, radio.noise_w).sum(-1)


@given(SEEDS, SCHEMES, st.sampled_from([1, 2, 4]), st.floats(0.01, 1000), st.sampled_from([1.0, 0.5, 0.0]))
@settings(max_examples=60)
def test_nothing_random_exceeds_the_bound(seed, scheme, num_clusters, power_w, amplitude):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(4).reshape(num_clusters, -1)
    radio = unit_radio(power_w, scheme=scheme, num_clusters=num_clusters, element_amplitude=amplitude)
    channels = random_channels(rng)
    bound = upper_bound(channels, clusters, radio)
    assert bound.shape == (3,)
    phases = rng.uniform(-np.pi, np.pi, (50, 3, 6))
    # Half of the draws give all of the power to few users.
    shares = rng.uniform(0, 1, (50, 3, 4)) ** rng.choice([1, 20], (50, 1, 1))
    shares = (shares / shares.max(-1, keepdims=True)).reshape(-1, 4)
    powers = split_powers(System.of(radio, clusters, 0.0), shares).reshape(50, 3, 4)
    assert np.all(sum_rates(channels, phases, powers, clusters, radio) <= bound)


@given(SEEDS, SCHEMES, st.sampled_from([None, 1, 3]), st.floats(0, 1))
def test_no_surface_exceeds_the_bound(seed, scheme, bits, least):
    rng = np.random.default_rng(seed)
    radio = unit_radio(10.0, scheme=scheme, num_clusters=2)
    radio = replace(radio, surface=Hardware(phase_bits=bits, least_amplitude=least))
    channels, clusters = random_channels(rng), rng.permutation(4).reshape(2, 2)
    phases = np.concatenate([aligned_phases(Surface.of(radio), channels)[None], rng.uniform(-9, 9, (20, 3, 6))])
    repeated = Channels(*(np.broadcast_to(link, (21, *link.shape)) for link in channels))
    effective = surface.effective_channel(Surface.of(radio), repeated, phases)
    system = System.of(radio, clusters, 0.0)
    assert (qos_or_sum(system, effective)[1].sum(-1) <= upper_bound(channels, clusters, radio)).all()


@given(SEEDS, SCHEMES, st.sampled_from([1, 2, 4]), st.floats(0.01, 1000), st.sampled_from(["equal", "shared"]))
@settings(max_examples=10, phases=[Phase.generate])
def test_the_best_known_does_not_exceed_the_bound(seed, scheme, num_clusters, power_w, cluster_power):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(4).reshape(num_clusters, -1)
    radio = unit_radio(power_w, scheme=scheme, num_clusters=num_clusters, cluster_power=cluster_power)
    channels = random_channels(rng, batch=(8,))
    effort = Effort(choices=16, variants=3, screening=8, finalists=2, steps=8, sweeps=1)
    best = best_known(channels, clusters, radio, 0.0, rng, None, effort)
    assert np.all(best.rates_bps.sum(-1) <= upper_bound(channels, clusters, radio))


@given(SEEDS, SCHEMES, st.sampled_from([1, 2, 4]), st.floats(0.01, 1000))
@settings(max_examples=30)
def test_the_triangle_inequality_is_not_tighter(seed, scheme, num_clusters, power_w):
    rng = np.random.default_rng(seed)
    clusters = rng.permutation(4).reshape(num_clusters, -1)
    radio = unit_radio(power_w, scheme=scheme, num_clusters=num_clusters)
    channels = random_channels(rng, batch=())
    rate = []
    for user in range(4):
        through = abs(channels.reflected[user, :, None] * channels.incident)
        gain = ((abs(channels.direct[user]) + through.sum(0)) ** 2).sum()
        rate.append(BAND * math.log2(1 + power_w / num_clusters * gain))
    loose = num_clusters / 4 * sum(rate) if scheme == "oma" else sum(max(rate[k] for k in c) for c in clusters)
    assert upper_bound(channels, clusters, radio) <= loose * (1 + 1e-9)


@given(SEEDS, SCHEMES)
def test_one_user_and_antenna_have_exactly_the_closed_form(seed, scheme):
    channels = random_channels(np.random.default_rng(seed), users=1, antennas=1)
    gain = (abs(channels.direct[:, 0, 0]) + abs(channels.reflected[:, 0] * channels.incident[..., 0]).sum(-1)) ** 2
    bound = upper_bound(channels, np.array([[0]]), unit_radio(scheme=scheme, num_clusters=1))
    np.testing.assert_allclose(bound, BAND * np.log2(1 + 10 * gain), rtol=1e-9)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_users_that_do_not_disturb_each_other_reach_the_bound(scheme):
    # Every user has an antenna of its own and no reflection: zero forcing then costs nothing.
    channels = Channels(np.diag([1.0, 2, 3, 4]).astype(complex), np.zeros((5, 4), complex), np.zeros((4, 5), complex))
    radio = unit_radio(scheme=scheme, num_clusters=4)
    expected = BAND * np.log2(1 + 10 / 4 * np.array([1, 4, 9, 16])).sum()
    assert upper_bound(channels, np.arange(4)[:, None], radio) == pytest.approx(expected, rel=1e-9)


def test_no_channel_gives_no_rate():
    nothing = Channels(np.zeros((2, 3), complex), np.zeros((5, 3), complex), np.zeros((2, 5), complex))
    assert upper_bound(nothing, np.array([[0, 1]]), unit_radio(num_clusters=1)) == 0
