import heapq
import itertools
import math

import numpy as np
import pytest

from mjris.config import Config, ConfigError
from mjris.config import World as WorldConfig
from mjris.planning.paths import Paths
from mjris.planning.terrain import Terrain
from mjris.planning.wayfinding import last_nodes
from mjris.world.footprints import Footprints
from mjris.world.layout import layout_names, load_layout
from mjris.world.world import World

WALLS = [(-0.1, 3, 0.1, 3), (8.1, 3, 0.1, 3), (4, -0.1, 4, 0.1), (4, 6.1, 4, 0.1)]
PARTITION = (4.2, 2, 0.1, 2)
KEEP_M = 0.4


def solid(*offices: list[tuple[float, float, float, float]]) -> Footprints:
    """Upright rectangles (x, y, half width, half depth) in each office of 8 m × 6 m."""
    x, y, a, b = np.moveaxis(np.array(offices, float), -1, 0)
    return Footprints(np.stack([x, y]), np.stack([a, b]), np.stack([np.ones_like(x), np.zeros_like(x)]))


def paths(*offices: list[tuple[float, float, float, float]]) -> Paths:
    return Paths(solid(*offices), (8, 6), np.array([1.0, 1.0]), KEEP_M)


def dijkstra(made: Paths, source: int) -> np.ndarray:
    """Distances from one node by Dijkstra's algorithm, over edges found by sampling every 5 mm."""
    reach = np.linalg.norm(made.nodes[:, None] - made.nodes, axis=-1)

    def free(a: int, b: int) -> bool:
        way = np.linspace(made.nodes[a], made.nodes[b], 240)
        centre, half, axis = made.graph.solid
        return Footprints(centre, half + made.keep_m + 0.01 - 1e-9, axis).distance(way[None]).min() > 0

    best = np.full(len(made.nodes), np.inf)
    queue = [(0.0, source)]
    while queue:
        so_far, node = heapq.heappop(queue)
        if so_far >= best[node]:
            continue
        best[node] = so_far
        for other in map(int, np.flatnonzero((reach[node] < 0.5 * math.sqrt(5) + 1e-9) & (reach[node] > 0))):
            if best[other] > so_far + reach[node, other] and free(node, other):
                heapq.heappush(queue, (so_far + float(reach[node, other]), other))
    return best


def test_distances_are_those_of_dijkstra():
    made = paths([*WALLS, PARTITION])
    for source in (0, len(made.nodes) // 2, len(made.nodes) - 1):
        np.testing.assert_allclose(made.distances[0, source], dijkstra(made, source), rtol=1e-5)


def test_in_an_empty_room_ways_are_straight():
    made = paths(WALLS)
    straight = np.linalg.norm(made.nodes[:, None] - made.nodes, axis=-1)
    assert (made.distances[0] >= straight - 1e-4).all()
    assert (made.distances[0] <= 1.0275 * straight + 1e-4).all()
    start, goal = np.array([[0.51, 0.77]]), np.array([[7.13, 5.21]])
    assert made.distance(start, goal)[0] == pytest.approx(math.hypot(6.62, 4.44))
    np.testing.assert_array_equal(made.toward(start, goal), goal)


def test_around_a_partition():
    made = paths([*WALLS, PARTITION])
    start, goal = np.array([[3.5, 1.0]]), np.array([[5.0, 1.0]])
    # Past the partition's end, grown by what is to be kept.
    corners = [(3.7, 4.4), (4.7, 4.4)]
    shortest = math.dist(start[0], corners[0]) + 1 + math.dist(corners[1], goal[0])
    assert shortest <= made.distance(start, goal)[0] <= 1.1 * shortest
    assert made.distance(start, goal) == pytest.approx(made.distance(goal, start), rel=1e-5)
    place, travelled = start, 0.0
    for _ in range(6):
        target = made.toward(place, goal)
        assert Footprints(*made.graph.solid).free_run(place[:, None], target[:, None], KEEP_M).all()
        travelled += float(np.linalg.norm(target - place))
        place = target
    np.testing.assert_allclose(place, goal)
    assert shortest <= travelled <= made.distance(start, goal)[0] + 1e-6


def test_distance_to_nodes_agrees_with_distance():
    made = paths([*WALLS, PARTITION])
    start = np.array([[3.4, 0.6], [6.3, 4.7]])
    to_nodes = made.distance_to_nodes(start)
    for node in range(0, len(made.nodes), 7):
        single = made.distance(start, made.nodes[[node, node]])
        assert (single <= to_nodes[:, node] + 1e-6).all()
        np.testing.assert_allclose(to_nodes[:, node], single, rtol=0.04, atol=0.05)


def test_bad_goals_are_moved_to_the_nearest_node():
    made = paths([*WALLS, PARTITION])
    start, goal = np.array([[1.0, 1.0]]), np.array([[0.1, 2.1]])
    np.testing.assert_array_equal(made.toward(start, goal), [[0.5, 2.0]])
    start, goal = np.array([[3.5, 1.4]]), np.array([[3.95, 1.0]])
    assert made.distance(start, goal)[0] == pytest.approx(0.4)


def test_pockets_that_cannot_be_reached_have_no_nodes():
    made = paths([*WALLS, (5, 3, 0.1, 3)])
    assert made.nodes[:, 0].max() < 5
    assert made.toward(np.array([[1.0, 1.0]]), np.array([[7.0, 1.0]]))[0, 0] < 5


def test_every_office_has_ways_of_its_own():
    offices = [[*WALLS, PARTITION], [*WALLS, (4.2, 4, 0.1, 2)]]
    both, alone = paths(*offices), [paths(office) for office in offices]
    start, goal = np.tile([[3.0, 0.9]], (2, 1)), np.tile([[5.6, 1.1]], (2, 1))
    expected = [each.distance(start[:1], goal[:1])[0] for each in alone]
    np.testing.assert_allclose(both.distance(start, goal), expected)
    assert expected[1] < 3 < expected[0]
    aim = [each.toward(start[:1], goal[:1])[0] for each in alone]
    np.testing.assert_allclose(both.toward(start, goal), aim)
    for e, each in enumerate(alone):
        np.testing.assert_allclose(both.nodes[both.reachable[e]], each.nodes)
        assert np.isinf(both.distance_to_nodes(start)[e, ~both.reachable[e]]).all()


def test_no_floor_left():
    with pytest.raises(ConfigError, match="keep_m"):
        Paths(solid(WALLS), (8, 6), np.array([1.0, 1.0]), 3.5)


def driven(
    name: str, drive: str, cells: int, tight: bool, jitter: float = 0.0
) -> tuple[World, Paths, np.ndarray, np.ndarray]:
    """A world without people in the way, the ways in it, and random free places and goals [E, 2]."""
    config = Config(world=WorldConfig(drive=drive, layout_jitter_m=jitter))  # pyright: ignore[reportArgumentType]
    rng = np.random.default_rng(7)
    made = World(config, load_layout(name), [np.random.default_rng([7, e]) for e in range(cells)])
    outside = np.tile(-5.0 - np.arange(made.config.num_users)[:, None], (cells, 1, 2))
    made.crowd.place(np.arange(cells), outside)
    size = np.array(made.office(0).layout.room.size[:2])
    least = made.hull_radius_m + made.config.bumper_m
    places, ways = np.zeros((2, cells, 2)), Terrain(made).paths
    for cell in range(cells):
        nodes = ways.nodes[ways.reachable[cell % len(made.offices)]]
        tried = rng.uniform(0, size, (1500, 2))
        room = made.hull_solid.of(np.array([cell])).distance(tried[None])[0]
        near = np.linalg.norm(tried[:, None] - nodes, axis=-1).min(1) < 0.6
        starts = tried[(room >= least) & (room < (least + 0.01 if tight else np.inf)) & near]
        places[:, cell] = starts[0], tried[(room >= least) & near][-1]
    made.fleet.place(np.arange(cells), places[0], rng.uniform(-math.pi, math.pi, cells))
    return made, ways, places[0], places[1]


@pytest.mark.parametrize("tight", [False, True])
@pytest.mark.parametrize("name", layout_names())
def test_rovers_arrive_from_anywhere(name, tight):
    assert_arrives(*driven(name, "kinematic", 10, tight))


def test_rovers_on_wheels_arrive():
    assert_arrives(*driven("office", "wheels", 6, True))


def test_rovers_arrive_in_furniture_of_their_own():
    assert_arrives(*driven("clinic", "kinematic", 2, True, jitter=0.4))


def assert_arrives(made: World, ways: Paths, start: np.ndarray, goal: np.ndarray) -> None:
    """Every rover reaches its goal in time and bumps into nothing."""
    still = np.zeros((made.num_cells, made.config.num_users))
    reach = made.config.max_speed_mps * made.config.slot_s
    goal = np.array([last_nodes(ways.graph, e % len(ways.distances), *place)[:2] for e, place in enumerate(goal)])
    budget = 1.3 * ways.distance(start, goal) / reach + 4
    left = np.linalg.norm(goal - start, axis=-1)
    for slot in range(1, 1 + math.ceil(budget.max())):
        here = made.fleet.xy
        move = ways.toward(here, goal) - here
        move *= np.minimum(1, reach / np.maximum(np.linalg.norm(move, axis=-1, keepdims=True), 1e-9))
        assert (made.move(move, still, still).collisions == 0).all()
        left = np.linalg.norm(goal - made.fleet.xy, axis=-1)
        assert (left[slot > budget] < 0.1).all()
    assert (left < 0.1).all()


def test_a_large_room_has_no_table_and_the_same_ways(monkeypatch):
    offices = [[*WALLS, PARTITION], [*WALLS, (2.5, 4, 0.1, 2)]]
    tabled = paths(*offices)
    monkeypatch.setattr("mjris.planning.paths._MOST_NODES", 48)
    large = paths(*offices)
    assert large.distances.shape == (2, 0, 0)
    np.testing.assert_array_equal(large.nodes, tabled.nodes)
    rng = np.random.default_rng(2)
    start, goal = rng.uniform(-0.2, (8.2, 6.2), (2, 200, 2))
    length = tabled.distance(start, goal)
    np.testing.assert_allclose(large.distance(start, goal), length, rtol=1e-5)
    to_nodes = tabled.distance_to_nodes(start)
    np.testing.assert_allclose(large.distance_to_nodes(start), to_nodes, rtol=1e-5)
    within = to_nodes < 4
    bounded = large.distance_to_nodes(start, 4.0)
    np.testing.assert_allclose(bounded[within], to_nodes[within], rtol=1e-5)
    assert (bounded[~within] > 4 - 1e-4).all()
    # Of ways that are equally long either may be taken, and both get nearer by as much as is driven.
    there = large.toward(start, goal)
    driven = np.linalg.norm(there - start, axis=-1)
    np.testing.assert_allclose(driven + large.distance(there, goal), length, atol=0.3)


def test_a_building_of_many_rooms_is_driven_through_on_a_half_metre_grid(tmp_path):
    """36 rooms of 5 m × 5 m with doors 1.5 m wide, from corner to corner; walls meet at joints."""
    walls = []
    for i, j in itertools.product(range(6), range(6)):
        walls += [f"{{ from = [{5 * i}, {5 * j}], to = [{5 * i}, {5 * j + 3.5}] }}"] if i else []
        walls += [f"{{ from = [{5 * i}, {5 * j}], to = [{5 * i + 3.5}, {5 * j}] }}"] if j else []
    path = tmp_path / "building.toml"
    path.write_text(
        f"room.size = [30, 30, 3]\nap.position = [15.5, 29.8, 2.6]\nap.facing_deg = 270\nrover.start = [2.5, 2.5]\n"
        f"wall = [{', '.join(walls)}]\n"
    )
    config = Config(world=WorldConfig(drive="kinematic"))
    made = World(config, load_layout(str(path)), [np.random.default_rng(0)])
    made.crowd.place(np.arange(1), np.full((1, 4, 2), -5.0))
    ways = Terrain(made).paths
    assert len(ways.nodes) > 2500
    assert ways.distances.size == 0
    made.fleet.place(np.arange(1), np.array([[2.5, 2.5]]), np.zeros(1))
    assert_arrives(made, ways, np.array([[2.5, 2.5]]), np.array([[27.6, 27.4]]))


def test_values_along_a_straight_way():
    made = paths(WALLS)
    start = np.array([[1.0, 2.0], [1.2, 2.0]])
    x = made.nodes[:, 0]
    length = made.distance_to_nodes(start)
    integral = made.along(length, start[:, 0], np.stack([x, x]), np.inf)
    row = (made.nodes[:, 1] == 2.0) & (x > 2)
    for e in (0, 1):
        np.testing.assert_allclose(length[e, row], x[row] - start[e, 0], rtol=1e-5)
        np.testing.assert_allclose(integral[e, row], (x[row] ** 2 - start[e, 0] ** 2) / 2, rtol=1e-5)


def test_values_along_ways_around_furniture():
    made = paths([*WALLS, PARTITION])
    start, present = np.array([[3.4, 0.6], [6.3, 4.7]]), np.array([0.3, 0.9])
    values = np.random.default_rng(0).uniform(0, 1, (2, len(made.nodes)))
    length = made.distance_to_nodes(start)
    integral = made.along(length, present, values, np.inf)
    reach = np.linalg.norm(made.nodes[:, None] - made.nodes, axis=-1)
    rooted = 0
    for e in (0, 1):
        for node in range(len(made.nodes)):
            # Ways of equal length may have different integrals: one of them must agree.
            steps = np.where(np.isfinite(made.graph.edge_m[0, node]), made.graph.neighbours[node], node)
            via = [other for other in steps if other != node]
            on_way = [other for other in via if abs(length[e, other] + reach[other, node] - length[e, node]) < 1e-4]
            sums = [integral[e, b] + reach[b, node] * (values[e, b] + values[e, node]) / 2 for b in on_way]
            straight = float(np.linalg.norm(made.nodes[node] - start[e]))
            if not sums or abs(straight - length[e, node]) < 1e-4:
                rooted += 1
                sums.append(straight * (present[e] + values[e, node]) / 2)
            assert np.min(np.abs(np.array(sums) - integral[e, node])) < 1e-4
    assert 0 < rooted < len(made.nodes)
