import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjris.config import preset
from mjris.world.footprints import Footprints, footprints, is_free, near
from mjris.world.layout import layout_names, load_layout
from mjris.world.office import PERSON_HEIGHT_M, build

COORDINATE = st.floats(-5, 5)
RECTANGLE = st.tuples(COORDINATE, COORDINATE, st.floats(0.05, 2), st.floats(0.05, 2), st.floats(-math.pi, math.pi))


def from_rectangles(rectangles) -> Footprints:
    x, y, a, b, yaw = np.array(rectangles, float).T[:, None]
    return Footprints(np.stack([x, y]), np.stack([a, b]), np.stack([np.cos(yaw), np.sin(yaw)]))


def distance_to_rectangle(point, rectangle) -> float:
    """From its four sides, each as a segment, and a test for points within."""
    x, y, a, b, yaw = rectangle
    turn = complex(math.cos(yaw), math.sin(yaw))
    p = complex(*point)
    corners = [complex(x, y) + turn * complex(sx * a, sy * b) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
    if all(((v - u).conjugate() * (p - u)).imag >= 0 for u, v in sides):
        return 0.0
    nearest = []
    for u, v in sides:
        share = ((v - u).conjugate() * (p - u)).real / abs(v - u) ** 2
        nearest.append(abs(u + min(max(share, 0), 1) * (v - u) - p))
    return min(nearest)


@given(st.lists(RECTANGLE, min_size=1, max_size=4), st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=5))
def test_distance_is_that_of_the_nearest_rectangle(rectangles, points):
    expected = [min(distance_to_rectangle(point, rectangle) for rectangle in rectangles) for point in points]
    actual = from_rectangles(rectangles).distance(np.array(points)[None])
    np.testing.assert_allclose(actual[0], expected, atol=1e-9)


@given(st.lists(RECTANGLE, min_size=1, max_size=5), *[COORDINATE] * 4, st.floats(0.01, 0.5))
def test_what_is_near_decides_whether_a_way_is_free(rectangles, x, y, u, v, keep):
    solid, reach = from_rectangles(rectangles).arrays, math.hypot(u, v) + 2 * keep
    close = near(solid, 0, x, y, reach)
    kept = [rectangle for rectangle in rectangles if distance_to_rectangle((x, y), rectangle) <= reach]
    assert close[0].shape == (2, 1, len(kept))
    if kept:
        for own, expected in zip(close, from_rectangles(kept).arrays, strict=True):
            np.testing.assert_array_equal(own, expected)
    assert is_free(close, 0, x, y, u, v, keep) == is_free(solid, 0, x, y, u, v, keep)


@given(st.lists(RECTANGLE, min_size=1, max_size=3), *[COORDINATE] * 4)
def test_free_share_ends_at_the_first_rectangle(rectangles, x0, y0, x1, y1):
    start, end = np.array([[[x0, y0]]]), np.array([[[x1, y1]]])
    solid = from_rectangles(rectangles)
    share = solid.free_share(start, end, 0.1)[0, 0]
    if share == np.inf:
        assert solid.free_run(start, end, 0.1)[0, 0]
        return
    grown = from_rectangles([(x, y, a + 0.1, b + 0.1, yaw) for x, y, a, b, yaw in rectangles])
    assert grown.distance(start + share * (end - start))[0, 0] == pytest.approx(0, abs=1e-9)
    if share > 0:
        assert solid.free_run(start, start + share * (1 - 1e-9) * (end - start), 0.1)[0, 0]


@settings(max_examples=300)
@given(st.lists(RECTANGLE, min_size=1, max_size=3), *[COORDINATE] * 4, st.floats(0, 0.5))
def test_free_run_agrees_with_dense_sampling(rectangles, x0, y0, x1, y1, inflate):
    start, end = np.array([[[x0, y0]]]), np.array([[[x1, y1]]])
    free = from_rectangles(rectangles).free_run(start, end, inflate)[0, 0]
    share = np.linspace(0, 1, 801)[:, None]
    way = start[0] + share * (end - start)[0]
    grown = from_rectangles([(x, y, a + inflate, b + inflate, yaw) for x, y, a, b, yaw in rectangles])
    gap = grown.distance(way[None]).min()
    shrunk = from_rectangles([(x, y, a + inflate - 0.02, b + inflate - 0.02, yaw) for x, y, a, b, yaw in rectangles])
    if free:
        assert shrunk.distance(way[None]).min() > 0
    else:
        assert gap <= np.linalg.norm(end - start) / 800


@pytest.mark.parametrize("target", [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)])
def test_free_run_along_and_on_an_edge(target):
    square = from_rectangles([(0.0, 0.0, 1.0, 1.0, 0.0)])
    side = np.array(target)[::-1] / 2
    for offset, free in [(0.999, False), (1.001, True)]:
        start = offset * side - np.array(target)
        assert square.free_run(start[None, None], (start + 2 * np.array(target))[None, None], 0.0)[0, 0] == free


def test_standing_still_is_free_outside_and_not_inside():
    square = from_rectangles([(0.0, 0.0, 1.0, 1.0, 0.3)])
    points = np.array([[[0.0, 0.0], [0.5, 0.5], [1.6, 0.0], [9.0, 9.0]]])
    assert square.free_run(points, points, 0.1)[0].tolist() == [False, False, True, True]


@pytest.mark.parametrize("name", layout_names())
def test_footprints_of_a_layout_are_its_bricks_and_walls(name):
    layout = load_layout(name)
    solid = footprints([build(preset("classic"), layout)], 0.0, PERSON_HEIGHT_M)
    rectangles = []
    for obstacle in layout.obstacles:
        turn = complex(math.cos(obstacle.yaw), math.sin(obstacle.yaw))
        for brick in obstacle.bricks:
            if brick.at[2] - brick.size[2] / 2 < PERSON_HEIGHT_M:
                centre = complex(*obstacle.position) + turn * complex(*brick.at[:2])
                rectangles.append((centre.real, centre.imag, brick.size[0] / 2, brick.size[1] / 2, obstacle.yaw))
    size = np.array(layout.room.size[:2])
    points = np.random.default_rng(0).uniform(0, size, (400, 2))
    to_walls = np.minimum(points, size - points).min(-1)
    expected = [
        min(wall, *(distance_to_rectangle(point, rectangle) for rectangle in rectangles))
        for point, wall in zip(points, to_walls, strict=True)
    ]
    np.testing.assert_allclose(solid.distance(points[None])[0], expected, atol=1e-9)


def test_some_cells_have_their_own_or_what_all_share():
    parts = [from_rectangles([(x, 0.0, 1.0, 1.0, 0.0)]) for x in (0.0, 3.0)]
    both = Footprints(*(np.concatenate([getattr(p, name) for p in parts], 1) for name in ("centre", "half", "axis")))
    points = np.array([[[3.0, 2.0]]])
    assert both.of(np.array([0])).distance(points)[0, 0] == pytest.approx(math.hypot(2, 1))
    assert both.of(np.array([1])).distance(points)[0, 0] == pytest.approx(1)
    assert parts[0].of(np.array([5])) is parts[0]
