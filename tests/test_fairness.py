import numpy as np

from mjris.eval.fairness import jain_index, low_rate_bps, superposing_share, user_qos_share

RATES = np.array([[[0, 0, 0, 8], [1, 1, 1, 1]], [[4, 4, 0, 0], [0, 0, 0, 0]]]) * 1e6
"""Two slots of two scenes with four users [bit/s]."""


def test_users_with_qos_are_counted_one_by_one():
    np.testing.assert_allclose(user_qos_share(RATES, 1e6), [3 / 8, 4 / 8])
    np.testing.assert_allclose(user_qos_share(RATES, 4e6), [3 / 8, 0])


def test_the_low_rate_is_a_percentile_of_all_users_and_slots_of_a_scene():
    rates = np.random.default_rng(0).permuted(np.arange(40.0)).reshape(10, 1, 4)
    # A twentieth of the way from the least of 40 to the largest.
    np.testing.assert_allclose(low_rate_bps(np.concatenate([rates, 3 * rates], 1)), [0.05 * 39, 3 * 0.05 * 39])


def test_jain_s_index_is_the_mean_of_that_of_the_slots():
    np.testing.assert_allclose(jain_index(RATES), [(1 / 4 + 1 / 2) / 2, 1])


def test_clusters_superpose_where_two_of_their_users_have_power():
    powers = np.zeros((2, 2, 4))
    powers[0, 0] = 1, 0, 1, 1e-9
    powers[1, 0] = 1, 1, 0, 1
    powers[:, 1] = 1
    clusters = np.array([[0, 2], [1, 3]])
    # Of the first scene: users 0 and 2 in the first slot, 1 and 3 in the second.
    np.testing.assert_allclose(superposing_share(powers, clusters, "noma"), [2 / 4, 1])
    np.testing.assert_allclose(superposing_share(powers, clusters, "oma"), 0)
