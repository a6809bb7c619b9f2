import math

import numpy as np
import pytest

from mjris.planning.paths import Paths
from mjris.planning.wayfinding import first_nodes, last_nodes, next_node, shortest
from mjris.world.footprints import Footprints

KEEP_M = 0.4
WALLS = [(-0.1, 3, 0.1, 3), (8.1, 3, 0.1, 3), (4, -0.1, 4, 0.1), (4, 6.1, 4, 0.1)]
PARTITION = (4.2, 2, 0.1, 2)


def paths(*rectangles: tuple[float, float, float, float]) -> Paths:
    """A room of 8 m × 6 m with upright rectangles (x, y, half width, half depth)."""
    x, y, a, b = np.array([*WALLS, *rectangles], float).T
    solid = Footprints(*(np.array(pair)[:, None] for pair in ((x, y), (a, b), (np.ones_like(x), np.zeros_like(x)))))
    return Paths(solid, (8, 6), np.array([1.0, 1.0]), KEEP_M)


def test_the_way_over_nodes_is_as_long_as_the_shortest_one():
    graph = paths(PARTITION).graph
    first, first_m = first_nodes(graph, 0, 3.5, 1.0)
    *place, last, last_m = last_nodes(graph, 0, 5.0, 1.0)
    assert place == [5.0, 1.0]
    length, node, end = shortest(graph, 0, first, first_m, last, last_m)
    every = first_m[:, None] + graph.distances[0][np.ix_(first, last)] + last_m
    assert length == pytest.approx(every.min())
    walked = first_m[first == node][0] + last_m[last == end][0]
    while node != end:
        before, node = node, next_node(graph, 0, node, end)
        walked += math.dist(graph.nodes[before], graph.nodes[node])
    assert walked == pytest.approx(length, rel=1e-6)


def test_nodes_are_the_nearest_ones_and_those_out_of_sight_are_left_out():
    graph = paths(PARTITION).graph
    near, away = first_nodes(graph, 0, 3.6, 2.1)
    distance = np.linalg.norm(graph.nodes - (3.6, 2.1), axis=-1)
    np.testing.assert_allclose(distance[near], np.sort(distance)[: graph.tried])
    beyond = graph.nodes[near, 0] > 4.2
    assert np.isinf(away[beyond]).all()
    np.testing.assert_allclose(away[~beyond], distance[near][~beyond])


def test_a_goal_in_nobodys_sight_is_moved_to_the_nearest_node():
    graph = paths(PARTITION).graph
    x, y, near, away = last_nodes(graph, 0, 0.1, 2.1)
    assert (x, y) == (0.5, 2.0)
    assert away[0] == 0
    assert near[0] == np.linalg.norm(graph.nodes - (0.1, 2.1), axis=-1).argmin()


def test_who_stands_too_close_to_something_leaves_away_from_it():
    graph = paths(PARTITION).graph
    near, away = first_nodes(graph, 0, 4.2 - 0.1 - 0.3, 1.3)
    tried = graph.nodes[near[np.isfinite(away)]]
    assert len(tried)
    assert (tried[:, 0] < 3.7).all()


def test_people_are_driven_around():
    made = paths()
    start, target = np.array([[1.0, 3.0]] * 4), np.array([[5.0, 3.0]] * 4)
    people = np.array([[[1.8, 2.9]], [[3.0, 3.0]], [[1.0, 2.5]], [[1.4, 2.6]]])
    aim = made.around(start, target, people, 0.6)
    assert aim[0, 1] > 3
    np.testing.assert_array_equal(aim[1:3], target[1:3])
    assert aim[3, 1] > 3
    way = np.linspace(start[0], aim[0], 100)
    assert np.linalg.norm(way - people[0], axis=-1).min() >= 0.6 - 1e-9
    angle = np.arange(8) * math.pi / 4
    ring = start[0] + 0.7 * np.stack([np.cos(angle), np.sin(angle)], -1)
    np.testing.assert_array_equal(made.around(start[:1], target[:1], ring[None], 0.6), target[:1])


def test_of_equally_good_ways_around_somebody_the_left_one_is_taken():
    for angle in np.linspace(-math.pi, math.pi, 40):
        ahead = np.array([math.cos(angle), math.sin(angle)])
        start = np.array([[4.0, 3.0]])
        aim = paths().around(start, start + 2 * ahead, (start + 0.8 * ahead)[None], 0.6)[0] - start[0]
        assert ahead[0] * aim[1] - ahead[1] * aim[0] > 0.1


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
def test_places_that_no_number_names_neither_crash_nor_hang(bad):
    corner, elsewhere = (0.5, 0.5, 0.6, 0.6), (7.0, 5.0, 0.1, 0.1)
    offices = np.array([[*WALLS, PARTITION, corner], [*WALLS, PARTITION, elsewhere]])
    x, y, a, b = np.moveaxis(offices, -1, 0)
    solid = Footprints(np.stack([x, y]), np.stack([a, b]), np.stack([np.ones_like(x), np.zeros_like(x)]))
    made = Paths(solid, (8, 6), np.array([1.0, 2.0]), KEEP_M)
    assert made.reachable[:, 0].tolist() == [False, True]
    good = np.array([[6.0, 1.0], [6.0, 1.0]])
    for place in (np.array([[bad, 1.0]] * 2), np.array([[1.0, bad]] * 2), np.full((2, 2), bad)):
        for office in (0, 1):
            first, _ = first_nodes(made.graph, office, *place[office])
            _, _, last, _ = last_nodes(made.graph, office, *place[office])
            for near in (first, last):
                assert len(near) == made.graph.tried
                assert ((near >= 0) & (near < len(made.nodes))).all()
        for start, goal in ((place, good), (good, place), (place, place)):
            assert made.toward(start, goal).shape == (2, 2)
            assert made.distance(start, goal).shape == (2,)
        length = made.distance_to_nodes(place)
        integral = made.along(length, np.ones(2), np.ones(length.shape), np.inf)
        assert integral.shape == length.shape == (2, len(made.nodes))
        assert made.around(place, good, good[:, None], 0.6).shape == (2, 2)
