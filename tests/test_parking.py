import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from mjris.config import Config, preset
from mjris.eval.parking import Spot, best_spot, parked_at, promising, search_seed
from mjris.eval.playing import independent
from mjris.eval.policies import fixed_ris
from mjris.planning.radio_map import penalised
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task

ROOM = """
room.size = [5.0, 6.0, 3.0]
ap = { position = [2.5, 5.9, 2.6], facing_deg = -90 }
rover.start = [2.5, 1.0]
"""
SCENES, SLOTS, SEED = 48, 4, 11


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> Config:
    """A small room that one heading does not serve alike everywhere, with two people in it."""
    layout = tmp_path_factory.mktemp("layouts") / "room.toml"
    layout.write_text(ROOM)
    office = preset("classic")
    return replace(
        office,
        world=replace(office.world, layout=str(layout), num_users=2),
        radio=replace(office.radio, noise_dbm_per_mhz=-40.0),
        task=replace(office.task, slots=SLOTS),
    )


@pytest.fixture(scope="module")
def spot(config) -> Spot:
    return best_spot(config, SEED)


def played_values(config: Config, spots: list[Spot]) -> np.ndarray:
    """What closed forms get at every spot, in one simulator with a cell for every spot and scene."""
    fixed = fixed_ris().changed(independent(replace(config, world=replace(config.world, pan="locked"))))
    cells = [CellId(search_seed(SEED), scene) for _ in spots for scene in range(SCENES)]
    task = Task(fixed, cells)
    simulator, values = task.simulator, []
    x, y, heading_deg = np.repeat(np.array(spots), SCENES, axis=0).T
    simulator.world.fleet.place(np.arange(len(cells)), np.stack([x, y], -1), np.radians(heading_deg))
    simulator.look()
    for _ in range(SLOTS):
        rates = simulator.step(*task.decode(np.zeros((len(cells), task.action_size)))).rates_bps
        values.append(penalised(rates, config.task.qos_bps, config.task.qos_penalty))
    return np.mean(values, 0).reshape(len(spots), SCENES).mean(1)


def test_the_spot_is_as_good_as_the_best_of_all(config, spot):
    """Against playing every place and heading."""
    nodes = Simulator(config).terrain.paths.nodes[::2]
    headings = (0.0, 90.0, 180.0, 270.0)
    values = played_values(config, [Spot(x, y, heading) for x, y in nodes.tolist() for heading in headings])
    found = played_values(config, [spot])[0]
    assert found >= 0.98 * values.max()
    assert found > 1.05 * np.median(values)


def test_promising_spots_are_apart_and_can_be_stood_at(config):
    spots = promising(config, SEED)
    assert len(spots) > 2
    assert min(math.dist(one[:2], other[:2]) for one, other in combinations(spots, 2)) >= 1
    simulator = Simulator(config)
    assert (
        simulator.world.hull_solid.distance(np.array([[spot[:2]] for spot in spots])) >= simulator.terrain.paths.keep_m
    ).all()


def test_a_parked_ris_stands_and_faces_where_it_is_told(config, spot):
    task = Task(parked_at(spot).changed(config), cells=3)
    for _ in range(2):
        scene = task.simulator.step(*parked_at(spot).controls(task)).scene
        np.testing.assert_allclose(scene.rover_xy, np.tile(spot[:2], (3, 1)))
        np.testing.assert_allclose(np.exp(1j * scene.panel_heading), np.exp(1j * math.radians(spot.heading_deg)))


def test_the_search_sees_no_scene_that_is_judged():
    seeds = {search_seed(seed) for seed in range(50)}
    assert len(seeds) == 50
    assert not seeds & set(range(50))
