"""Diffuse fading over time and between cells."""

import numpy as np
import pytest

from mjris.radio.fading import complex_normal, evolve, mix_cells

SAMPLES = 200_000


def correlation(a, b):
    return np.mean(a * b.conj()) / np.sqrt(np.mean(abs(a) ** 2) * np.mean(abs(b) ** 2))


def test_complex_normal_is_circular_with_unit_power():
    samples = complex_normal(np.random.default_rng(1), (SAMPLES, 2))
    assert samples.shape == (SAMPLES, 2)
    np.testing.assert_allclose(np.mean(abs(samples) ** 2, axis=0), 1, atol=0.01)
    np.testing.assert_allclose(np.mean(samples**2, axis=0), 0, atol=0.01)  # circular
    assert abs(correlation(samples[:, 0], samples[:, 1])) < 0.01


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.95])
def test_evolution_keeps_power_and_has_the_memory(memory):
    rng = np.random.default_rng(2)
    first = complex_normal(rng, (SAMPLES,))
    second = evolve(first, complex_normal(rng, (SAMPLES,)), memory)
    third = evolve(second, complex_normal(rng, (SAMPLES,)), memory)
    assert np.mean(abs(third) ** 2) == pytest.approx(1, abs=0.01)
    assert correlation(second, first) == pytest.approx(memory, abs=0.01)
    assert correlation(third, first) == pytest.approx(memory**2, abs=0.01)


def test_memory_of_one_freezes_the_fading():
    rng = np.random.default_rng(3)
    first = complex_normal(rng, (10,))
    np.testing.assert_array_equal(evolve(first, complex_normal(rng, (10,)), 1.0), first)


@pytest.mark.parametrize("difference_factor", [0.0, 0.3, 1.0])
def test_cells_are_correlated_by_one_minus_the_difference_factor(difference_factor):
    rng = np.random.default_rng(4)
    cells = mix_cells(complex_normal(rng, (SAMPLES,)), complex_normal(rng, (3, SAMPLES)), difference_factor)
    np.testing.assert_allclose(np.mean(abs(cells) ** 2, axis=-1), 1, atol=0.01)
    assert correlation(cells[0], cells[1]) == pytest.approx(1 - difference_factor, abs=0.01)
    assert correlation(cells[1], cells[2]) == pytest.approx(1 - difference_factor, abs=0.01)
