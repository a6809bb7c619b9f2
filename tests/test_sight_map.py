import math

import numpy as np
import pytest

from mjris.config import Config
from mjris.config import World as WorldConfig
from mjris.planning.sight_map import Grid, square, write_obstacles
from mjris.planning.terrain import Terrain
from mjris.world.layout import load_layout
from mjris.world.world import World


def world(num_cells: int, **options) -> World:
    config = Config(world=WorldConfig(drive="kinematic", **options))
    generators = [np.random.default_rng(seed) for seed in range(num_cells)]
    made = World(config, load_layout("office"), generators)
    made.place(np.arange(num_cells), generators)
    return made


def seen(made: World, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Obstacles [E, P, K + 1] from places [E, K, 2] and the AP to places [E, P, 2]."""
    sight_map = Terrain(made).sight_map
    squares = np.array([[square(sight_map.grid, *place) for place in own] for own in high])
    return np.take_along_axis(sight_map.seen(low).rows / 10, squares[:, None], 2).swapaxes(1, 2)


@pytest.mark.parametrize("options", [{}, {"layout_jitter_m": 0.3}, {"body_blockage": True}])
def test_squares_are_seen_as_rays_see_their_middles(options):
    made = world(3, **options)
    rng = np.random.default_rng(1)
    low, high = rng.integers(1, (30, 40), (2, 3, 50, 2)) * 0.5
    anywhere = rng.uniform(-0.249, 0.249, (2, 3, 50, 2))  # in the same squares
    found = seen(made, low + anywhere[0], high + anywhere[1])
    bare = world(3, **(options | {"body_blockage": False})).sight
    start, end = np.insert(low, 2, made.config.user_height_m, -1), np.insert(high, 2, made.config.panel_height_m, -1)
    for k in range(0, 50, 7):
        expected = bare.blockers(np.broadcast_to(start[:, k, None], end.shape), end)
        np.testing.assert_array_equal(found[:, :, k], expected)
    ap = np.stack([made.office(e).ap_position for e in range(3)])
    np.testing.assert_array_equal(found[..., -1], bare.blockers(np.broadcast_to(ap[:, None], end.shape), end))
    assert {0, 1, 2} <= set(found.ravel().tolist())


def test_cells_with_furniture_of_their_own_have_maps_of_their_own():
    made = world(2, layout_jitter_m=0.4)
    places = np.random.default_rng(2).uniform(0, (15, 20), (400, 2))
    both = seen(made, np.tile(places[:100], (2, 1, 1)), np.tile(places, (2, 1, 1)))
    assert (both[0] != both[1]).mean() > 0.005


def test_places_outside_belong_to_the_nearest_square():
    made = world(1)
    outside, inside = np.array([[[-3.0, 25.0]]]), np.array([[[0.1, 19.9]]])
    low = np.array([[[7.0, 7.0]]])
    np.testing.assert_array_equal(seen(made, low, outside), seen(made, low, inside))


def test_every_number_has_a_square():
    grid, numbers = Grid(0.5, 0.0, 5, 7), [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0]
    column = [0, 4, 0, 4, 0, 0]
    row = [0, 6, 0, 6, 0, 0]
    for x, c in zip(numbers, column, strict=True):
        assert [square(grid, x, y) for y in numbers] == [7 * c + r for r in row]
    # 1.24 and 1.26 m are on either side of the border between the second square, at 1 m, and the third.
    assert [square(grid, 1.24, y) for y in (-0.24, 0.26, 2.74, 2.76, 9.0)] == [7, 8, 12, 13, 13]
    assert square(grid, 1.26, 0.0) == 14


def test_many_obstacles_are_counted_one_by_one(monkeypatch):
    made = Terrain(world(1))
    monkeypatch.setattr(made.sight_map._sight, "blockers", lambda _, end, **__: np.full(end.shape[:2], 255))
    assert (made.sight_map.seen(np.array([[[7.0, 7.0]]])).rows[0, 0] == 2550).all()


def test_only_what_is_asked_for_is_cast_and_once(monkeypatch):
    made, casts = Terrain(world(2, layout_jitter_m=0.2)), []
    sight = made.sight_map._sight
    counted = sight.blockers
    monkeypatch.setattr(
        sight, "blockers", lambda start, *rest, **ids: casts.append(start) or counted(start, *rest, **ids)
    )
    places = np.random.default_rng(3).uniform(0, (15, 20), (2, 40, 2))
    first = made.sight_map.seen(places).rows
    squares = {(e, square(made.sight_map.grid, *place)) for e in range(2) for place in places[e]}
    assert len(casts) == len(squares)
    np.testing.assert_array_equal(made.sight_map.seen(places).rows, first)
    assert len(casts) == len(squares)


def test_on_a_large_floor_links_of_users_are_cast_from_place_to_place(monkeypatch):
    monkeypatch.setattr("mjris.planning.sight_map._MOST_SQUARES", 100)
    offices, rng = world(2, layout_jitter_m=0.2), np.random.default_rng(5)
    low, high = rng.uniform(0.3, (14.7, 19.7), (2, 3, 2)), rng.uniform(0.3, (14.7, 19.7), (2, 40, 2))
    found = Terrain(offices).sight_map.seen(low)
    assert found.rows.shape[1] == 1
    for e in range(2):
        x, y = high[e].T.copy()
        for k in range(3):
            behind, start = np.empty(40), np.array([*low[e, k], offices.config.user_height_m])
            write_obstacles(found, e, k, x, y, behind)
            end = np.insert(high[e], 2, offices.config.panel_height_m, 1)[None]
            start = np.broadcast_to(start, end.shape)
            np.testing.assert_array_equal(behind, offices.sight.blockers(start, end, ids=np.array([e]))[0])
        table, of_ap = np.empty(40), np.empty(40)
        write_obstacles(found, e, 3, x, y, of_ap)
        monkeypatch.setattr("mjris.planning.sight_map._MOST_SQUARES", 4000)
        write_obstacles(Terrain(offices).sight_map.seen(low), e, 3, x, y, table)
        np.testing.assert_array_equal(of_ap, table)
