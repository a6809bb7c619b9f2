"""What the surface makes of what reaches it."""

import literal
import numpy as np
import pytest
from cases import aligned_phases, effective_channel, random_channels
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Hardware, Radio
from mjris.radio import surface as surface_module
from mjris.radio.links import Channels
from mjris.radio.surface import Surface, cascade, coefficient, mean_coefficient, power_drawn_w


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
    paths = cascade(channels)
    assert paths.shape == (3, 5, 4, 3)
    total = channels.direct + (0.7 * np.exp(1j * phases)[..., None, None] * paths).sum(axis=1)
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


@pytest.mark.parametrize(("bits", "loss_db"), [(1, -3.92), (2, -0.91), (3, -0.22)])
def test_elements_of_few_bits_lose_the_known_gain(bits, loss_db):
    rng = np.random.default_rng(4)
    channels = Channels(
        np.zeros((1, 1), dtype=complex),
        np.exp(1j * rng.uniform(0, 2 * np.pi, (20_000, 1))),
        np.exp(1j * rng.uniform(0, 2 * np.pi, (1, 20_000))),
    )
    surface = Surface.of(Radio(surface=Hardware(phase_bits=bits)))
    gain = abs(surface_module.effective_channel(surface, channels, aligned_phases(channels))[0, 0]) ** 2
    assert 10 * np.log10(gain / 20_000**2) == pytest.approx(loss_db, abs=0.05)


HARDWARE = st.builds(
    Hardware,
    phase_bits=st.none() | st.integers(1, 8),
    least_amplitude=st.floats(0, 1),
    amplitude_steepness=st.floats(0, 5),
    amplitude_offset_deg=st.floats(-180, 180),
    phase_noise_deg=st.floats(0, 180),
    dead_share=st.floats(0, 1),
)


@given(HARDWARE, st.floats(-50, 50))
def test_coefficients_are_the_literal_ones(hardware, phase):
    radio = Radio(element_amplitude=0.8, surface=hardware)
    found, expected = (
        coefficient(Surface.of(radio), complex(np.exp(1j * phase))),
        literal.coefficient(radio, phase),
    )
    step = 2 * np.pi / 2 ** (hardware.phase_bits or 50)
    halfway = abs((phase / step) % 1 - 0.5) * step
    # Between two phases that are as near, rounding may choose; what it chooses is as far from the wanted one.
    if hardware.phase_bits is None or halfway > 1e-9:
        assert found == pytest.approx(expected, abs=1e-9)
    assert abs(found) <= 0.8 * (1 + 1e-12)
    assert abs(found) >= 0.8 * hardware.least_amplitude * (1 - 1e-12)


@given(HARDWARE)
def test_on_average_elements_do_what_many_of_them_do(hardware):
    """Against elements with random wanted phases, with noise and dead ones."""
    radio, rng = Radio(surface=hardware), np.random.default_rng(0)
    wanted = rng.uniform(-np.pi, np.pi, 4000)
    sent = np.array([coefficient(Surface.of(radio), turn) for turn in np.exp(1j * wanted)])
    sent *= np.exp(1j * np.radians(hardware.phase_noise_deg) * rng.standard_normal(4000))
    sent *= rng.random(4000) >= hardware.dead_share
    mean = mean_coefficient(radio)
    assert (sent * np.exp(-1j * wanted)).mean() == pytest.approx(mean.coherent, abs=0.06)
    assert (abs(sent) ** 2).mean() == pytest.approx(mean.power, abs=0.06)


def test_ideal_elements_are_what_they_were():
    surface = Surface.of(Radio())
    assert (surface.amplitude, surface.step_rad, surface.least) == (1.0, 0.0, 1.0)
    assert mean_coefficient(Radio(element_amplitude=0.7)) == pytest.approx((0.7, 0.49))


def test_power_drawn_by_hand():
    made = Hardware(board_w=4.8, elements_per_driver=8, driver_w=0.1, element_w=0.01)
    # 400 elements have 50 drivers, 20 have 3.
    assert power_drawn_w(made, np.array([400, 20])) == pytest.approx(4.8 + 5 + 4 + 4.8 + 0.3 + 0.2)
    assert power_drawn_w(Hardware(), np.array([400])) == 0
