"""Where panels face."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjris.world.facing import bisectors


@given(st.integers(0, 2**32 - 1))
def test_the_bisector_is_in_the_middle_of_ap_and_users(seed):
    rng = np.random.default_rng(seed)
    receivers, places, forward = rng.uniform(0, 9, (5, 3)), rng.uniform(0, 9, (11, 2)), np.empty((2, 11))
    places[3] = receivers[1, :2]
    bisectors(receivers, *places.T.copy(), *forward)
    for place, found in zip(places, forward.T, strict=True):
        units = [(end - place) / max(np.linalg.norm(end - place), 1e-300) for end in receivers[:, :2]]
        users = sum(units[:4]) / np.linalg.norm(sum(units[:4]))
        np.testing.assert_allclose(found, users + units[4], atol=1e-9)
