"""Element positions, patterns and the channels over the RIS."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.channel import (
    Channels,
    cascade,
    effective_channel,
    element_gain,
    panel_elements,
    panel_normal,
    phase_ramp,
    ris_response,
    uniform_linear_array,
)
from mjris.radio.control import aligned_phases
from mjris.radio.propagation import complex_normal

WAVELENGTH = 0.15


def random_channels(rng, batch=(3,), users=4, antennas=3, elements=5):
    return Channels(
        complex_normal(rng, (*batch, users, antennas)),
        complex_normal(rng, (*batch, elements, antennas)),
        complex_normal(rng, (*batch, users, elements)),
    )


def test_linear_array_by_hand():
    elements = uniform_linear_array(np.array([1.0, 2.0, 3.0]), np.array([0.0, 2.0, 0.0]), 3, 0.5)
    np.testing.assert_allclose(elements, [[1, 1.5, 3], [1, 2, 3], [1, 2.5, 3]])


def test_panel_by_hand():
    # Facing +x, a row runs along +y, and the rows come from the bottom.
    elements = panel_elements(np.array([0.0, 0.0, 1.5]), np.array(0.0), 2, 3, 0.1)
    across, up = [-0.1, 0.0, 0.1], [1.45, 1.55]
    np.testing.assert_allclose(elements, [[0, y, z] for z in up for y in across], atol=1e-15)


@given(st.floats(-10, 10))
def test_panel_is_centred_and_orthogonal_to_its_normal(heading):
    centres = np.array([[1.0, 2.0, 1.5], [4.0, 0.0, 1.0]])
    headings = np.array([heading, heading + 1])
    elements = panel_elements(centres, headings, 3, 4, 0.07)
    assert elements.shape == (2, 12, 3)
    np.testing.assert_allclose(elements.mean(axis=-2), centres, atol=1e-12)
    normal = panel_normal(headings)
    np.testing.assert_allclose(normal, np.stack([np.cos(headings), np.sin(headings), [0, 0]], axis=-1))
    np.testing.assert_allclose(((elements - centres[:, None]) * normal[:, None]).sum(-1), 0, atol=1e-12)


def test_cosine_pattern_by_hand():
    normal = np.array([2.0, 0.0, 0.0])
    directions = np.array([[5.0, 0, 0], [1, 1, 0], [0, 0, 1], [-1, 1, 0], [-3, 0, 0]])
    np.testing.assert_allclose(element_gain("cosine", 3, normal, directions), [8, 8 * 2**-1.5, 0, 0, 0], rtol=1e-14)
    np.testing.assert_allclose(element_gain("cosine", 0.57, normal, directions)[0], 3.14, rtol=1e-14)
    np.testing.assert_array_equal(element_gain("isotropic", 3, normal, directions), np.ones(5))


@pytest.mark.parametrize(
    ("pattern", "exponent"), [("isotropic", 0.0), ("cosine", 0.0), ("cosine", 0.57), ("cosine", 3)]
)
def test_patterns_radiate_all_the_power(pattern, exponent):
    cosine = (np.arange(200_000) + 0.5) / 100_000 - 1
    directions = np.stack([cosine, np.sqrt(1 - cosine**2), np.zeros_like(cosine)], axis=-1)
    gain = element_gain(pattern, exponent, np.array([1.0, 0.0, 0.0]), directions)
    assert gain.mean() * 4 * np.pi == pytest.approx(4 * np.pi, rel=1e-5)


def test_pattern_has_finite_derivatives_everywhere():
    directions = torch.tensor([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 0]], dtype=torch.float64, requires_grad=True)
    element_gain("cosine", 0.57, torch.tensor([1.0, 0, 0], dtype=torch.float64), directions).sum().backward()
    assert directions.grad is not None
    assert torch.isfinite(directions.grad).all()


def test_unknown_pattern_is_refused():
    with pytest.raises(ValueError, match="isotropic, cosine"):
        element_gain("dipole", 1, np.array([1.0, 0, 0]), np.array([1.0, 0, 0]))


def test_phases_follow_the_path_lengths():
    rng = np.random.default_rng(0)
    receivers, transmitters = rng.uniform(0, 10, (2, 3, 3)), rng.uniform(0, 10, (2, 4, 3))
    ramp = phase_ramp(receivers, transmitters, WAVELENGTH)
    for index in np.ndindex(2, 3, 4):
        cell, a, b = index
        distance = np.linalg.norm(receivers[cell, a] - transmitters[cell, b])
        assert ramp[index] == pytest.approx(np.exp(-2j * np.pi * (distance / WAVELENGTH % 1)), abs=1e-10)


def test_half_a_wavelength_turns_the_phase():
    receivers = np.array([[3.0, 0, 0], [3.0 + WAVELENGTH / 2, 0, 0], [3.0 + WAVELENGTH, 0, 0]])
    ramp = phase_ramp(receivers, np.zeros((1, 3)), WAVELENGTH)[:, 0]
    np.testing.assert_allclose(ramp / ramp[0], [1, -1, 1], atol=1e-12)


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


def far_panel(rows, cols):
    """Channels of one antenna and one user over a panel far from both, without a direct path."""
    panel = panel_elements(np.array([0.0, 0.0, 1.5]), np.array(0.3), rows, cols, WAVELENGTH / 2)
    incident = phase_ramp(panel, np.array([[40.0, 30.0, 2.5]]), WAVELENGTH)
    reflected = phase_ramp(np.array([[35.0, -28.0, 1.1]]), panel, WAVELENGTH)
    return Channels(np.zeros((1, 1), dtype=complex), incident, reflected)


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (4, 4), (8, 12)])
def test_aligned_panel_gains_the_square_of_its_elements(rows, cols):
    channels = far_panel(rows, cols)
    effective = effective_channel(channels, ris_response(aligned_phases(channels), 1.0))
    assert abs(effective[0, 0]) ** 2 == pytest.approx((rows * cols) ** 2, rel=1e-12)


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
    centre, heading = rng.uniform(0, 5, (3, 3)), rng.uniform(0, 6, 3)
    users = rng.uniform(0, 10, (3, 4, 3))

    def build(asarray):
        panel = panel_elements(asarray(centre), asarray(heading), 2, 3, 0.075)
        ap = uniform_linear_array(asarray(centre) + 3, asarray([0.0, 1.0, 0.0]), 4, 0.075)
        toward = asarray(users) - asarray(centre)[:, None]
        gain = element_gain("cosine", 0.57, panel_normal(asarray(heading))[:, None], toward)
        reflected = gain[..., None] ** 0.5 * phase_ramp(asarray(users), panel, WAVELENGTH)
        channels = Channels(phase_ramp(asarray(users), ap, WAVELENGTH), phase_ramp(panel, ap, WAVELENGTH), reflected)
        return effective_channel(channels, ris_response(asarray(heading)[:, None] + panel[..., 0], 0.9))

    expected = build(np.asarray)
    actual = build(lambda values: torch.asarray(values, dtype=torch.float64))
    np.testing.assert_allclose(actual.numpy(), expected, rtol=1e-12, atol=1e-12)
