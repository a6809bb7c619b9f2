from dataclasses import replace

import numpy as np
import pytest

from mjris.config import preset
from mjris.show.field import motion_field, plot_motion_field, reachable_places
from mjris.simulation.simulator import Simulator
from mjris.simulation.task import Task
from mjris.world.office import PERSON_RADIUS_M

SEED = 5
OFFICE = preset("classic")


def config(**task):
    return replace(OFFICE, world=replace(OFFICE.world, layout="clinic"), task=replace(OFFICE.task, **task))


def constant(made, motion):
    """Always the same motion."""
    action = np.zeros(Task(made).action_size)
    action[:2] = motion
    return lambda observation: np.tile(action, (len(observation), 1))


@pytest.fixture(scope="module")
def still():
    made = config(motion="goal")
    return made, motion_field(made, constant(made, (0, 0)), SEED)


def test_places_are_those_of_the_grid_with_a_way_from_the_start():
    simulator = Simulator(config())
    world, places = simulator.world, reachable_places(simulator, 0.75)
    width, depth = world.office(0).layout.room.size[:2]
    columns, rows = int(width // 0.75), int(depth // 0.75)
    x, y = (np.arange(columns) + 0.5) * width / columns, (np.arange(rows) + 0.5) * depth / rows
    goals = np.array([(i, j) for j in y for i in x])
    # Whoever drives there arrives, and goals that cannot be reached are moved.
    at = np.broadcast_to(np.array(world.office(0).layout.start), goals.shape)
    for _ in range(20):
        at = simulator.terrain.paths.toward(at, goals)
    expected = goals[np.linalg.norm(at - goals, axis=-1) < 1e-6]
    found, wanted = ({tuple(place) for place in np.round(each, 6)} for each in (places, expected))
    assert len(places) > 50
    assert found <= wanted
    # The nearest node may be hidden behind a corner.
    assert len(found) >= 0.95 * len(wanted)


def test_an_agent_that_drives_one_way_has_a_field_of_one_direction():
    made = config(motion="displacement")
    field = motion_field(made, constant(made, (0.6, -0.3)), SEED)
    np.testing.assert_allclose(field.heading, np.broadcast_to((0.6, -0.3), field.places_m.shape), atol=1e-9)


def test_every_place_is_what_a_rover_alone_there_would_do(still):
    made, field = still
    for index in (0, len(field.places_m) // 2, -1):
        task = Task(replace(made, radio=replace(made.radio, difference_factor=1.0)))
        simulator = task.simulator
        simulator.seed(SEED)
        simulator.reset()
        simulator.world.fleet.place(np.array([0]), field.places_m[index][None], np.zeros(1))
        simulator.look()
        move = task.decode(np.zeros((1, task.action_size))).displacement_m[0]
        np.testing.assert_allclose(field.heading[index], move / 0.5, atol=1e-9)
    assert np.linalg.norm(field.heading, axis=-1).max() <= 1 + 1e-9
    assert np.linalg.norm(field.heading, axis=-1).mean() > 0.8


def test_the_agent_sees_the_rover_at_every_place():
    made = config(motion="displacement", observation="csi")
    seen = []

    def act(observation):
        seen.append(observation)
        return np.zeros((len(observation), Task(made).action_size))

    field = motion_field(made, act, SEED)
    half = np.array(field.office.layout.room.size[:2]) / 2
    places = (seen[0][:, :2] + 1) * half
    assert all(np.abs(places - place).max(1).min() < 1e-4 for place in field.places_m)
    # People and direct channels, which follow the path losses, are those of the first held-out scene.
    alone = Task(replace(made, radio=replace(made.radio, difference_factor=1.0))).reset(SEED)
    users, antennas = made.world.num_users, made.radio.num_antennas
    people, losses, direct = 4, 4 + 2 * users, 4 + 2 * users + 2 * users + 1
    for part in (slice(people, losses), slice(direct, direct + 2 * users * antennas)):
        np.testing.assert_array_equal(seen[0][:, part], np.broadcast_to(alone[:, part], seen[0][:, part].shape))


def test_people_stand_as_in_the_first_held_out_scene_and_nobody_is_run_over(still):
    made, field = still
    simulator = Simulator(made)
    simulator.seed(SEED)
    simulator.reset()
    np.testing.assert_array_equal(field.floor.users_xy_m, simulator.scene.users_xy[0])
    away = np.linalg.norm(field.places_m[:, None] - field.floor.users_xy_m, axis=-1)
    assert away.min() > PERSON_RADIUS_M + simulator.world.hull_radius_m


def test_the_figure_is_a_file(still, tmp_path):
    made, field = still
    plot_motion_field(made, field, tmp_path / "motion_field.png")
    assert (tmp_path / "motion_field.png").read_bytes().startswith(b"\x89PNG")
