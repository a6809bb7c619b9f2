import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.learn.products import AVAILABLE, product

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="this PyTorch has no BLAS for others to call")
sizes = st.integers(1, 40)


@given(sizes, sizes, sizes, st.booleans(), st.booleans(), st.integers(0, 3), st.integers(0, 2**31))
def test_products_are_those_of_numpy(rows, inner, columns, left_turned, right_turned, apart, seed):
    rng = np.random.default_rng(seed)

    def matrix(*shape: int) -> np.ndarray:
        """Random, its rows so many numbers apart in memory."""
        return rng.normal(size=(shape[0], shape[1] + apart)).astype(np.float32)[:, : shape[1]]

    left = matrix(inner, rows) if left_turned else matrix(rows, inner)
    right = matrix(columns, inner) if right_turned else matrix(inner, columns)
    out = matrix(rows, columns)
    out[:] = np.nan
    product(left, right, out, left_turned, right_turned)
    expected = (left.T if left_turned else left).astype(float) @ (right.T if right_turned else right)
    np.testing.assert_allclose(out, expected, atol=1e-4)
