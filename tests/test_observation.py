import math
from dataclasses import replace

import numpy as np
import pytest

from mjris.config import Config, preset
from mjris.simulation.outlook import best_goals, place_values
from mjris.simulation.task import Task

USUAL_DB = (55.7206 + 78.5206) / 2
"""At 10 m and 2 GHz, in sight 16.9 − 27.2 + 66.0206, behind one obstacle 66.0206 − 28 + 25.5 + 15."""


def kinematic(name: str, scheme: str = "noma", **world) -> Config:
    config = preset(name)
    return replace(
        config,
        world=replace(config.world, drive="kinematic", **world),
        radio=replace(config.radio, scheme=scheme),
    )


@pytest.mark.parametrize("name", ["paper", "classic", "office"])
@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_observations_are_of_order_one(name, scheme):
    task, rng = Task(kinematic(name, scheme), 8), np.random.default_rng(0)
    seen = np.array([task.step(rng.uniform(-1, 1, (8, task.action_size))).observation for _ in range(50)])
    assert np.isfinite(seen).all()
    assert abs(seen).max() < 20
    assert 0.1 < seen.std() < 5


def test_the_csi_observation_is_the_papers_state():
    task = Task(kinematic("paper", num_users=2, layout="clinic"), cells=3)
    task.step(np.random.default_rng(2).uniform(-1, 1, (3, task.action_size)))
    simulator, observed = task.simulator, task.observe()
    for e in range(3):
        scene, half = simulator.scene, np.array(simulator.world.office(e).layout.room.size[:2]) / 2
        losses = scene.path_loss_db[e]
        fading = [*scene.channels.direct[e], *scene.channels.incident[e], *scene.channels.reflected[e]]
        # Links are AP–users, RIS–users and AP–RIS; the rows of G share the last one.
        scale = [*losses[:2], *[losses[4]] * 16, *losses[2:4]]
        rows = [row * 10 ** (loss / 20) for row, loss in zip(fading, scale, strict=True)]
        groups = [np.concatenate(rows[a:b]) for a, b in ((0, 2), (2, 18), (18, 20))]
        state = [
            scene.rover_xy[e] / half - 1,
            [np.cos(scene.panel_heading[e]), np.sin(scene.panel_heading[e])],
            *(scene.users_xy[e] / half - 1),
            (losses - USUAL_DB) / 15,
            *(part(group) for group in groups for part in (np.real, np.imag)),
        ]
        left = [1 - 1 / task.config.task.slots]
        np.testing.assert_allclose(observed[e], np.concatenate([*state, left]), atol=1e-5)


def test_the_map_observation_is_the_scene_and_the_radio_map_around_the_rover():
    task = Task(kinematic("classic"), cells=3)
    rng = np.random.default_rng(3)
    for _ in range(3):
        task.step(rng.uniform(-1, 1, (3, task.action_size)))
    simulator, observed = task.simulator, task.observe()
    scene, goals, promised = simulator.scene, *best_goals(simulator)
    circle = [(math.cos(turn * math.pi / 4), math.sin(turn * math.pi / 4)) for turn in range(8)]
    offsets = np.array([(0, 0), *(np.multiply(radius, way) for radius in (0.6, 2, 5) for way in circle)])
    values = place_values(simulator, scene.rover_xy[:, None] + offsets) / 1e6
    reach = simulator.world.hull_radius_m + 0.1
    for e in range(3):
        half, here = np.array([7.5, 10]), scene.rover_xy[e]
        ends = here + 5 * np.array(circle)
        free = simulator.world.free_share(scene.rover_xy[:, None], np.tile(ends, (3, 1, 1)), reach)[e]
        direct, incident, reflected = (abs(link[e]) for link in scene.channels)
        strength = (direct**2).sum(-1) ** 0.5
        panel = (reflected * (incident**2).sum(-1) ** 0.5).sum(-1)
        goal = goals[e] - here
        expected = [
            here / half - 1,
            [np.cos(scene.panel_heading[e]), np.sin(scene.panel_heading[e])],
            *(scene.users_xy[e] / half - 1),
            *((scene.users_xy[e] - here) / half),
            (scene.path_loss_db[e] - USUAL_DB) / 15,
            (-20 * np.log10(strength) - USUAL_DB) / 15,
            (-20 * np.log10(np.maximum(panel, 1e-9)) - USUAL_DB) / 15,
            values[e, :1],
            5 * (values[e, 1:] - values[e, 0]),
            np.minimum(free, 1),
            goal / math.sqrt(12 * max(np.linalg.norm(goal), 1e-9)),
            5 * (promised[e : e + 1] / 1e6 - values[e, 0]),
        ]
        np.testing.assert_allclose(observed[e], np.concatenate(expected), rtol=1e-5, atol=1e-6)
