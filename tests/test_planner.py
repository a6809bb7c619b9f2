import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mjris.config import Config, preset
from mjris.eval.planner import best_places
from mjris.eval.policies import planned
from mjris.planning.wayfinding import first_nodes, last_nodes, next_node, shortest
from mjris.simulation.outlook import best_goals, node_values, place_values
from mjris.simulation.simulator import Simulator

CELLS = 3


def simulator(cells: int = CELLS, **world) -> Simulator:
    config = preset("classic")
    return Simulator(replace(config, world=replace(config.world, layout="clinic", **world)), cells)


@pytest.fixture(scope="module")
def made() -> Simulator:
    return simulator()


def test_node_values_are_those_of_single_places(made):
    values, nodes = node_values(made), made.terrain.paths.nodes
    assert values.shape == (CELLS, len(nodes))
    for node in (0, 200, len(nodes) - 1):
        single = place_values(made, np.tile(nodes[node], (CELLS, 1, 1)))[:, 0]
        np.testing.assert_allclose(values[:, node], single, rtol=1e-12)


def test_best_places_are_the_best_and_can_be_reached(made):
    places, values = best_places(made)
    assert (values >= node_values(made).max(1)).all()
    np.testing.assert_allclose(place_values(made, places[:, None])[:, 0], values)
    for place in places:
        assert last_nodes(made.terrain.paths.graph, 0, *place)[:2] == pytest.approx(place)
    assert (made.world.hull_solid.distance(places[:, None])[:, 0] >= made.terrain.paths.keep_m).all()


def test_unreachable_nodes_are_never_best():
    jittered = simulator(layout_jitter_m=0.4)
    values, reachable = node_values(jittered), jittered.terrain.paths.reachable
    assert not reachable.all()
    assert np.isneginf(values[~reachable]).all()
    assert np.isfinite(values[reachable]).all()


@pytest.mark.parametrize("horizon", [3, 8])
def test_goals_are_those_of_a_search_over_all_ways(horizon):
    """Against sums along whole ways, walked one by one."""
    base = preset("classic")
    task = replace(base.task, horizon_slots=horizon)
    made = Simulator(replace(base, world=replace(base.world, layout="clinic"), task=task), 1)
    ways, here, reach = made.terrain.paths, made.world.fleet.xy, horizon * made.config.world.max_speed_mps
    goal, promised = best_goals(made)
    totals = {tuple(here[0]): reach * place_values(made, here[:, None])[0, 0]}
    for node in np.flatnonzero(ways.distance_to_nodes(here)[0] < reach).tolist():
        _, at, _ = shortest(ways.graph, 0, *first_nodes(ways.graph, 0, *here[0]), np.array([node]), np.zeros(1))
        way = [here[0], ways.nodes[at]]
        while at != node:
            at = next_node(ways.graph, 0, at, node)
            way.append(ways.nodes[at])
        values = place_values(made, np.array(way)[None])[0]
        legs = [math.dist(a, b) for a, b in pairwise(way)]
        on_the_way = sum(leg * (u + v) / 2 for leg, (u, v) in zip(legs, pairwise(values), strict=True))
        totals[tuple(way[-1])] = on_the_way + (reach - sum(legs)) * values[-1]
    # Ways of equal length may pass through places of different value.
    assert totals[tuple(goal[0])] >= 0.99 * max(totals.values())
    assert promised[0] == pytest.approx(max(totals.values()) / reach, rel=0.01)
    assert len(totals) > 10


def test_the_planner_gets_to_better_places_and_touches_nothing():
    made = simulator()
    config: Config = made.config
    still = np.zeros((CELLS, config.world.num_users))
    before = place_values(made, made.world.fleet.xy[:, None])[:, 0]
    clearances = []
    for _ in range(60):
        move = planned(made)
        assert (np.linalg.norm(move, axis=-1) <= config.world.max_speed_mps * config.world.slot_s + 1e-9).all()
        motion = made.world.move(move, still, still)
        made.look()
        assert (motion.collisions == 0).all()
        clearances.append(motion.clearance_m)
    after = place_values(made, made.world.fleet.xy[:, None])[:, 0]
    # People may stand in the last steps' way.
    assert (after >= 0.98 * before).all()
    assert (after / before).mean() > 1.1
    # People stand still, so that in the end nothing is better within the horizon than to stay.
    assert (np.linalg.norm(planned(made), axis=-1) < 1e-6).all()
    assert np.min(clearances) > 0
