import math
from dataclasses import replace

import literal
import numpy as np
import pytest

from mjris.config import preset
from mjris.planning.radio_map import _link_gains, penalised
from mjris.simulation.outlook import _ground, bare_values, best_goals, node_values, place_values
from mjris.simulation.simulator import Simulator

OFFICE = preset("classic")


@pytest.fixture(scope="module")
def simulator():
    return Simulator(OFFICE, cells=3)


def test_link_gains_are_those_of_the_formulas_at_every_place(simulator):
    rng = np.random.default_rng(0)
    places = rng.uniform((0.5, 0.5), (14.5, 19.5), (3, 20, 2))
    panel_m = OFFICE.world.panel_height_m
    world, ground, gains = simulator.world, _ground(simulator), np.empty((5, 20))
    for e in range(3):
        ap, users = simulator.ap_position[e], world.receivers()[e]
        _link_gains(ground, e, places[e], gains)
        for place, of_place in zip(places[e], gains.T, strict=True):
            panel = np.array([*place, panel_m])
            units = [(user - panel)[:2] / np.linalg.norm((user - panel)[:2]) for user in users]
            toward_users = np.mean(units, 0) / np.linalg.norm(np.mean(units, 0))
            facing = toward_users + (ap - panel)[:2] / np.linalg.norm((ap - panel)[:2])
            facing = np.array([*facing, 0]) / np.linalg.norm(facing)
            for k, (end, found) in enumerate(zip([*users, ap], of_place, strict=True)):
                middle = np.rint(place / 0.5) * 0.5
                start = end if k == 4 else np.array([*np.rint(end[:2] / 0.5) * 0.5, end[2]])
                stop = np.array([*middle, panel[2]])
                n = world.sight.blockers(start[None, None], stop[None, None])[0, 0]
                expected = literal.mean_gain(OFFICE.radio, end, panel, math.atan2(facing[1], facing[0]), n)
                assert found == pytest.approx(expected, rel=1e-9)


def test_a_place_behind_the_world_is_worth_what_the_direct_channel_is(simulator):
    # So far away that the RIS adds nothing.
    far = place_values(simulator, np.full((3, 1, 2), 1e7))
    none = replace(OFFICE, radio=replace(OFFICE.radio, element_amplitude=0.0))
    bare = place_values(Simulator(none, cells=3), np.full((3, 1, 2), 5.0))
    np.testing.assert_allclose(far, bare, rtol=1e-6)
    np.testing.assert_allclose(bare_values(simulator), bare[:, 0], rtol=1e-12)


def test_a_heading_takes_the_place_of_the_bisector(simulator):
    nodes = simulator.terrain.paths.nodes
    for node in (3, 150):
        facing = simulator.bisector(np.tile(nodes[node], (3, 1)))
        turned = node_values(simulator)[:, node]
        for e in range(3):
            assert node_values(simulator, facing[e])[e, node] == pytest.approx(turned[e], rel=1e-9)
    away = math.atan2(*(nodes - simulator.ap_position[0, :2])[150, ::-1])
    # The back of a panel with cosine elements reflects nothing.
    np.testing.assert_allclose(node_values(simulator, away)[:, 150], bare_values(simulator), rtol=1e-9)


def test_goals_promise_the_most_of_all_places_and_of_staying(simulator):
    goal, promised = best_goals(simulator)
    paths, here = simulator.terrain.paths, simulator.world.fleet.xy
    present, values = place_values(simulator, here[:, None])[:, 0], node_values(simulator)
    length = paths.distance_to_nodes(here)
    on_the_way = paths.along(length, present, values, np.inf)
    for e in range(3):
        totals = [(12 * present[e], here[e])]
        for node in np.flatnonzero(length[e] < 6):
            total = on_the_way[e, node] / 0.5 + (12 - length[e, node] / 0.5) * values[e, node]
            totals.append((total, paths.nodes[node]))
        best, place = max(totals, key=lambda total: total[0])
        np.testing.assert_allclose(goal[e], place)
        assert promised[e] == pytest.approx(best / 12)


def test_the_penalty_is_for_any_user_below_qos():
    rates = np.array([[2e4, 3e4], [9e3, 5e4]])
    np.testing.assert_allclose(penalised(rates, 1e4, 2.0), [5e4, 5.9e4 / 2])
