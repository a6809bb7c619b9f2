import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjris.radio.channel import phase_ramp
from mjris.radio.links import channels
from mjris.radio.propagation import complex_normal, rician


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 1, 1, 1), (2, 4, 4, 16), (3, 2, 3, 5)]))
def test_channels_are_those_of_the_array_functions(seed, shape):
    cells, users, antennas, elements = shape
    rng = np.random.default_rng(seed)
    ap, people, panel = (rng.uniform(-5, 5, (cells, count, 3)) for count in (antennas, users, elements))
    amplitude = rng.uniform(1e-5, 1e-2, (cells, 2 * users + 1))
    k_factor = np.where(rng.random(amplitude.shape) < 0.5, 0.0, rng.uniform(0, 100, amplitude.shape))
    sizes = users * antennas, elements * antennas, users * elements
    diffuse = complex_normal(rng, (cells, sum(sizes)))
    made = channels(ap, people, panel, amplitude, k_factor, diffuse, 0.15)
    parts = np.split(diffuse, np.cumsum(sizes)[:2], axis=1)
    for found, ends, starts, part, links in (
        (made.direct, people, ap, parts[0], slice(0, users)),
        (made.incident, panel, ap, parts[1], slice(2 * users, None)),
        (made.reflected, people, panel, parts[2], slice(users, 2 * users)),
    ):
        los = phase_ramp(ends, starts, 0.15)
        factor, scale = k_factor[:, links, None], amplitude[:, links, None]
        expected = scale * rician(los, part.reshape(los.shape), factor)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
