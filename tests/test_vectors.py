import math

import numba
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjris.jit import vectors

EPS = np.finfo(float).eps


@given(st.floats(-700, 700))
def test_exp_is_that_of_the_library(x):
    assert abs(vectors.exp(x) / math.exp(x) - 1) < 3 * EPS


@given(st.floats(1e-307, 1e308))
def test_log_is_that_of_the_library(x):
    assert abs(vectors.log(x) - math.log(x)) <= 3 * EPS * abs(math.log(x))


@given(st.floats(0, 1e300) | st.floats(0, 1e-3))
def test_log1p_is_that_of_the_library_near_zero_too(x):
    assert abs(vectors.log1p(x) - math.log1p(x)) <= 3 * EPS * math.log1p(x)


@given(st.floats(allow_nan=False))
def test_tanh_is_that_of_the_library_but_for_rounding(x):
    assert abs(vectors.tanh(x) - math.tanh(x)) < 2 * EPS


@given(st.integers(-(10**6), 10**6), st.integers(-(2**20), 2**20))
def test_phasor_is_that_of_the_library_and_does_not_know_whole_turns(whole, part):
    turn = part / 2**21  # the sum with a whole number is exact
    expected = complex(math.cos(2 * math.pi * turn), -math.sin(2 * math.pi * turn))
    assert abs(vectors.phasor(whole + turn) - expected) < 5 * EPS
    assert vectors.phasor(whole + turn) == vectors.phasor(turn)


def test_a_loop_is_done_as_number_by_number():
    x = np.random.default_rng(0).uniform(0.1, 50, 1003)
    for function in (vectors.exp, vectors.log, vectors.log1p, vectors.tanh):

        @numba.njit
        def loop(values, function=function):
            found = np.empty_like(values)
            for i in range(len(values)):
                found[i] = function(values[i])
            return found

        np.testing.assert_allclose(loop(x), [function(each) for each in x], rtol=3 * EPS)
