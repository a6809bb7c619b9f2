"""The radio in torch, pinned to the compiled kernels."""

import numpy as np
import pytest
import torch
from cases import effective_channel, qos_first_powers, random_channels
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Radio
from mjris.eval import gradients
from mjris.eval.gradients import Problem, effective_gains, merit, zero_forcing
from mjris.radio import access, serving
from mjris.radio.fading import complex_normal
from mjris.radio.surface import Surface, coefficient

BAND = 1e6
SEEDS = st.integers(0, 2**32 - 1)
SHAPES = [(4, 2, 4), (4, 1, 2), (6, 3, 4), (6, 2, 3)]  # K, V, M


def radio(**changes):
    """10 W, and a noise power of 0.1 W."""
    return Radio(noise_dbm_per_mhz=20.0, bandwidth_hz=BAND, tx_power_dbm=40.0, **changes)


def random_case(rng, users, num_clusters, antennas):
    channel = complex_normal(rng, (5, users, antennas)) * 10 ** rng.uniform(-1, 0, (5, users, 1))
    return channel, rng.permutation(users).reshape(num_clusters, -1)


@given(SEEDS, st.integers(1, 4), st.booleans())
def test_beams_are_those_of_the_kernel(seed, rows, dependent):
    channel = complex_normal(np.random.default_rng(seed), (3, rows, 4))
    if dependent:
        channel[1, -1] = channel[1, 0]
    found = zero_forcing(torch.as_tensor(channel)).numpy()
    regular = [0, 2] if dependent and rows > 1 else [0, 1, 2]
    np.testing.assert_allclose(found[regular], access.zero_forcing(channel)[regular], rtol=1e-9, atol=1e-10)
    # Regularised ones are as badly conditioned as 1e-7 lets them be.
    np.testing.assert_allclose(found, access.zero_forcing(channel), atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_gains_are_those_of_the_kernel(shape):
    rng = np.random.default_rng(0)
    channel, clusters = random_case(rng, *shape)
    powers = rng.uniform(0, 1, channel.shape[:2])
    system = serving.System.of(radio(num_clusters=shape[1]), clusters, 0.0)
    budgets = torch.as_tensor(powers[:, clusters].sum(-1))
    found = effective_gains(torch.as_tensor(channel), budgets, torch.as_tensor(clusters), 0.1).numpy()
    np.testing.assert_allclose(found, serving.effective_gains(system, channel, channel, powers), rtol=1e-9)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
@pytest.mark.parametrize("qos_bps", [0.0, 1e5, 8e5])
@pytest.mark.parametrize("shape", SHAPES)
def test_merit_is_the_sum_rate_of_qos_first_powers_where_all_have_qos(scheme, qos_bps, shape):
    channel, clusters = random_case(np.random.default_rng(1), *shape)
    made = radio(scheme=scheme, num_clusters=shape[1])
    problem = Problem(torch.as_tensor(clusters), made, qos_bps)
    sum_rate, shortfall = merit(problem, torch.as_tensor(channel), problem.full_budgets)
    if scheme == "oma":
        rates = access.oma_rates(channel, np.full(channel.shape[:2], 10.0 / shape[0]), clusters, BAND, 0.1)
    else:
        powers = qos_first_powers(channel, clusters, 10.0, BAND, 0.1, qos_bps)
        rates = access.noma_rates(channel, powers, clusters, BAND, 0.1)
    met = (rates >= qos_bps * (1 - 1e-12)).all(-1)
    np.testing.assert_array_equal(shortfall.numpy() == 0, met)
    np.testing.assert_allclose(sum_rate.numpy()[met], rates.sum(-1)[met], rtol=1e-8)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_gradient_matches_finite_differences_of_the_kernels(scheme):
    rng = np.random.default_rng(9)
    channels, phases, clusters = (
        random_channels(rng, (2,), 4, 3, 5),
        rng.uniform(0, 6, (2, 5)),
        np.array([[0, 3], [1, 2]]),
    )
    problem = Problem(torch.as_tensor(clusters), radio(scheme=scheme), 0.0)

    def sum_rate(phases):
        effective = effective_channel(channels, phases)
        if scheme == "oma":
            return access.oma_rates(effective, np.full((2, 4), 2.5), clusters, BAND, 0.1).sum()
        powers = qos_first_powers(effective, clusters, 10.0, BAND, 0.1, 0.0)
        return access.noma_rates(effective, powers, clusters, BAND, 0.1).sum()

    direct, incident, reflected = (torch.as_tensor(link) for link in channels)
    turned = torch.tensor(phases, requires_grad=True)
    effective = direct + (reflected * torch.exp(1j * turned)[:, None]) @ incident
    merit(problem, effective, problem.full_budgets)[0].sum().backward()
    numeric = np.zeros_like(phases)
    for index in np.ndindex(phases.shape):
        step = np.zeros_like(phases)
        step[index] = 1e-6
        numeric[index] = (sum_rate(phases + step) - sum_rate(phases - step)) / 2e-6
    assert turned.grad is not None
    np.testing.assert_allclose(turned.grad.numpy(), numeric, rtol=1e-4, atol=1e-4 * abs(numeric).max())


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0.5, 4))
def test_coefficients_are_those_of_the_kernel(seed, least, steepness):
    phases = np.random.default_rng(seed).uniform(-9, 9, 20)
    surface = Surface(0.8, 0.0, least, steepness, 1.2)
    found = gradients.coefficients(surface, torch.as_tensor(phases)).numpy()
    expected = [coefficient(surface, turn) for turn in np.exp(1j * phases)]
    np.testing.assert_allclose(found, expected, atol=1e-9)
