"""Path loss by every link table, and the pattern of elements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import ConfigError, Radio
from mjris.radio.propagation import db_to_linear, element_gain, path_loss_db


def test_line_of_sight_loss_by_hand():
    # 16.9 log10(10) - 27.2 + 20 log10(2000)
    assert path_loss_db(10.0, 0, 2e9) == pytest.approx(16.9 - 27.2 + 66.0205999, abs=1e-6)


@pytest.mark.parametrize(("blockers", "extra_db"), [(1, 15), (2, 19), (5, 31)])
def test_blocked_loss_by_hand(blockers, extra_db):
    assert path_loss_db(10.0, blockers, 2e9) == pytest.approx(66.0205999 - 28 + 25.5 + extra_db, abs=1e-6)


def test_blocked_loss_has_the_form_that_ns3_published():
    # ns-3's ItuR1238 test: 2.114 GHz, N = 28, one floor apart (8 dB), sqrt(981) m; the paper has N = 25.5 and 15 dB.
    other_db = 15 - 8 + (25.5 - 28) * np.log10(np.sqrt(981))
    assert path_loss_db(np.sqrt(981), 1, 2.114e9) == pytest.approx(88.3855 + other_db, abs=1e-4)


@pytest.mark.parametrize(
    ("carrier_hz", "distance", "clear", "blocked"), [(3.5e9, 10, 60.5814, 69.1473), (28e9, 1, 61.3432, 61.3432)]
)
def test_3gpp_losses_by_hand(carrier_hz, distance, clear, blocked):
    # 32.4 + 17.3 log10 d + 20 log10 f; behind anything the larger of that and 17.3 + 38.3 log10 d + 24.9 log10 f
    assert path_loss_db(distance, 0, carrier_hz, "inh") == pytest.approx(clear, abs=1e-4)
    np.testing.assert_allclose(path_loss_db(distance, [1, 4], carrier_hz, "inh"), blocked, atol=1e-4)


@pytest.mark.parametrize(
    ("table", "carrier_hz", "said"),
    [
        ("paper", 2e8, "radio.carrier_hz: 2e\\+08 is not allowed: .* holds from 3e\\+08 to 3e\\+11 Hz"),
        ("inh", 1.4e11, "radio.carrier_hz: 1.4e\\+11 is not allowed: .*3GPP.* holds from 5e\\+08 to 1e\\+11 Hz"),
        ("free", 2e9, "radio.link_table: 'free' is not known: it is one of inh, paper"),
    ],
)
def test_tables_that_are_unknown_or_do_not_hold_are_refused(table, carrier_hz, said):
    with pytest.raises(ConfigError, match=said):
        path_loss_db(10.0, 0, carrier_hz, table)


def test_loss_broadcasts_and_is_clamped_below_one_metre():
    loss = path_loss_db(np.array([[0.0], [0.5], [1.0]]), np.array([0, 1]), 2e9)
    assert loss.shape == (3, 2)
    np.testing.assert_array_equal(loss, np.broadcast_to(loss[2], (3, 2)))


@given(st.floats(1, 100), st.integers(0, 20), st.floats(1e-3, 10))
def test_loss_grows_with_distance_and_obstacles(distance, blockers, further):
    assert path_loss_db(distance + further, blockers, 2e9) > path_loss_db(distance, blockers, 2e9)
    assert path_loss_db(distance, blockers + 1, 2e9) > path_loss_db(distance, blockers, 2e9)


def test_db_to_linear():
    np.testing.assert_allclose(db_to_linear(np.array([-30.0, 0.0, 10.0])), [1e-3, 1, 10], rtol=1e-14)


def pattern(name, exponent=0.0):
    return Radio(element_pattern=name, element_exponent=exponent)


def test_cosine_pattern_by_hand():
    cosines = [1, 2**-0.5, 0, -(2**-0.5), -1]
    np.testing.assert_allclose(element_gain(pattern("cosine", 3), cosines), [8, 8 * 2**-1.5, 0, 0, 0], rtol=1e-14)
    np.testing.assert_allclose(element_gain(pattern("cosine", 0.57), 1.0), 3.14, rtol=1e-14)
    np.testing.assert_array_equal(element_gain(pattern("isotropic", 3), cosines), np.ones(5))


@pytest.mark.parametrize(("name", "exponent"), [("isotropic", 0.0), ("cosine", 0.0), ("cosine", 0.57), ("cosine", 3)])
def test_patterns_radiate_all_the_power(name, exponent):
    cosine = (np.arange(200_000) + 0.5) / 100_000 - 1  # even over the sphere
    assert element_gain(pattern(name, exponent), cosine).mean() == pytest.approx(1, rel=1e-5)
