"""The channels over the RIS."""

import numpy as np
import pytest
import torch

from mjris.radio.channel import Channels, cascade, effective_channel, ris_response
from mjris.radio.control import aligned_phases
from mjris.radio.fading import complex_normal


def random_channels(rng, batch=(3,), users=4, antennas=3, elements=5):
    return Channels(
        complex_normal(rng, (*batch, users, antennas)),
        complex_normal(rng, (*batch, elements, antennas)),
        complex_normal(rng, (*batch, users, elements)),
    )


def test_effective_channel_equals_the_matrix_product():
    rng = np.random.default_rng(1)
    channels = random_channels(rng)
    phases = rng.uniform(0, 2 * np.pi, (3, 5))
    effective = effective_channel(channels, ris_response(phases, 0.8))
    for cell in range(3):
        theta = np.diag(0.8 * np.exp(1j * phases[cell]))
        expected = channels.direct[cell] + channels.reflected[cell] @ theta @ channels.incident[cell]
        np.testing.assert_allclose(effective[cell], expected, rtol=1e-12)


def test_cascade_adds_up_to_the_effective_channel():
    rng = np.random.default_rng(2)
    channels = random_channels(rng)
    response = ris_response(rng.uniform(0, 6, (3, 5)), 1.0)
    paths = cascade(channels)
    assert paths.shape == (3, 4, 5, 3)
    total = channels.direct + (response[:, None, :, None] * paths).sum(axis=2)
    np.testing.assert_allclose(effective_channel(channels, response), total, rtol=1e-12)


def test_every_element_has_modulus_one():
    phases = np.random.default_rng(3).uniform(-50, 50, (7, 16))
    np.testing.assert_allclose(abs(ris_response(phases, 1.0)), 1, rtol=1e-15)
    np.testing.assert_allclose(abs(ris_response(phases, 0.5)), 0.5, rtol=1e-15)


@pytest.mark.parametrize("elements", [1, 16, 96])
def test_an_aligned_panel_gains_the_square_of_its_elements(elements):
    """One antenna and one user, without a direct path, and every path of modulus one."""
    incident, reflected = np.exp(1j * np.random.default_rng(6).uniform(0, 7, (2, elements)))
    channels = Channels(np.zeros((1, 1), dtype=complex), incident[:, None], reflected[None])
    effective = effective_channel(channels, ris_response(aligned_phases(channels), 1.0))
    assert abs(effective[0, 0]) ** 2 == pytest.approx(elements**2, rel=1e-12)


@pytest.mark.parametrize(("bits", "loss_db"), [(1, -3.92), (2, -0.91)])
def test_quantised_phases_lose_the_known_gain(bits, loss_db):
    rng = np.random.default_rng(4)
    channels = Channels(
        np.zeros((1, 1), dtype=complex),
        np.exp(1j * rng.uniform(0, 2 * np.pi, (20_000, 1))),
        np.exp(1j * rng.uniform(0, 2 * np.pi, (1, 20_000))),
    )
    step = 2 * np.pi / 2**bits
    phases = np.round(aligned_phases(channels) / step) * step
    gain = abs(effective_channel(channels, ris_response(phases, 1.0))[0, 0]) ** 2
    assert 10 * np.log10(gain / 20_000**2) == pytest.approx(loss_db, abs=0.05)


def test_torch_channels_equal_numpy():
    rng = np.random.default_rng(5)
    channels, phases = random_channels(rng), rng.uniform(0, 6, (3, 5))
    expected = effective_channel(channels, ris_response(phases, 0.9))
    of_torch = Channels(*(torch.asarray(link) for link in channels))
    actual = effective_channel(of_torch, ris_response(torch.asarray(phases), 0.9))
    np.testing.assert_allclose(actual.numpy(), expected, rtol=1e-12, atol=1e-12)
