import numpy as np
import pytest

from mjris.config import Config, Radio, World
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId
from mjris.world.fit import check_fit, kept_distance
from mjris.world.jitter import jittered
from mjris.world.layout import layout_names, load_layout
from mjris.world.layout_checks import boxes_of, check_layout, plan_distance

DISTANCE_M = 0.3
CONFIG = Config(world=World(layout_jitter_m=DISTANCE_M))


def moves(before, after) -> np.ndarray:
    """How far every obstacle was moved [m]."""
    pairs = zip(before.obstacles, after.obstacles, strict=True)
    return np.array([np.subtract(b.position, a.position) for a, b in pairs])


@pytest.mark.parametrize("name", layout_names())
def test_obstacles_move_within_the_distance_and_the_layout_stays_valid(name):
    layout = load_layout(name)
    rng = np.random.default_rng(3)
    moved = jittered(layout, CONFIG, rng)
    check_layout(moved)
    far = np.linalg.norm(moves(layout, moved), axis=-1)
    assert (far <= DISTANCE_M + 1e-12).all()
    assert (far > 0).mean() > 0.3
    assert (moved.room, moved.ap, moved.start) == (layout.room, layout.ap, layout.start)
    for before, after in zip(layout.obstacles, moved.obstacles, strict=True):
        assert (before.name, before.yaw, before.bricks) == (after.name, after.yaw, after.bricks)


def test_walls_stay():
    layout = load_layout("clinic")
    walls = np.array([obstacle.name.startswith("wall") for obstacle in layout.obstacles])
    assert 10 < walls.sum() < len(walls)
    far = np.linalg.norm(moves(layout, jittered(layout, CONFIG, np.random.default_rng(0))), axis=-1)
    assert (far[walls] == 0).all()
    assert (far[~walls] > 0).any()


def test_a_wide_panel_keeps_its_room_at_the_start():
    wide = Config(world=World(layout_jitter_m=1.0, start_m=(7.5, 11.1)), radio=Radio(panel_cols=20))
    layout, start = load_layout("open"), np.array([7.5, 11.1])
    for seed in range(4):
        moved = jittered(layout, wide, np.random.default_rng(seed))
        check_fit(wide, moved)
        boxes = boxes_of(moved)
        assert min(plan_distance(start, boxes, b) for b in range(len(boxes.owner))) >= kept_distance(wide)


def test_the_generator_decides():
    layout = load_layout("open")
    first, again, other = (jittered(layout, CONFIG, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other


def test_distance_zero_moves_nothing():
    layout = load_layout("open")
    np.testing.assert_allclose(moves(layout, jittered(layout, Config(), np.random.default_rng(0))), 0, atol=1e-15)


def test_cells_differ_and_follow_from_their_numbers():
    config = Config(world=World(layout="open", layout_jitter_m=DISTANCE_M, drive="kinematic"), seed=0)
    world = Simulator(config, cells=3).world
    layouts = [world.office(e).layout for e in range(3)]
    assert layouts[0] != layouts[1] != layouts[2] != layouts[0]
    assert Simulator(config, [CellId(config.named_seed, 2)]).world.office(0).layout == layouts[2]


def test_jittered_cells_see_their_own_furniture():
    config = Config(world=World(layout="open", layout_jitter_m=DISTANCE_M, drive="kinematic"), seed=0)
    together = Simulator(config, cells=3).scene.blockers
    alone = np.concatenate([Simulator(config, [CellId(config.named_seed, e)]).scene.blockers for e in range(3)])
    np.testing.assert_array_equal(together, alone)
