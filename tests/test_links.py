import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Radio
from mjris.radio import channel, links
from mjris.radio.channel import phase_ramp
from mjris.radio.links import Means, channels
from mjris.radio.propagation import complex_normal, db_to_linear, path_loss_db, rician


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 1, 1, 1), (2, 4, 4, 16), (3, 2, 3, 5)]))
def test_channels_are_those_of_the_array_functions(seed, shape):
    cells, users, antennas, elements = shape
    rng = np.random.default_rng(seed)
    ap, people, panel = (rng.uniform(-5, 5, (cells, count, 3)) for count in (antennas, users, elements))
    amplitude = rng.uniform(1e-5, 1e-2, (cells, 2 * users + 1))
    k_factor = np.where(rng.random(amplitude.shape) < 0.5, 0.0, rng.uniform(0, 100, amplitude.shape))
    sizes = users * antennas, elements * antennas, users * elements
    diffuse = complex_normal(rng, (cells, sum(sizes)))
    made = channels(ap, people, panel, Means(amplitude, amplitude, k_factor), diffuse, 0.15)
    parts = np.split(diffuse, np.cumsum(sizes)[:2], axis=1)
    for found, ends, starts, part, own in (
        (made.direct, people, ap, parts[0], slice(0, users)),
        (made.incident, panel, ap, parts[1], slice(2 * users, None)),
        (made.reflected, people, panel, parts[2], slice(users, 2 * users)),
    ):
        los = phase_ramp(ends, starts, 0.15)
        factor, scale = k_factor[:, own, None], amplitude[:, own, None]
        expected = scale * rician(los, part.reshape(los.shape), factor)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("pattern", ["isotropic", "cosine"])
def test_means_are_those_of_the_array_functions(pattern):
    radio, rng = Radio(element_pattern=pattern, element_exponent=0.8, rician_k_db=5.0), np.random.default_rng(0)
    cells, users = 50, 3
    ap, panel = rng.uniform(0, 6, (2, cells, 3))
    receivers, heading = rng.uniform(0, 6, (cells, users, 3)), rng.uniform(-4, 4, cells)
    receivers[0, 0] = panel[0]  # no distance at all, hence no direction
    start, end = links.ends(ap, panel, receivers)
    aps, panels = (np.broadcast_to(place[:, None], receivers.shape) for place in (ap, panel))
    np.testing.assert_array_equal(start, np.concatenate([receivers, receivers, ap[:, None]], 1))
    np.testing.assert_array_equal(end, np.concatenate([aps, panels, panel[:, None]], 1))
    blockers = rng.integers(0, 4, (cells, 2 * users + 1))
    mean = links.means(links.Medium.of(radio), start, end, blockers, heading)
    loss_db = path_loss_db(np.linalg.norm(start - end, axis=-1), blockers, radio.carrier_hz)
    gain = db_to_linear(-loss_db)
    normal = channel.panel_normal(heading)[:, None]
    gain[:, users:] *= channel.element_gain(pattern, 0.8, normal, (start - end)[:, users:])
    np.testing.assert_allclose(mean.loss_db, loss_db, rtol=1e-13)
    np.testing.assert_allclose(mean.amplitude, np.sqrt(gain), rtol=1e-12)
    np.testing.assert_allclose(mean.k_factor, np.where(blockers > 0, 0, 10**0.5))


@pytest.mark.parametrize("pattern", ["isotropic", "cosine"])
def test_gains_of_the_panel_are_path_loss_and_pattern(pattern):
    radio, rng = Radio(element_pattern=pattern, element_exponent=0.8), np.random.default_rng(2)
    medium = links.Medium.of(radio)
    for blockers in (0, 1, 3):
        for distance, cosine in [*rng.uniform((0.2, -0.2), (30, 1), (20, 2)), (5.0, 0.0), (5.0, 1.0)]:
            gain = 10 ** (-path_loss_db(np.array(distance), np.array(blockers), radio.carrier_hz) / 10)
            gain *= links.pattern_gain(medium, cosine)
            assert links.panel_gain(medium, distance**2, blockers, cosine) == pytest.approx(gain, rel=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_the_bisector_is_in_the_middle_of_ap_and_users(seed):
    rng = np.random.default_rng(seed)
    receivers, places, forward = rng.uniform(0, 9, (5, 3)), rng.uniform(0, 9, (11, 2)), np.empty((2, 11))
    places[3] = receivers[1, :2]
    links.bisectors(receivers, *places.T.copy(), *forward)
    for place, found in zip(places, forward.T, strict=True):
        units = [(end - place) / max(np.linalg.norm(end - place), 1e-300) for end in receivers[:, :2]]
        users = sum(units[:4]) / np.linalg.norm(sum(units[:4]))
        np.testing.assert_allclose(found, users + units[4], atol=1e-9)


def test_panel_elements_are_those_of_the_array_function():
    rng = np.random.default_rng(1)
    centre, heading = rng.uniform(0, 9, (5, 3)), rng.uniform(-4, 4, 5)
    expected = channel.panel_elements(centre, heading, 3, 4, 0.07)
    np.testing.assert_allclose(links.panel_elements(centre, heading, 3, 4, 0.07), expected, rtol=1e-14)
