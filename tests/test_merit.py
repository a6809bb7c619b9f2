"""The merit of a slot and its slopes: against QoS-first powers, finite differences, and torch's autograd."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from cases import random_clusters
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Radio
from mjris.radio import access, serving
from mjris.radio.fading import complex_normal
from mjris.radio.merit import merit, slot_score
from mjris.radio.powers import qos_first_powers
from mjris.radio.serving import System
from mjris.radio.surface import Surface, coefficient, slopes

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
torch_merit = importlib.import_module("torch_merit")

BAND = 1e6
SEEDS = st.integers(0, 2**32 - 1)
SHAPES = [(4, 2, 4), (4, 1, 2), (6, 3, 4), (6, 2, 3), (3, 3, 3)]  # K, V, M


def radio(**changes):
    """10 W, and a noise power of 0.1 W."""
    return Radio(noise_dbm_per_mhz=20.0, bandwidth_hz=BAND, tx_power_dbm=40.0, **changes)


def random_case(rng, shape, scheme="noma", qos_bps=0.0):
    users, num_clusters, antennas = shape
    channel = complex_normal(rng, (users, antennas)) * 10 ** rng.uniform(-1, 0, (users, 1))
    clusters = random_clusters(rng, num_clusters, users // num_clusters)
    return channel, System.of(radio(scheme=scheme, num_clusters=num_clusters), clusters, qos_bps)


def value(system, channel, budgets, weights, order, barrier, slopes=None):
    slopes = np.empty_like(channel) if slopes is None else slopes
    return merit(system, channel, budgets, weights, order, barrier, slopes)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
@pytest.mark.parametrize("qos_bps", [0.0, 1e5, 8e5])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_score_is_the_sum_rate_of_qos_first_powers_where_all_have_qos(scheme, qos_bps, shape):
    rng = np.random.default_rng(1)
    for _ in range(5):
        channel, system = random_case(rng, shape, scheme, qos_bps)
        given_order = rng.permuted(system.clusters, axis=1)
        for order in (system.no_order(1)[0], given_order):
            budgets = 10 / shape[1] * rng.uniform(0.5, 1, shape[1])
            if scheme == "oma":
                rates = access.oma_rates(channel, np.full(shape[0], 10.0 / shape[0]), system.clusters, BAND, 0.1)
            else:
                powers = qos_first_powers(system, channel[None], budgets[None], order[None])
                # With nothing to be had the strongest has all, whatever the order is.
                decoded = order[None] if order[0, 0] >= 0 and qos_bps > 0 else None
                rates = serving.rates(system, channel[None], powers, decoded)[0]
            found = slot_score(system, channel, budgets, np.ones(shape[0]), order)
            if (rates >= qos_bps * (1 - 1e-12)).all() and not (order[0, 0] >= 0 and qos_bps == 0):
                assert found == pytest.approx(rates.sum() / BAND, rel=1e-8)
            elif qos_bps > 0:
                assert found < 0


@given(SEEDS, st.sampled_from(SHAPES), st.sampled_from(["noma", "oma"]), st.sampled_from([0.0, 3e5, 2e6]))
def test_slopes_match_finite_differences(seed, shape, scheme, qos_bps):
    rng = np.random.default_rng(seed)
    channel, system = random_case(rng, shape, scheme, qos_bps)
    budgets, weights = 10 / shape[1] * rng.uniform(0.3, 1, shape[1]), rng.uniform(0.3, 3, shape[0])
    order = rng.permuted(system.clusters, axis=1) if rng.random() < 0.5 else system.no_order(1)[0]
    found = np.empty_like(channel)
    value(system, channel, budgets, weights, order, 0.01, found)
    way = complex_normal(rng, channel.shape)
    step = 1e-6
    ahead, behind = (value(system, channel + sign * step * way, budgets, weights, order, 0.01) for sign in (1, -1))
    expected = (found.conj() * way).real.sum()
    scale = abs(found * way).sum()
    assert (ahead - behind) / (2 * step) == pytest.approx(expected, abs=2e-5 * scale + 1e-6)


@given(SEEDS, st.sampled_from(SHAPES), st.sampled_from(["noma", "oma"]))
def test_value_and_slopes_are_those_of_torch(seed, shape, scheme):
    rng, qos_bps = np.random.default_rng(seed), 2e5
    channel, system = random_case(rng, shape, scheme, qos_bps)
    problem = torch_merit.Problem(
        torch.as_tensor(system.clusters), radio(scheme=scheme, num_clusters=shape[1]), qos_bps
    )
    budgets, ones = np.full(shape[1], 10 / shape[1]), np.ones(shape[0])
    theirs = torch.tensor(channel, requires_grad=True)
    sum_rate, shortfall = torch_merit.merit(problem, theirs, torch.as_tensor(budgets))
    total = sum_rate / BAND - 10 * shortfall
    if scheme == "noma":  # a cluster without QoS adds nothing to our sum rate, and n times QoS to theirs
        received = torch_merit.effective_gains(theirs.detach(), torch.as_tensor(budgets), problem.clusters, 0.1)
        clusters = received.numpy()[system.clusters]
        sinr = problem.least_sinr
        for v, gains in enumerate(clusters):
            needed = sum(sinr * (1 + sinr) ** i / gain for i, gain in enumerate(sorted(gains)))
            total = total - (len(gains) * qos_bps / BAND if needed > budgets[v] else 0.0)
    total.backward()
    found = np.empty_like(channel)
    reached = value(system, channel, budgets, ones, system.no_order(1)[0], 0.0, found)
    assert reached == pytest.approx(total.item(), rel=1e-6, abs=1e-6)  # but for their hairs
    assert theirs.grad is not None
    np.testing.assert_allclose(found, theirs.grad.numpy(), atol=1e-6 * abs(found).max())


@given(SEEDS, st.floats(0, 1), st.floats(0.6, 4))
def test_slopes_of_coefficients_match_finite_differences(seed, least, steepness):
    phases, surface = np.random.default_rng(seed).uniform(-9, 9, 20), Surface(0.8, 0.0, least, steepness, 1.2)
    found = slopes(surface, np.stack([np.cos(phases), np.sin(phases)]))

    def at(angles):
        return np.array([coefficient(surface, turn) for turn in np.exp(1j * angles)])

    expected = (at(phases + 1e-6) - at(phases - 1e-6)) / 2e-6
    clear = abs(np.sin(phases - 1.2) + 1) > 1e-3
    np.testing.assert_allclose((found[0] + 1j * found[1])[clear], expected[clear], atol=1e-5)


@given(SEEDS, st.integers(1, 4), st.booleans())
def test_beams_of_torch_are_those_of_the_kernel(seed, rows, dependent):
    channel = complex_normal(np.random.default_rng(seed), (3, rows, 4))
    if dependent:
        channel[1, -1] = channel[1, 0]
    found = torch_merit.zero_forcing(torch.as_tensor(channel)).numpy()
    regular = [0, 2] if dependent and rows > 1 else [0, 1, 2]
    np.testing.assert_allclose(found[regular], access.zero_forcing(channel)[regular], rtol=1e-9, atol=1e-10)
    # Regularised ones are as badly conditioned as 1e-7 lets them be.
    np.testing.assert_allclose(found, access.zero_forcing(channel), atol=1e-5)
