# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from mjris.config import Config
from mjris.config import World as WorldConfig
from mjris.world.drives import StraightDrive, _may_be_stopped
from mjris.world.layout import AccessPoint, Brick, Layout, Obstacle, Room, load_layout
from mjris.world.office import build
from mjris.world.rover import free_travel
from mjris.world.world import World

DRIVES = ["kinematic", "wheels"]
Policy = Callable[[World], np.ndarray]


def world(layout: Layout, num_cells: int, drive: str, seed: int = 0, **options) -> World:
    config = Config(world=WorldConfig(drive=drive, **options))  # pyright: ignore[reportArgumentType]
    generators = [np.random.default_rng([seed, e]) for e in range(num_cells)]
    made = World(config, layout, generators)
    made.place(np.arange(num_cells), generators)
    return made


def empty(*obstacles: Obstacle) -> Layout:
    return Layout(
        name="empty",
        room=Room(size=(14, 14, 3)),
        ap=AccessPoint(position=(7, 13.8, 2.6), facing_deg=270.0),
        start=(7, 7),
        obstacles=obstacles,
    )


def alone(layout: Layout, num_cells: int, drive: str, **options) -> World:
    """A world whose only person stands in a corner."""
    made = world(layout, num_cells, drive, num_users=2, **options)
    made.crowd.place(np.arange(num_cells), np.tile([[0.5, 0.5], [0.5, 1.5]], (num_cells, 1, 1)))
    return made


def slot(made: World, displacement: np.ndarray, rng: np.random.Generator | None = None):
    """Move the rovers, and people too if a generator is given."""
    shape = (made.num_cells, made.config.num_users)
    distance = np.zeros(shape) if rng is None else rng.rayleigh(made.config.walk_scale_m, shape)
    direction = np.zeros(shape) if rng is None else rng.uniform(0, 2 * math.pi, shape)
    return made.move(displacement, distance, direction)


def assert_promises_kept(made: World, policy: Policy, slots: int, rng: np.random.Generator) -> np.ndarray:
    """Drive by a policy and check every promise in every slot; returns all clearances [slots, E]."""
    reach = made.config.max_speed_mps * made.config.slot_s
    low, high = made.hull_radius_m, np.array(made.office(0).layout.room.size[:2]) - made.hull_radius_m
    clearances = []
    for _ in range(slots):
        before = made.fleet.xy
        motion = slot(made, policy(made), rng)
        assert (motion.collisions == 0).all()
        assert (motion.clearance_m > 0).all()
        assert (np.linalg.norm(made.fleet.xy - before, axis=-1) <= reach + 1e-6).all()
        assert ((made.fleet.xy > low) & (made.fleet.xy < high)).all()
        clearances.append(motion.clearance_m)
    return np.stack(clearances)


def toward(made: World, targets: np.ndarray) -> np.ndarray:
    """Full speed toward targets [E, 2]."""
    way = targets - made.fleet.xy
    reach = made.config.max_speed_mps * made.config.slot_s
    return reach * way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)


def free_places_near(made: World, targets: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A free place within 2.5 m of each target, with room for the hull, its bumper and people, [E, 2]."""
    size = np.array(made.office(0).layout.room.size[:2])
    tried = np.concatenate(
        [rng.uniform(0, size, (4000, 2)), targets.repeat(400, 0) + rng.normal(0, 1, (len(targets) * 400, 2))]
    )
    solid = made.hull_solid.of(np.array([0])).distance(tried[None])[0]
    tried = tried[((tried > 0) & (tried < size)).all(-1) & (solid > made.hull_radius_m + made.config.bumper_m)]
    chosen = []
    for cell, target in enumerate(targets):
        from_people = np.linalg.norm(tried[:, None] - made.crowd.xy[cell], axis=-1).min(-1)
        open_places = tried[from_people > 0.8]
        order = np.argsort(np.linalg.norm(open_places - target, axis=-1))
        chosen.append(open_places[order[rng.integers(0, 40)]])
    return np.array(chosen)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", ["office", "clinic"])
def test_random_commands(name, drive):
    rng = np.random.default_rng(1)
    made = world(load_layout(name), 32, drive, num_users=8)
    commands = rng.uniform(-math.pi, math.pi, 32)

    def wander(made: World) -> np.ndarray:
        commands[:] += rng.normal(0, 0.6, 32)
        return 0.5 * np.stack([np.cos(commands), np.sin(commands)], -1) * rng.uniform(0, 1, (32, 1)) ** 0.2

    assert_promises_kept(made, wander, 25, rng)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", ["office", "clinic", "open"])
def test_straight_into_every_obstacle_and_wall(name, drive):
    rng = np.random.default_rng(2)
    layout = load_layout(name)
    size = np.array(layout.room.size[:2])
    targets = []
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        brick = obstacle.bricks[rng.integers(len(obstacle.bricks))]
        targets.append(np.array(obstacle.position) + np.array([[c, -s], [s, c]]) @ brick.at[:2])
    walls = [[0, 0.3], [1, 0.6], [0.3, 0], [0.6, 1], [0, 0], [1, 1]]
    targets = np.concatenate([targets, np.array(walls) * size])
    cells = np.arange(len(targets))
    made = world(layout, len(targets), drive)
    for _ in range(2):
        places = free_places_near(made, targets, rng)
        made.fleet.place(cells, places, rng.uniform(-math.pi, math.pi, len(cells)))
        aims = targets + rng.normal(0, 0.2, targets.shape)
        clearances = assert_promises_kept(made, lambda made, aims=aims: toward(made, aims), 12, rng)
        assert np.median(clearances[-1]) < 0.2  # they did get there


@pytest.mark.parametrize("drive", DRIVES)
def test_hunting_the_nearest_person(drive):
    rng = np.random.default_rng(3)
    made = world(load_layout("open"), 32, drive, num_users=8)

    def hunt(made: World) -> np.ndarray:
        people = made.crowd.xy
        nearest = np.argmin(np.linalg.norm(people - made.fleet.xy[:, None], axis=-1), 1)
        return toward(made, people[np.arange(32), nearest])

    clearances = assert_promises_kept(made, hunt, 40, rng)
    assert np.median(clearances[-1]) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", ["office", "clinic"])
def test_long_mixtures_of_wandering_and_hunting(name, drive):
    rng = np.random.default_rng(4)
    made = world(load_layout(name), 64, drive, num_users=12, seed=9)

    def mixed(made: World) -> np.ndarray:
        people = made.crowd.xy
        nearest = np.argmin(np.linalg.norm(people - made.fleet.xy[:, None], axis=-1), 1)
        hunting = rng.random((64, 1)) < 0.5
        return np.where(hunting, toward(made, people[np.arange(64), nearest]), rng.uniform(-0.35, 0.35, (64, 2)))

    assert_promises_kept(made, mixed, 150, rng)


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_kinematic_drive_reaches_its_target_exactly(heading):
    made = alone(empty(), 24, "kinematic")
    cells = np.arange(24)
    made.fleet.place(cells, np.full((24, 2), 7.0), np.full(24, heading))
    angle, length = 2 * math.pi * cells / 24, np.linspace(0, 0.5, 24)
    command = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    slot(made, command)
    np.testing.assert_allclose(made.fleet.xy, 7 + command, atol=1e-9)


def test_wheels_reach_a_point_two_metres_away_within_eight_slots():
    made = alone(empty(), 24, "wheels")
    angle = 2 * math.pi * np.arange(24) / 24
    target = 7 + 2 * np.stack([np.cos(angle), np.sin(angle)], -1)
    for _ in range(8):
        way = target - made.fleet.xy
        slot(made, way * np.minimum(1, 0.5 / np.linalg.norm(way, axis=-1, keepdims=True)))
    assert np.linalg.norm(target - made.fleet.xy, axis=-1).max() < 0.15


def test_wheels_hardly_depend_on_the_time_step():
    paths = []
    for timestep in (0.02, 0.01):
        rng = np.random.default_rng(5)
        made = alone(empty(), 8, "wheels", timestep_s=timestep)
        path = []
        for _ in range(15):
            slot(made, rng.uniform(-0.35, 0.35, (8, 2)))
            path.append(made.fleet.xy)
        paths.append(np.stack(path))
    assert np.linalg.norm(paths[0] - 7, axis=-1).max() > 0.7
    apart = np.linalg.norm(paths[0] - paths[1], axis=-1)
    assert apart[0].max() < 0.05
    assert apart.max() < 0.2  # small differences of every slot add up


def test_wheels_converge_as_the_time_step_shrinks():
    paths = []
    for timestep in (0.02, 0.01, 0.005, 0.0025):
        rng = np.random.default_rng(6)
        made = alone(empty(), 12, "wheels", timestep_s=timestep)
        path = []
        for _ in range(6):
            slot(made, rng.uniform(-0.35, 0.35, (12, 2)))
            path.append(made.fleet.xy)
        paths.append(np.stack(path))
    coarse, middle, fine = (np.linalg.norm(path - paths[-1], axis=-1).mean() for path in paths[:-1])
    assert middle < coarse / 1.5
    assert fine < middle / 1.5
    assert fine < 0.005


@pytest.mark.parametrize("bumper_m", [0.1, 0.3])
@pytest.mark.parametrize("drive", DRIVES)
def test_a_blocked_way_ends_at_the_bumper_and_no_sooner(drive, bumper_m):
    block = Brick(at=(0, 0, 0.5), size=(1, 3, 1), material="wood")
    made = alone(
        empty(Obstacle(name="block", position=(9.5, 7), yaw=0.0, bricks=(block,))), 4, drive, bumper_m=bumper_m
    )
    made.fleet.place(np.arange(4), np.array([[7, 7], [7, 6], [7.3, 8], [6, 7.0]]), np.array([0, 1, -2, math.pi]))
    for _ in range(12):
        motion = slot(made, np.tile([0.5, 0.0], (4, 1)))
        assert (motion.clearance_m > 0).all()
    np.testing.assert_allclose(made.clearance(), bumper_m, atol=0.04)


@pytest.mark.parametrize("drive", DRIVES)
def test_who_stands_at_an_obstacle_can_leave_it(drive):
    made = alone(empty(), 4, drive)
    made.fleet.place(np.arange(4), np.tile([13.6, 7.0], (4, 1)), np.array([0, 1, -2, math.pi]))
    for _ in range(4):
        slot(made, np.tile([-0.5, 0.0], (4, 1)))
    assert (made.fleet.xy[:, 0] < 12.5).all()
    assert (made.clearance() > 1).all()


@pytest.mark.parametrize("drive", DRIVES)
def test_the_panel_turns_where_it_is_told(drive):
    made = alone(empty(), 4, drive)
    wanted = np.array([0.3, 2.0, -2.0, 3.1])
    made.fleet.face(wanted)
    for _ in range(3):
        slot(made, np.zeros((4, 2)))
    np.testing.assert_allclose(np.exp(1j * made.fleet.panel_heading), np.exp(1j * wanted), atol=0.03)


def test_the_bumper_is_read_wherever_it_could_stop_the_rover():
    made, rng = world(load_layout("office"), 64, "kinematic", num_users=8), np.random.default_rng(7)
    fleet, size = made.fleet, np.array(made.office(0).layout.room.size[:2])
    assert isinstance(fleet, StraightDrive)
    step, stopped, unread = 0.05, 0, 0
    for _ in range(60):
        # Anywhere in the room, so that many stand closer to something than rovers get.
        made.fleet.place(np.arange(64), rng.uniform(0, size, (64, 2)), np.zeros(64))
        fleet._feel(np.arange(64))
        for cell, angle in enumerate(rng.uniform(-math.pi, math.pi, 64)):
            fleet._way.unit[cell] = math.cos(angle), math.sin(angle)
            x, y = fleet.xy[cell]
            solid, people = made.hull_solid.arrays, made.crowd.walkers
            read = _may_be_stopped(fleet._way, cell, step, x, y, people, solid, 0.1)
            stops = free_travel(fleet._bumper, cell, math.cos(angle), math.sin(angle)) < step
            assert read or not stops
            stopped, unread = stopped + stops, unread + (not read and made.clearance()[cell] < 0.15)
    assert stopped > 300
    assert unread > 100  # or nothing would be saved


def test_a_displacement_that_is_no_number_stays_in_its_cell():
    made = alone(empty(), 3, "kinematic")
    made.move(np.array([[0.3, 0.0], [math.nan, math.nan], [0.0, 0.3]]), np.zeros((3, 2)), np.zeros((3, 2)))
    np.testing.assert_allclose(made.fleet.xy[[0, 2]], [[7.3, 7.0], [7.0, 7.3]])


@pytest.mark.parametrize("panel_height_m", [0.6, 1.5, 2.2])
def test_braking_follows_from_the_mast(panel_height_m):
    config = Config(world=WorldConfig(panel_height_m=panel_height_m))
    office = build(config, empty())
    model, data = office.model, mujoco.MjData(office.model)
    data.qpos[office.rover_qpos : office.rover_qpos + 2] = 7.0
    mujoco.mj_forward(model, data)
    centre_m = data.subtree_com[model.body("rover/chassis").id, 2]
    caster_m = model.geom("rover/caster_front").pos[0]
    assert config.world.braking_mps2 == pytest.approx(9.81 / (1 + centre_m / caster_m), rel=1e-3)
    wheels = [model.actuator(f"rover/wheel_{side}").id for side in ("left", "right")]
    data.ctrl[wheels] = 1.5 / 0.08
    mujoco.mj_step(model, data, 150)
    speed, before = np.linalg.norm(data.qvel[:2]), data.qpos[office.rover_qpos]
    data.ctrl[wheels] = 0
    mujoco.mj_step(model, data, 100)
    servo_m = 0.009
    rolled = data.qpos[office.rover_qpos] - before
    assert rolled == pytest.approx(speed**2 / 2 / config.world.braking_mps2 + servo_m, rel=0.1)


@pytest.mark.parametrize("timestep_s", [0.02, 0.005])
def test_a_rover_that_is_to_stand_stands(timestep_s):
    made = alone(empty(), 1, "wheels", panel_height_m=2.2, timestep_s=timestep_s)
    slot(made, np.array([[0.1, 0.0]]))
    places = []
    made.on_tick = lambda: places.append(made.fleet.xy[0])
    for _ in range(4):
        slot(made, np.zeros((1, 2)))
    assert np.ptp(places[10:], axis=0).max() < 2e-3
