"""What the surface makes of what reaches it."""

import numpy as np
import pytest
from cases import aligned_phases, effective_channel, random_channels

from mjris.radio.links import Channels
from mjris.radio.surface import Surface, cascade, coefficient


def test_effective_channel_equals_the_matrix_product():
    rng = np.random.default_rng(1)
    channels, phases = random_channels(rng, antennas=3, elements=5), rng.uniform(0, 2 * np.pi, (3, 5))
    effective = effective_channel(channels, phases, 0.8)
    for cell in range(3):
        theta = np.diag(0.8 * np.exp(1j * phases[cell]))
        expected = channels.direct[cell] + channels.reflected[cell] @ theta @ channels.incident[cell]
        np.testing.assert_allclose(effective[cell], expected, rtol=1e-12)


def test_leading_axes_are_those_of_the_channels():
    rng = np.random.default_rng(7)
    channels, phases = random_channels(rng, batch=(2, 3), elements=5), rng.uniform(0, 6, 5)
    effective = effective_channel(channels, phases)
    assert effective.shape == (2, 3, 4, 4)
    one = Channels(*(link[1, 2] for link in channels))
    np.testing.assert_allclose(effective[1, 2], effective_channel(one, phases), rtol=1e-14)


def test_cascade_adds_up_to_the_effective_channel():
    rng = np.random.default_rng(2)
    channels, phases = random_channels(rng, antennas=3, elements=5), rng.uniform(0, 6, (3, 5))
    paths = cascade(Surface(0.7), channels)
    assert paths.shape == (3, 5, 4, 3)
    total = channels.direct + (np.exp(1j * phases)[..., None, None] * paths).sum(axis=1)
    np.testing.assert_allclose(effective_channel(channels, phases, 0.7), total, rtol=1e-12)


def test_every_element_has_the_modulus_of_the_surface():
    for phase in np.random.default_rng(3).uniform(-50, 50, 20):
        assert coefficient(Surface(0.5), np.exp(1j * phase)) == pytest.approx(0.5 * np.exp(1j * phase))


@pytest.mark.parametrize("elements", [1, 16, 96])
def test_an_aligned_panel_gains_the_square_of_its_elements(elements):
    """One antenna and one user, without a direct path, and every path of modulus one."""
    incident, reflected = np.exp(1j * np.random.default_rng(6).uniform(0, 7, (2, elements)))
    channels = Channels(np.zeros((1, 1), dtype=complex), incident[:, None], reflected[None])
    effective = effective_channel(channels, aligned_phases(channels))
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
    gain = abs(effective_channel(channels, np.round(aligned_phases(channels) / step) * step)[0, 0]) ** 2
    assert 10 * np.log10(gain / 20_000**2) == pytest.approx(loss_db, abs=0.05)
