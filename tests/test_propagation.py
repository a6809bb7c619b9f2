"""Path loss and fading."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.propagation import (
    complex_normal,
    db_to_linear,
    evolve,
    indoor_loss_db,
    mix_cells,
    path_loss_db,
    rician,
)

SAMPLES = 200_000


def correlation(a, b):
    return np.mean(a * b.conj()) / np.sqrt(np.mean(abs(a) ** 2) * np.mean(abs(b) ** 2))


def test_line_of_sight_loss_by_hand():
    # 16.9 log10(10) - 27.2 + 20 log10(2000)
    assert path_loss_db(10.0, 0, 2e9) == pytest.approx(16.9 - 27.2 + 66.0205999, abs=1e-6)


@pytest.mark.parametrize(("blockers", "extra_db"), [(1, 15), (2, 19), (5, 31)])
def test_blocked_loss_by_hand(blockers, extra_db):
    assert path_loss_db(10.0, blockers, 2e9) == pytest.approx(66.0205999 - 28 + 25.5 + extra_db, abs=1e-6)


def test_indoor_loss_matches_the_published_value_of_ns3():
    # ns-3's ItuR1238 test: residential, 2.114 GHz, N = 28, one floor apart, sqrt(981) m.
    assert indoor_loss_db(np.sqrt(981), 2.114e9, 28, 8) == pytest.approx(88.3855, abs=1e-4)


def test_loss_broadcasts_and_is_clamped_below_one_metre():
    loss = path_loss_db(np.array([[0.0], [0.5], [1.0]]), np.array([0, 1]), 2e9)
    assert loss.shape == (3, 2)
    np.testing.assert_array_equal(loss, np.broadcast_to(loss[2], (3, 2)))


@given(st.floats(1, 100), st.integers(0, 20), st.floats(1e-3, 10))
def test_loss_grows_with_distance_and_obstacles(distance, blockers, further):
    assert path_loss_db(distance + further, blockers, 2e9) > path_loss_db(distance, blockers, 2e9)
    assert path_loss_db(distance, blockers + 1, 2e9) > path_loss_db(distance, blockers, 2e9)


def test_torch_loss_equals_numpy():
    rng = np.random.default_rng(0)
    distance, blockers = rng.uniform(0, 30, (5, 4)), rng.integers(0, 4, (5, 4))
    expected = path_loss_db(distance, blockers, 2e9)
    actual = path_loss_db(torch.asarray(distance), torch.asarray(blockers), 2e9)
    np.testing.assert_allclose(actual.numpy(), expected, rtol=1e-12)


def test_db_to_linear():
    np.testing.assert_allclose(db_to_linear(np.array([-30.0, 0.0, 10.0])), [1e-3, 1, 10], rtol=1e-14)


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


@pytest.mark.parametrize("k_factor", [0.0, 1.0, 5.0])
def test_rician_has_unit_power_and_its_k_factor(k_factor):
    los = np.exp(0.7j)
    fading = rician(los, complex_normal(np.random.default_rng(5), (SAMPLES,)), k_factor)
    specular, scattered = abs(np.mean(fading)) ** 2, np.var(fading)
    assert specular + scattered == pytest.approx(1, abs=0.01)
    assert specular / scattered == pytest.approx(k_factor, rel=0.02, abs=1e-3)
    # Fourth moment of the Rician envelope: E|h|^4 = 1 + (2K + 1) / (K + 1)^2
    assert np.mean(abs(fading) ** 4) == pytest.approx(1 + (2 * k_factor + 1) / (k_factor + 1) ** 2, rel=0.02)


def test_k_factor_broadcasts_over_links():
    fading = rician(np.ones((2, 3)) + 0j, np.full((2, 3), 1j), np.array([[0.0], [3.0]]))
    np.testing.assert_allclose(fading, [[1j] * 3, [0.75**0.5 + 0.5j] * 3], atol=1e-15)
