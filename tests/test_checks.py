import numpy as np
import pytest

from mjris.simulation.checks import checked


def test_what_is_right_comes_back_as_float64():
    found = checked("action", np.ones((2, 3), np.float32), (3,), (2, 3))
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, np.ones((2, 3)))
    assert checked("action", [1, 2, 3], (3,), (2, 3)).shape == (3,)


def test_cell_and_entry_are_named():
    values = np.zeros((2, 3))
    values[1, 2] = np.nan
    with pytest.raises(ValueError, match="action: nan in entry 2 of cell 1 is not allowed: every entry must be a fin"):
        checked("action", values, (2, 3))
    with pytest.raises(ValueError, match="action: -inf in entry 0 of cell 0"):
        checked("action", [-np.inf, 0], (2,))
    with pytest.raises(ValueError, match=r"an array of shape \(3,\) is not allowed: it must be \(2,\) or \(4, 2\)"):
        checked("action", np.zeros(3), (2,), (4, 2))
