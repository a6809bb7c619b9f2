"""Phases by ascent: never worse than the closed forms, near the best known, with what the surface can do."""

from dataclasses import replace

import numpy as np
import pytest
from cases import CLUSTERS, random_channels
from hypothesis import given, settings
from hypothesis import strategies as st

from mjris.config import Hardware, Radio
from mjris.eval.optimum import best_known
from mjris.radio import closed_forms, powers, serving
from mjris.radio.ascent import Effort, ascended_phases
from mjris.radio.links import Channels
from mjris.radio.serving import System
from mjris.radio.surface import Surface, effective_channel

BAND = 1e6
SEEDS = st.integers(0, 2**32 - 1)
EFFORT = Effort.of(16)


def radio(power_w=10.0, **changes):
    """A noise power of 1 W in the band of 1 MHz."""
    return Radio(noise_dbm_per_mhz=30.0, bandwidth_hz=BAND, tx_power_dbm=10 * np.log10(power_w) + 30, **changes)


def weak(channels, loss=0.3):
    """Users with losses of their own, and elements whose paths together are as strong as the direct one."""
    direct, incident, reflected = channels
    far = np.linspace(1, loss, direct.shape[-2])[:, None]
    return Channels(direct * far, incident, reflected * far / incident.shape[-2])


def score(rates, qos_bps):
    """The sum rate, and less than any sum rate where somebody misses QoS."""
    return rates.sum(-1) - np.where((rates >= qos_bps).all(-1), 0, 1e9)


def served(system, surface, channels, phases, order=None, searched=True):
    """Rates under the closed-form powers, with or without a search for budgets."""
    effective = effective_channel(surface, channels, phases)
    return powers.qos_or_sum(system, effective, None, order, searched=searched)[1]


HARDWARE = st.sampled_from(
    [Hardware(), Hardware(phase_bits=1), Hardware(phase_bits=3), Hardware(least_amplitude=0.2, phase_bits=2)]
)


@given(SEEDS, st.sampled_from(["noma", "oma"]), HARDWARE, st.sampled_from([0.0, 0.3, 1.0]), st.booleans())
@settings(max_examples=25)
def test_never_worse_than_the_closed_forms(seed, scheme, hardware, qos, static):
    rng = np.random.default_rng(seed)
    channels, made = weak(random_channels(rng, (4,), elements=12)), radio(scheme=scheme, surface=hardware)
    system, surface = System.of(made, CLUSTERS, qos * BAND), Surface.of(made)
    order = rng.permuted(np.broadcast_to(CLUSTERS, (4, 2, 2)), axis=-1) if static and scheme == "noma" else None
    closed = closed_forms.qos_aligned_phases(system, surface, channels, None, order)
    phases = ascended_phases(system, surface, channels, EFFORT, None, order)
    before = score(served(system, surface, channels, closed, order, searched=False), qos * BAND)
    after = score(served(system, surface, channels, phases, order), qos * BAND)
    assert (after >= before - 1e-6 * BAND).all()
    if hardware.phase_bits:
        step = 2 * np.pi / 2**hardware.phase_bits
        np.testing.assert_allclose(phases / step, np.rint(phases / step), atol=1e-9)


def test_most_of_the_way_to_the_best_known_where_interference_is_what_hurts():
    rng = np.random.default_rng(0)
    channels, made, qos = weak(random_channels(rng, (40,), elements=32), 0.1), radio(1e3), 1.5 * BAND
    system, surface = System.of(made, CLUSTERS, qos), Surface.of(made)
    closed = closed_forms.qos_aligned_phases(system, surface, channels)
    phases = ascended_phases(system, surface, channels, Effort.of(20))
    best = best_known(channels, CLUSTERS, made, qos, rng).rates_bps

    def value(rates):
        return (rates.sum(-1) / np.where((rates >= qos).all(-1), 1, 2)).mean()

    low, reached = (value(served(system, surface, channels, each)) for each in (closed, phases))
    assert low < 0.9 * value(best)
    assert reached - low > 0.85 * (value(best) - low)


def test_weights_choose_whom_the_rest_goes_to():
    rng = np.random.default_rng(2)
    channels, made = weak(random_channels(rng, (20,), elements=32)), radio()
    system, surface = System.of(made, CLUSTERS, 0.1 * BAND), Surface.of(made)
    shares = []
    for cluster in (0, 1):
        weights = np.ones((20, 4))
        weights[:, CLUSTERS[cluster]] = 10
        rates = served(system, surface, channels, ascended_phases(system, surface, channels, EFFORT, weights))
        shares.append(rates[:, CLUSTERS[0]].sum() / rates.sum())
    assert shares[0] > shares[1] + 0.05


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_what_clusters_share_is_never_less_and_stays_within_all(scheme):
    rng = np.random.default_rng(3)
    channels = weak(random_channels(rng, (30,), elements=8), 0.05)
    phases = rng.uniform(-3, 3, (30, 8))
    found = []
    for power in ("equal", "shared"):
        made = radio(100.0, scheme=scheme, cluster_power=power)
        system = System.of(made, CLUSTERS, 1.0 * BAND)
        effective = effective_channel(Surface.of(made), channels, phases)
        given, rates = powers.qos_or_sum(system, effective, searched=True)
        assert (given.sum(-1) <= 100 * (1 + 1e-9)).all()
        if power == "equal":
            assert (given[:, CLUSTERS].sum(-1) <= 50 * (1 + 1e-9)).all()
        np.testing.assert_allclose(serving.rates(system, effective, given), rates, rtol=1e-9)
        found.append(score(rates, 1.0 * BAND))
    assert (found[1] >= found[0] - 1e-6 * BAND).all()
    assert (scheme == "oma") == (found[1] == found[0]).all()


def test_the_same_slot_gives_the_same_phases_in_any_batch():
    channels, made = weak(random_channels(np.random.default_rng(4), (3,))), radio()
    system, surface = System.of(made, CLUSTERS, 0.3 * BAND), Surface.of(made)
    together = ascended_phases(system, surface, channels, EFFORT)
    alone = ascended_phases(system, surface, Channels(*(link[1:2] for link in channels)), EFFORT)
    np.testing.assert_array_equal(together[1:2], alone)


def test_dead_elements_and_users_without_a_direct_path_are_no_trouble():
    channels = weak(random_channels(np.random.default_rng(5), (4,)))
    channels.incident[:, ::2] = 0
    channels.direct[:, 2] = 0
    made = radio()
    found = best_known(channels, CLUSTERS, made, 0.2 * BAND, np.random.default_rng(0))
    assert np.isfinite(found.phases_rad).all()
    assert (found.rates_bps.sum(-1) > 0).all()
    silent = replace(made, element_amplitude=0.0)
    system = System.of(silent, CLUSTERS, 0.0)
    assert np.isfinite(
        ascended_phases(system, Surface.of(silent), random_channels(np.random.default_rng(6)), EFFORT)
    ).all()
