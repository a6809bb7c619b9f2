# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import itertools
import math

import mujoco
import numpy as np
import pytest

from mjris.config import Config, ConfigError
from mjris.config import World as WorldConfig
from mjris.world.layout import AccessPoint, Brick, Layout, Obstacle, Room, layout_names, load_layout
from mjris.world.layout_checks import check_layout
from mjris.world.office import GROUP_BLOCKERS, PERSON_HEIGHT_M, PERSON_RADIUS_M, build
from mjris.world.sight import Sight
from mjris.world.world import World

GRAZE_M = 1e-6


def world(layout: Layout, num_cells: int = 1, **options) -> World:
    config = Config(world=WorldConfig(drive="kinematic", **options))
    generators = [np.random.default_rng(seed) for seed in range(num_cells)]
    made = World(config, layout, generators)
    made.place(np.arange(num_cells), generators)
    return made


def crossed(layout: Layout, start: np.ndarray, end: np.ndarray, grow_m: float) -> np.ndarray:
    """Obstacles whose bricks, grown by `grow_m`, the segments start–end [L, 3] meet: slab test, counts [L]."""
    count = np.zeros(len(start), int)
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        to_frame = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        origin = (start - [*obstacle.position, 0]) @ to_frame
        direction = (end - start) @ to_frame
        met = np.zeros(len(start), bool)
        for brick in obstacle.bricks:
            half = np.array(brick.size) / 2 + grow_m
            with np.errstate(divide="ignore"):
                sides = np.stack([(side - (origin - brick.at)) / direction for side in (-half, half)])
            enter, leave = sides.min(0).max(-1), sides.max(0).min(-1)
            met |= (enter < leave) & (leave > 0) & (enter < 1)
        count += met
    return count


def assert_counts_agree(layout: Layout, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Compare all links that graze nothing; returns their counts."""
    counted = Sight([build(Config(), layout)]).blockers(start[None], end[None])[0]
    most, least = crossed(layout, start, end, GRAZE_M), crossed(layout, start, end, -GRAZE_M)
    clear_cut = most == least
    assert clear_cut.mean() > 0.99
    np.testing.assert_array_equal(counted[clear_cut], most[clear_cut])
    return counted[clear_cut]


def random_layout(rng: np.random.Generator) -> Layout:
    """A room with obstacles of up to five bricks each, wherever they fit."""
    room = Room(size=(9.0, 7.0, 3.0))
    ap = AccessPoint(position=(4.5, 6.9, 2.9), facing_deg=270.0)
    obstacles: tuple[Obstacle, ...] = ()
    layout = Layout(name="random", room=room, ap=ap, start=(4.5, 3.5), obstacles=())
    while len(obstacles) < 8:
        bricks = tuple(
            Brick(at=(*rng.uniform(-0.5, 0.5, 2), z / 2 + low), size=(*rng.uniform(0.02, 0.6, 2), z), material="wood")
            for z, low in rng.uniform([0.1, 0.0], [1.4, 1.4], (rng.integers(1, 6), 2))
        )
        obstacle = Obstacle(
            name=f"pile_{len(obstacles)}",
            position=tuple(rng.uniform([0, 0], room.size[:2])),
            yaw=rng.uniform(-4, 4),
            bricks=bricks,
        )
        tried = Layout(name="random", room=room, ap=ap, start=layout.start, obstacles=(*obstacles, obstacle))
        try:
            check_layout(tried)
        except ConfigError:
            continue
        obstacles, layout = tried.obstacles, tried
    return layout


@pytest.mark.parametrize("name", layout_names())
def test_random_links_in_the_bundled_layouts(name):
    layout = load_layout(name)
    rng = np.random.default_rng(11)
    start, end = rng.uniform(0, layout.room.size, (2, 6000, 3))
    start[:2000, 2], end[:2000, 2] = 1.1, 1.5
    end[2000:4000] = layout.ap.position
    # Nobody transmits from within furniture. Where two obstacles touch, it might leave one as it enters the other.
    free = crossed(layout, start, start + np.array([0, 0, 1e-9]), 0) == 0
    assert free.sum() > 5000
    counts = assert_counts_agree(layout, start[free], end[free])
    assert {0, 1, 2} <= set(counts)


def cast(model: mujoco.MjModel, start: np.ndarray, end: np.ndarray) -> int:
    """Bodies that block one link, by MuJoCo's rays: from hit to hit, without the body met last."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    groups = (np.arange(mujoco.mjNGROUP) == GROUP_BLOCKERS).astype(np.uint8)
    length = np.linalg.norm(end - start)
    direction, travelled, body, met = (end - start) / length, 0.0, -1, set()
    while True:
        geom = np.full(1, -1, np.int32)
        distance = mujoco.mj_ray(model, data, start + travelled * direction, direction, groups, 1, body, geom)
        if geom[0] < 0 or travelled + distance >= length:
            return len(met)
        travelled, body = travelled + distance + 1e-6, int(model.geom_bodyid[geom[0]])
        met.add(body)


@pytest.mark.parametrize("name", layout_names())
def test_the_same_obstacles_as_by_mujocos_rays(name):
    layout = load_layout(name)
    rng = np.random.default_rng(21)
    made = world(layout)
    start, end = rng.uniform(0, layout.room.size, (2, 400, 3))
    start[:200, 2], end[:200, 2] = 1.1, 1.5
    clear_cut = crossed(layout, start, end, GRAZE_M) == crossed(layout, start, end, -GRAZE_M)
    expected = [cast(made.office(0).model, *link) for link in zip(start[clear_cut], end[clear_cut], strict=True)]
    counted = made.sight.blockers(start[None, clear_cut], end[None, clear_cut])[0]
    assert clear_cut.sum() > 390
    assert max(expected) >= 2
    np.testing.assert_array_equal(counted, expected)


@pytest.mark.parametrize("seed", range(6))
def test_random_links_among_random_obstacles(seed):
    rng = np.random.default_rng(seed)
    layout = random_layout(rng)
    start, end = rng.uniform(0, layout.room.size, (2, 3000, 3))
    counts = assert_counts_agree(layout, start, end)
    assert {0, 1, 2} <= set(counts)


def test_links_that_start_or_end_inside_a_brick_count_its_obstacle():
    layout = random_layout(np.random.default_rng(50))
    rng = np.random.default_rng(51)
    inside = []
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        for brick in obstacle.bricks:
            local = np.array(brick.at) + rng.uniform(-0.49, 0.49, (40, 3)) * brick.size
            inside.append([*obstacle.position, 0] + local @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    inside = np.concatenate(inside)
    outside = rng.uniform(0, layout.room.size, inside.shape)
    assert (assert_counts_agree(layout, inside, outside) >= 1).all()
    assert (assert_counts_agree(layout, outside, inside) >= 1).all()
    assert (assert_counts_agree(layout, inside, np.roll(inside, 200, 0)) >= 1).all()


def floating_boxes(rng: np.random.Generator) -> Layout:
    """Bricks that stand or float apart from each other, turned any way, one an obstacle."""
    obstacles = []
    for index, place in enumerate(itertools.product(np.arange(1.0, 9), np.arange(1.0, 7))):
        brick = Brick(at=(0, 0, rng.uniform(0.5, 2)), size=tuple(rng.uniform(0.05, 0.5, 3)), material="wood")
        obstacles.append(Obstacle(name=f"box{index}", position=place, yaw=rng.uniform(-4, 4), bricks=(brick,)))
    ap = AccessPoint(position=(4.5, 6.9, 2.9), facing_deg=270.0)
    return Layout(name="boxes", room=Room(size=(9, 7, 3)), ap=ap, start=(0.5, 0.5), obstacles=tuple(obstacles))


def grazing_links(layout: Layout, offset_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Links that pass faces and edges of every brick at `offset_m`, outside if that is positive: both ends [L, 3]."""
    ends = []
    for obstacle in layout.obstacles:
        brick = obstacle.bricks[0]
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        to_room = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        half = np.array(brick.size) / 2
        for axis, side, other_side in itertools.product(range(3), (-1, 1), (-1, 1)):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            skim, way, over, across = np.zeros((4, 3))
            # Along a face, from beyond one end of the brick to beyond the other.
            skim[a], skim[b], way[axis] = (
                side * (half[a] + offset_m),
                rng.uniform(-0.9, 0.9) * half[b],
                half[axis] + 0.02,
            )
            # Over an edge, across it.
            over[a], over[b] = side * (half[a] + offset_m), other_side * (half[b] + offset_m)
            over[axis] = rng.uniform(-0.9, 0.9) * half[axis]
            across[a], across[b] = 0.02 * side, -0.02 * other_side
            ends += [
                ([*obstacle.position, 0] + (point + sign * reach + brick.at) @ to_room)
                for point, reach in ((skim, way), (over, across))
                for sign in (-1, 1)
            ]
    pairs = np.reshape(ends, (-1, 2, 3))
    return pairs[:, 0], pairs[:, 1]


@pytest.mark.parametrize("offset_m", [-5e-3, -1e-4, -1e-5, 1e-5, 1e-4, 5e-3])
def test_links_that_graze_faces_and_edges(offset_m):
    rng = np.random.default_rng(60)
    layout = floating_boxes(rng)
    start, end = grazing_links(layout, offset_m, rng)
    counts = assert_counts_agree(layout, start, end)
    assert len(counts) == 48 * 24
    assert (counts == (offset_m < 0)).all()
    np.testing.assert_array_equal(assert_counts_agree(layout, end, start), counts)


@pytest.mark.parametrize("behind_m", [1e-5, 1e-3])
def test_a_film_right_behind_a_face_counts(behind_m):
    block = Brick(at=(0, 0, 1), size=(1, 1, 2), material="wood")
    film = Brick(at=(behind_m + 5e-5 - 0.5, 0, 1), size=(1e-4, 0.5, 1), material="wood")
    obstacles = tuple(
        Obstacle(name=f"solid{index}", position=(5, 2), yaw=0.0, bricks=(brick,))
        for index, brick in enumerate((block, film))
    )
    ap = AccessPoint(position=(5, 3.9, 2.6), facing_deg=270.0)
    layout = Layout(name="film", room=Room(size=(10, 4, 3)), ap=ap, start=(1, 1), obstacles=obstacles)
    start, end = np.array([[3, 2, 1], [7, 2, 1], [3, 2.4, 1]]), np.array([[7, 2, 1], [3, 2, 1], [7, 2.4, 1]])
    assert_counts_agree(layout, start, end)
    counted = Sight([build(Config(), layout)]).blockers(start[None], end[None])[0]
    assert counted.tolist() == [2, 2, 1]


def test_jittered_cells_are_counted_in_layouts_of_their_own():
    made = world(load_layout("open"), num_cells=4, layout_jitter_m=0.3)
    rng = np.random.default_rng(12)
    start, end = rng.uniform(0, made.office(0).layout.room.size, (2, 4, 400, 3))
    counted = made.sight.blockers(start, end)
    expected = [crossed(made.office(e).layout, start[e], end[e], 0) for e in range(4)]
    np.testing.assert_array_equal(counted, expected)
    assert not np.array_equal(crossed(made.office(1).layout, start[0], end[0], 0), expected[0])


def test_touching_and_nested_bricks_of_one_and_of_several_obstacles():
    def box(name: str, x: float, *bricks: tuple[float, float]) -> Obstacle:
        made = tuple(Brick(at=(at, 0, 1), size=(length, 1, 2), material="wood") for at, length in bricks)
        return Obstacle(name=name, position=(x, 2.0), yaw=0.0, bricks=made)

    layout = Layout(
        name="row",
        room=Room(size=(10, 4, 3)),
        ap=AccessPoint(position=(5, 3.9, 2.6), facing_deg=270.0),
        start=(5, 3.4),
        # Two touch at x = 3; the third has a brick either side of the fourth.
        obstacles=(
            box("a", 2.5, (0, 1.0), (0.1, 0.2)),
            box("b", 3.5, (0, 1.0), (0.2, 0.2), (0, 0.1)),
            box("c", 6.5, (-0.75, 0.5), (0.75, 0.5)),
            box("d", 6.5, (0, 0.5)),
        ),
    )
    start = np.array([[0.5, 2, 1], [9.5, 2.1, 1.2], [0.5, 2, 1], [2.5, 2, 1], [6.5, 2, 1], [0.5, 3.5, 1]])
    end = np.array([[9.5, 2, 1], [0.5, 2.1, 1.2], [2.9, 2, 1], [3.6, 2, 1], [9.5, 2, 1], [9.5, 3.5, 1]])
    counted = Sight([build(Config(), layout)]).blockers(start[None], end[None])[0]
    assert counted.tolist() == [4, 4, 1, 2, 2, 0]


def test_cells_and_their_subsets_are_counted_alike():
    layout = load_layout("office")
    rng = np.random.default_rng(4)
    start, end = rng.uniform(0, layout.room.size, (2, 5, 70, 3))
    sight = world(layout, num_cells=5).sight
    together = sight.blockers(start, end)
    for e in range(5):
        np.testing.assert_array_equal(together[e], crossed(layout, start[e], end[e], 0))
    some = np.array([1, 3])
    np.testing.assert_array_equal(sight.blockers(start[some], end[some], ids=some), together[some])


def capsules_crossed(people: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Who is met by each link, by dense sampling: bool [L, K], and whether that is beyond doubt [L]."""
    share = np.linspace(0, 1, 4001)[:, None, None]
    way = start + share * (end - start)  # [S, L, 3]
    low, high = PERSON_RADIUS_M, PERSON_HEIGHT_M - PERSON_RADIUS_M
    rise = way[..., 2] - np.clip(way[..., 2], low, high)
    gaps = []
    for person in people:
        flat = np.linalg.norm(way[..., :2] - person, axis=-1)
        gaps.append(np.hypot(flat, rise).min(0) - PERSON_RADIUS_M)
    gap = np.stack(gaps, -1)
    certain: np.ndarray = np.all(np.abs(gap) > 0.01, axis=-1)
    return gap < 0, certain


def test_people_block_others_but_never_their_own_link():
    made = world(load_layout("open"), num_users=4, body_blockage=True)
    bare = world(load_layout("open"), num_users=4)
    layout, people = made.office(0).layout, made.crowd.xy[0]
    rng = np.random.default_rng(8)
    own = rng.integers(0, 4, 1500)
    start = np.concatenate([people[own], np.full((1500, 1), 1.1)], 1)
    end = rng.uniform([0, 0, 0.2], layout.room.size, (1500, 3))
    other = rng.integers(0, 4, 750)
    end[:750, :2] = people[other] + rng.normal(0, 0.3, (750, 2))  # many toward somebody
    counted = made.sight.blockers(start[None], end[None], own)[0]
    met, certain = capsules_crossed(people, start, end)
    met[np.arange(1500), own] = False
    expected = crossed(layout, start, end, 0) + met.sum(1)
    assert met.any(1).sum() > 120
    np.testing.assert_array_equal(counted[certain], expected[certain])
    without = bare.sight.blockers(start[None], end[None], own)[0]
    np.testing.assert_array_equal(without, crossed(layout, start, end, 0))


def test_the_rover_never_blocks():
    made = world(load_layout("open"), body_blockage=True)
    x, y = made.fleet.xy[0]
    for height in (0.3, 1.0, 1.5):
        start, end = np.array([[[x - 0.5, y, height]]]), np.array([[[x + 0.5, y, height]]])
        assert made.sight.blockers(start, end)[0, 0] == 0
        assert made.sight.blockers((start + end) / 2, end)[0, 0] == 0
