import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import Config, World
from mjris.simulation.simulator import Simulator
from mjris.world.layout import load_layout
from mjris.world.office import PERSON_RADIUS_M
from mjris.world.people import segment_distance
from mjris.world.world import World as Cells

COORDINATE = st.floats(-3, 3)
POINT = st.tuples(COORDINATE, COORDINATE)


def cells(num_cells: int, **world) -> tuple[Cells, list[np.random.Generator]]:
    """Freshly placed cells and their generators."""
    config = Config(world=World(drive="kinematic", **world))
    generators = [np.random.default_rng(seed) for seed in range(num_cells)]
    made = Cells(config, load_layout(config.world.layout), generators)
    made.place(np.arange(num_cells), generators)
    return made, generators


def rayleigh_steps(made: Cells, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    shape = (made.num_cells, made.config.num_users)
    return rng.rayleigh(made.config.walk_scale_m, shape), rng.uniform(0, 2 * math.pi, shape)


def gap_to_bricks(layout, points) -> np.ndarray:
    """Distance from points [..., 2] to walls and to bricks below a person's head [m], from the layout alone."""
    gap = np.minimum(points, np.array(layout.room.size[:2]) - points).min(-1)
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        local = (points - np.array(obstacle.position)) @ np.array([[c, -s], [s, c]])
        for brick in obstacle.bricks:
            if brick.at[2] - brick.size[2] / 2 < 1.75:
                beyond = np.abs(local - brick.at[:2]) - np.array(brick.size[:2]) / 2
                gap = np.minimum(gap, np.linalg.norm(np.maximum(beyond, 0), axis=-1))
    return gap


@pytest.mark.parametrize(("layout", "num_users"), [("office", 4), ("office", 12), ("clinic", 12), ("open", 12)])
def test_clearances_are_kept_in_every_tick(layout, num_users):
    made, generators = cells(16, layout=layout, num_users=num_users, walk_scale_m=0.6)
    clearance, rng = made.config.clearance_m, generators[0]
    far_apart = 10 * np.eye(num_users)
    ticks = []

    def check() -> None:
        people = made.crowd.xy
        apart = np.linalg.norm(people[:, :, None] - people[:, None], axis=-1) + far_apart
        ticks.append(
            (
                gap_to_bricks(made.office(0).layout, people).min() - PERSON_RADIUS_M,
                apart.min() - 2 * PERSON_RADIUS_M,
                np.linalg.norm(people - made.fleet.xy[:, None], axis=-1).min() - PERSON_RADIUS_M - made.hull_radius_m,
            )
        )

    check()
    made.on_tick = check
    for _ in range(50):
        before = made.crowd.xy
        motion = made.move(np.zeros((16, 2)), *rayleigh_steps(made, rng))
        assert (made.crowd.xy != before).any()
        assert (motion.collisions == 0).all()
        assert (motion.clearance_m >= clearance - 1e-9).all()
    assert np.min(ticks) >= clearance - 1e-9
    assert np.min(ticks) < clearance + 0.05  # somebody tried


def test_nobody_steps_toward_a_rover_that_has_come_close():
    made, _ = cells(16, layout="open", num_users=4)
    limit = PERSON_RADIUS_M + made.hull_radius_m + made.config.clearance_m
    near = 0
    for _ in range(60):
        to_rover = made.fleet.xy[:, None] - made.crowd.xy
        nearest = np.argmin(np.linalg.norm(to_rover, axis=-1), 1)
        chase = -to_rover[np.arange(16), nearest]
        chase *= 0.5 / np.linalg.norm(chase, axis=-1, keepdims=True)
        gap = np.linalg.norm(to_rover, axis=-1)
        toward = np.arctan2(to_rover[..., 1], to_rover[..., 0])
        made.move(chase, np.full((16, 4), 0.3), toward)
        now = np.linalg.norm(made.fleet.xy[:, None] - made.crowd.xy, axis=-1)
        held = gap < limit
        near += held.sum()
        assert (made.clearance() > 0).all()
        assert (now >= PERSON_RADIUS_M + made.hull_radius_m + made.config.bumper_m - 1e-6).all()
    assert near > 100


def test_a_long_step_does_not_lead_through_the_rover():
    slow = {"ticks_per_slot": 1, "max_speed_mps": 0.3, "bumper_m": 0.35, "clearance_m": 0.35}
    made, _ = cells(1, layout="open", num_users=4, **slow)
    limit = PERSON_RADIUS_M + made.hull_radius_m + 0.35
    # One through the rover, one past it, one away from it and one up to it, 2.4 m each.
    offset = np.array([[-1.2, 0.0], [-1.2, limit + 0.01], [0.0, -limit + 0.1], [3.4, 0.0]])
    direction = np.array([[0.0, 0.0, -math.pi / 2, math.pi]])
    made.crowd.place(np.array([0]), made.fleet.xy[:, None] + offset)
    start = made.crowd.xy[0]
    aside = np.array([[1.0, 8.0], [1.0, 6.0], [14.0, 8.0], [14.0, 6.0]])
    # One after the other, so that nobody is in anybody's way.
    for k, walks in enumerate([False, True, True, True]):
        distance = np.where(np.arange(4) == k, 2.4, 0.0)[None]
        others = np.arange(4) != k
        made.crowd.place(np.array([0]), np.where(others[:, None], aside, start)[None])
        before = made.crowd.xy[0, k]
        made.move(np.zeros((1, 2)), distance, direction)
        assert np.linalg.norm(made.crowd.xy[0, k] - before) == pytest.approx(2.4 if walks else 0.0)


def test_mean_walk_is_rayleigh(tmp_path):
    path = tmp_path / "hall.toml"
    path.write_text(
        "room.size = [100, 100, 3]\nap.position = [50, 50, 2.6]\nap.facing_deg = 0\nrover.start = [50, 50]\n"
    )
    config = Config(world=World(layout=str(path), drive="kinematic", walk_scale_m=0.3))
    simulator = Simulator(config, cells=64)
    phases, powers = np.zeros((64, 16)), np.full((64, 4), 0.025)
    steps = []
    for _ in range(30):
        before = simulator.scene.users_xy
        steps.append(simulator.step(np.zeros((64, 2)), phases, powers).scene.users_xy - before)
    steps = np.concatenate(steps).reshape(-1, 2)
    length = np.linalg.norm(steps, axis=-1)
    error = 0.3 * math.sqrt(2 - math.pi / 2) / math.sqrt(len(length))
    assert length.mean() == pytest.approx(0.3 * math.sqrt(math.pi / 2), abs=4 * error)
    assert (length**2).mean() == pytest.approx(2 * 0.3**2, rel=0.05)
    np.testing.assert_allclose(steps.mean(0), 0, atol=4 * 0.3 / math.sqrt(len(length)))


@given(POINT, POINT, POINT, POINT)
def test_segment_distance_against_brute_force(start0, step0, start1, step1):
    start, step = np.array([start0, start1]), np.array([step0, step1])
    share = np.linspace(0, 1, 161)
    ways = start[:, None] + share[:, None] * step[:, None]
    brute = np.linalg.norm(ways[0][:, None] - ways[1][None], axis=-1).min()
    slack = (np.linalg.norm(step0) + np.linalg.norm(step1)) / 160
    exact = segment_distance(start[0], step[0], start[1], step[1])
    assert brute - slack - 1e-6 <= exact <= brute + 1e-6
    assert segment_distance(start[1], step[1], start[0], step[0]) == pytest.approx(exact, abs=1e-6)


def test_segment_distance_of_parallel_ways_and_of_points():
    start = np.array([[0.0, 0.0], [0.0, 1.0], [5.0, 0.0], [2.0, 3.0]])
    step = np.array([[2.0, 0.0], [2.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    expected = [[0, 1, 3, 3], [1, 0, math.hypot(3, 1), 2], [3, math.hypot(3, 1), 0, math.hypot(3, 3)]]
    found = [[segment_distance(start[i], step[i], start[j], step[j]) for j in range(4)] for i in range(3)]
    np.testing.assert_allclose(found, expected, atol=1e-12)
