import numpy as np
import pytest

from mjris.config import Config, World
from mjris.simulator import Simulator
from mjris.streams import first_cells
from mjris.world.jitter import jittered
from mjris.world.layout import layout_names, load_layout
from mjris.world.layout_checks import check_layout

DISTANCE_M = 0.3


def moves(before, after) -> np.ndarray:
    """How far every obstacle was moved [m]."""
    pairs = zip(before.obstacles, after.obstacles, strict=True)
    return np.array([np.subtract(b.position, a.position) for a, b in pairs])


@pytest.mark.parametrize("name", layout_names())
def test_obstacles_move_within_the_distance_and_the_layout_stays_valid(name):
    layout = load_layout(name)
    rng = np.random.default_rng(3)
    moved = jittered(layout, DISTANCE_M, rng)
    check_layout(moved)
    far = np.linalg.norm(moves(layout, moved), axis=-1)
    assert (far <= DISTANCE_M + 1e-12).all()
    assert (far > 0).mean() > 0.3
    assert (moved.room, moved.ap, moved.start) == (layout.room, layout.ap, layout.start)
    for before, after in zip(layout.obstacles, moved.obstacles, strict=True):
        assert (before.name, before.yaw, before.bricks) == (after.name, after.yaw, after.bricks)


def test_the_generator_decides():
    layout = load_layout("open")
    first, again, other = (jittered(layout, DISTANCE_M, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other


def test_distance_zero_moves_nothing():
    layout = load_layout("open")
    np.testing.assert_allclose(moves(layout, jittered(layout, 0.0, np.random.default_rng(0))), 0, atol=1e-15)


def test_cells_differ_and_follow_from_their_numbers():
    config = Config(world=World(layout="open", layout_jitter_m=DISTANCE_M, drive="kinematic"))
    world = Simulator(config, cells=3).world
    layouts = [world.office(e).layout for e in range(3)]
    assert layouts[0] != layouts[1] != layouts[2] != layouts[0]
    assert Simulator(config, [first_cells(config, 3)[2]]).world.office(0).layout == layouts[2]


def test_jittered_cells_see_their_own_furniture():
    config = Config(world=World(layout="open", layout_jitter_m=DISTANCE_M, drive="kinematic"))
    together = Simulator(config, cells=3).scene.blockers
    alone = np.concatenate([Simulator(config, [first_cells(config, 3)[e]]).scene.blockers for e in range(3)])
    np.testing.assert_array_equal(together, alone)
