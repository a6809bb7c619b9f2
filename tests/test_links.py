"""Which links there are, and the channels over them."""

import math

import literal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Radio
from mjris.radio import links
from mjris.radio.fading import complex_normal
from mjris.radio.links import Links, Means
from mjris.radio.tables import LinkTable

SHAPES = st.sampled_from(
    [(1, 1, 1, ((1, 1),)), (2, 4, 4, ((4, 4),)), (3, 2, 3, ((1, 5), (2, 2))), (1, 3, 2, ((2, 1),) * 3)]
)
"""Cells, users, antennas, rows and columns of every panel."""
WAVELENGTH = 0.15


def test_links_are_users_panels_with_users_and_panels():
    made = Links(2, np.array([4, 1, 6]))
    assert (made.direct, made.reflected, made.incident) == (slice(0, 2), slice(2, 8), slice(8, 11))
    assert made.person.tolist() == [0, 1, 0, 1, 0, 1, 0, 1, -1, -1, -1]
    assert made.panel.tolist() == [-1, -1, 0, 0, 1, 1, 2, 2, 0, 1, 2]


def test_entries_belong_to_the_links_of_their_ends():
    direct, incident, reflected = Links(2, np.array([1, 3])).of_entries(2)
    assert direct.tolist() == [[0, 0], [1, 1]]
    assert incident.tolist() == [[6, 6], [7, 7], [7, 7], [7, 7]]
    assert reflected.tolist() == [[2, 4, 4, 4], [3, 5, 5, 5]]


def test_links_end_where_everything_stands():
    rng = np.random.default_rng(3)
    ap, panels, receivers = rng.random((4, 3)), rng.random((4, 2, 3)), rng.random((4, 3, 3))
    start, end = Links(3, np.array([4, 4])).ends(ap, panels, receivers)
    for e in range(4):
        expected = [(receivers[e, k], ap[e]) for k in range(3)]
        expected += [(receivers[e, k], panels[e, s]) for s in range(2) for k in range(3)]
        expected += [(ap[e], panels[e, s]) for s in range(2)]
        np.testing.assert_array_equal(start[e], [pair[0] for pair in expected])
        np.testing.assert_array_equal(end[e], [pair[1] for pair in expected])


@given(st.integers(0, 2**32 - 1), SHAPES)
def test_every_entry_has_the_phase_of_its_own_way_and_the_gain_of_its_link(seed, shape):
    cells, users, antennas, sizes = shape
    rng, counts = np.random.default_rng(seed), [math.prod(size) for size in sizes]
    made = Links(users, np.array(counts))
    ap, people, elements = (rng.uniform(-5, 5, (cells, count, 3)) for count in (antennas, users, sum(counts)))
    gain = rng.uniform(1e-10, 1e-4, (cells, len(made.panel)))
    k_factor = np.where(rng.random(gain.shape) < 0.5, 0.0, rng.uniform(0, 100, gain.shape))
    diffuse = complex_normal(rng, (cells, users * antennas + sum(counts) * (antennas + users)))
    found = links.channels(made, ap, people, elements, Means(gain, gain, k_factor), diffuse, WAVELENGTH)
    panel_of = [s for s, count in enumerate(counts) for _ in range(count)]
    for e in range(cells):
        left = iter(diffuse[e])

        def check(entry, end, start, link, e=e, left=left):
            expected = literal.entry(gain[e, link], k_factor[e, link], end, start, next(left), WAVELENGTH)
            assert entry == pytest.approx(expected, rel=1e-9, abs=1e-15)

        for k in range(users):
            for m in range(antennas):
                check(found.direct[e, k, m], people[e, k], ap[e, m], made.direct.start + k)
        for n, s in enumerate(panel_of):
            for m in range(antennas):
                check(found.incident[e, n, m], elements[e, n], ap[e, m], made.incident.start + s)
        for k in range(users):
            for n, s in enumerate(panel_of):
                check(found.reflected[e, k, n], people[e, k], elements[e, n], made.reflected.start + s * users + k)


@pytest.mark.parametrize("k_factor", [0.0, 1.0, 5.0])
def test_rician_has_unit_power_and_its_k_factor(k_factor):
    samples, rng = 200_000, np.random.default_rng(5)
    gain, ratio = np.ones((1, 3)), np.full((1, 3), k_factor)
    places = np.zeros((1, 1, 3)), np.ones((1, 1, 3)), np.ones((1, samples, 3))
    diffuse = complex_normal(rng, (1, 1 + 2 * samples))
    made = links.channels(Links(1, np.array([samples])), *places, Means(gain, gain, ratio), diffuse, WAVELENGTH)
    fading = made.incident[0, :, 0]
    specular, scattered = abs(np.mean(fading)) ** 2, np.var(fading)
    assert specular + scattered == pytest.approx(1, abs=0.01)
    assert specular / scattered == pytest.approx(k_factor, rel=0.02, abs=1e-3)
    # Fourth moment of the Rician envelope: E|h|^4 = 1 + (2K + 1) / (K + 1)^2
    assert np.mean(abs(fading) ** 4) == pytest.approx(1 + (2 * k_factor + 1) / (k_factor + 1) ** 2, rel=0.02)


@pytest.mark.parametrize("table", ["paper", "inh"])
@pytest.mark.parametrize("pattern", ["isotropic", "cosine"])
def test_means_are_path_loss_and_pattern_of_the_panel_at_the_end(table, pattern):
    radio = Radio(link_table=table, element_pattern=pattern, element_exponent=0.8, rician_k_db=5.0)
    rng, made, cells = np.random.default_rng(0), Links(3, np.array([4, 4])), 20
    ap, panels = rng.uniform(0, 6, (cells, 3)), rng.uniform(0, 6, (cells, 2, 3))
    receivers, heading = rng.uniform(0, 6, (cells, 3, 3)), rng.uniform(-4, 4, (cells, 2))
    receivers[0, 0] = panels[0, 0]  # no distance at all, hence no direction
    start, end = made.ends(ap, panels, receivers)
    obstacles = rng.integers(0, 4, start.shape[:2]).astype(float)
    mean = links.means(LinkTable.of(radio), made.panel, start, end, obstacles, heading)
    for e in range(cells):
        for link in range(start.shape[1]):
            n, s = int(obstacles[e, link]), made.panel[link]
            loss = literal.path_loss_db(table, math.dist(start[e, link], end[e, link]), n, radio.carrier_hz)
            gain = literal.mean_gain(radio, start[e, link], end[e, link], None if s < 0 else heading[e, s], n)
            assert mean.loss_db[e, link] == pytest.approx(loss, rel=1e-12)
            assert mean.gain[e, link] == pytest.approx(gain, rel=1e-11, abs=1e-200)
            assert mean.k_factor[e, link] == pytest.approx(0 if n else 10**0.5)


def test_linear_array_by_hand():
    elements = links.uniform_linear_array(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0]), 3, 0.5)
    np.testing.assert_allclose(elements, [[1, 1.5, 3], [1, 2, 3], [1, 2.5, 3]])


def test_panels_by_hand():
    # Facing +x, a row runs along +y, and the rows come from the bottom; facing +y, it runs along -x.
    centres, headings = np.array([[[0.0, 0.0, 1.5], [5.0, 5.0, 2.0]]]), np.array([[0.0, np.pi / 2]])
    elements = links.panel_elements(centres, headings, np.array([[2, 3], [1, 2]]), 0.1)
    across, up = [-0.1, 0.0, 0.1], [1.45, 1.55]
    first = [[0, y, z] for z in up for y in across]
    np.testing.assert_allclose(elements[0], [*first, [5.05, 5, 2], [4.95, 5, 2]], atol=1e-15)


@given(st.floats(-10, 10))
def test_a_panel_is_centred_and_orthogonal_to_its_heading(heading):
    centres, headings = np.array([[[1.0, 2.0, 1.5]], [[4.0, 0.0, 1.0]]]), np.array([[heading], [heading + 1]])
    elements = links.panel_elements(centres, headings, np.array([[3, 4]]), 0.07)
    assert elements.shape == (2, 12, 3)
    np.testing.assert_allclose(elements.mean(1), centres[:, 0], atol=1e-12)
    normal = np.stack([np.cos(headings), np.sin(headings), np.zeros_like(headings)], -1)
    np.testing.assert_allclose(((elements - centres) * normal).sum(-1), 0, atol=1e-12)
