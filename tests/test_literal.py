"""Whole slots against the literal equations: random configs, layouts and panels, from places to rates."""

import math
from dataclasses import replace

import literal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjris.config import Config, Hardware, Knowledge, preset
from mjris.radio.closed_forms import aligned_phases, qos_aligned_phases
from mjris.radio.links import Channels
from mjris.radio.surface import Surface
from mjris.simulation.outlook import bare_values, place_values
from mjris.simulation.simulator import Simulator

PLAN = """
room.size = [11.0, 9.0, 3.0]
ap.position = [5.0, 8.8, 2.5]
ap.facing_deg = 250.0
rover.start = [5.5, 4.0]
wall = [{ from = [3.0, 0.0], to = [3.0, 5.0] }, { from = [3.0, 5.0], to = [4.5, 5.0], height_m = 1.4 }]
obstacle = [{ kind = "cabinet", at = [8.0, 6.0], facing_deg = 70.0 }, { kind = "desk", at = [1.2, 6.5] }]
ris = [
  { at = [10.9, 4.0, 1.8], facing_deg = 180.0, rows = 2, cols = 3 },
  { at = [0.1, 2.0, 1.2], facing_deg = 20.0, rows = 1, cols = 2 },
]
"""
USERS = {4: (1, 2, 4), 6: (2, 3)}


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plans") / "plan.toml"
    path.write_text(PLAN)
    return str(path)


surfaces = st.builds(
    Hardware,
    phase_bits=st.sampled_from([None, None, 1, 2, 3]),
    least_amplitude=st.sampled_from([1.0, 1.0, 0.2]),
    dead_share=st.sampled_from([0.0, 0.3]),
)


@st.composite
def configs(draw) -> Config:
    """Everything that an equation depends on, at random; the layout stands for one that is filled in."""
    base, users = preset("classic"), draw(st.sampled_from(sorted(USERS)))
    table = draw(st.sampled_from(["paper", "inh"]))
    radio = replace(
        base.radio,
        link_table=table,
        carrier_hz=draw(st.sampled_from([2e9, 3.5e9] if table == "paper" else [2e9, 28e9])),
        noise_dbm_per_mhz=draw(st.sampled_from([-30.0, -60.0, -107.0])),
        num_antennas=draw(st.integers(4, 5)),
        panel_rows=draw(st.integers(1, 3)),
        panel_cols=draw(st.integers(1, 3)),
        obstacles=draw(st.sampled_from(["counted", "counted", "materials"])),
        knowledge=draw(st.builds(Knowledge, pilot_s=st.sampled_from([0.0, 1e-3]), control_s=st.sampled_from([0, 0.1]))),
        element_pattern=draw(st.sampled_from(["isotropic", "cosine"])),
        element_amplitude=draw(st.sampled_from([1.0, 0.8])),
        surface=draw(surfaces),
        scheme=draw(st.sampled_from(["noma", "oma"])),
        oma_selection=draw(st.booleans()),
        decoding_order=draw(st.sampled_from(["dynamic", "static"])),
        num_clusters=draw(st.sampled_from(USERS[users])),
        fading_memory=draw(st.sampled_from([0.0, 0.7])),
        difference_factor=draw(st.sampled_from([0.0, 0.5])),
    )
    world = replace(base.world, layout=draw(st.sampled_from(["office", "clinic", "plan"])), num_users=users)
    world = replace(world, body_blockage=draw(st.booleans()), rover_blockage=draw(st.booleans()))
    task = replace(base.task, qos_bps=draw(st.sampled_from([0.0, 10e3, 100e3, 1e6])))
    return replace(base, radio=radio, world=world, task=task, seed=draw(st.integers(0, 2**31)))


@settings(max_examples=30)
@given(configs())
def test_a_slot_is_that_of_the_literal_equations(plan, config):
    if config.world.layout == "plan":
        config = replace(config, world=replace(config.world, layout=plan))
    simulator, rng = Simulator(config, 2), np.random.default_rng(config.seed)
    for _ in range(2):
        scene, powers = simulator.scene, simulator.split_powers(rng.random((2, config.world.num_users)))
        phases = rng.uniform(-math.pi, math.pi, (2, simulator.num_elements))
        order, diffuse = simulator.order.copy(), simulator._diffuse.copy()
        expected = []
        for e in range(2):
            channels = channels_of(simulator, e, diffuse[e])
            for found, wanted in zip(scene.channels, channels, strict=True):
                scale = abs(np.array(wanted)).max()
                np.testing.assert_allclose(found[e], wanted, rtol=1e-9, atol=1e-9 * scale)
            channel = literal.effective(config.radio, *channels, phases[e])
            given = order[e].tolist() if order[e, 0, 0] >= 0 else None
            expected.append(literal.rates_of(simulator.system, channel, powers[e], given))
            assert_closed_forms(simulator, channels, channel, given)
            assert_places(simulator, e)
        # With a static order the first slot fixes that of its gains, in which it is played.
        slot = simulator.step(np.array([[0.3, 0.1], [-0.2, 0.2]]), phases, powers)
        np.testing.assert_allclose(slot.rates_bps, expected, rtol=1e-9, atol=1e-9)


def channels_of(simulator: Simulator, e: int, diffuse) -> tuple[list, list, list]:
    """h_d [K][M], G [N][M] and h_r [K][N] from where everything stands."""
    config, world, scene = simulator.config, simulator.world, simulator.scene
    radio, office = config.radio, world.office(e)
    ap, receivers = simulator.ap_position[e].tolist(), world.receivers()[e].tolist()
    centres, headings = world.panel_centres()[e].tolist(), world.panel_headings()[e].tolist()
    spacing, users, left = literal.LIGHT_M_PER_S / radio.carrier_hz / 2, len(receivers), iter(diffuse)
    antennas = literal.array(ap, office.ap_axis.tolist(), radio.num_antennas, spacing)
    obstacles = scene.blockers[e].tolist()
    if radio.obstacles == "materials":
        ends = simulator.links.ends(simulator.ap_position, world.panel_centres(), world.receivers())
        ways = *ends, simulator.links.person, None, simulator.links.panel == 0
        obstacles = world.losses.blockers(*ways)[e].tolist()

    def entry(end, panel, heading, behind, start, stop):
        gain, k_factor = literal.mean_gain(radio, end, panel, heading, behind), literal.rician_k(radio, behind)
        return literal.entry(gain, k_factor, start, stop, next(left), 2 * spacing)

    direct = [
        [entry(receivers[k], ap, None, obstacles[k], receivers[k], antenna) for antenna in antennas]
        for k in range(users)
    ]
    of_panels = [
        (s, place)
        for s, (rows, cols) in enumerate(world.panel_sizes.tolist())
        for place in literal.elements(centres[s], headings[s], rows, cols, spacing)
    ]
    to_ap = users + len(centres) * users
    incident = [
        [entry(ap, centres[s], headings[s], obstacles[to_ap + s], place, antenna) for antenna in antennas]
        for s, place in of_panels
    ]
    reflected = [
        [
            entry(receivers[k], centres[s], headings[s], obstacles[users + s * users + k], receivers[k], place)
            for s, place in of_panels
        ]
        for k in range(users)
    ]
    for n in np.flatnonzero(simulator.dead[e]):
        incident[n] = [0j] * radio.num_antennas
    return direct, incident, reflected


def assert_closed_forms(simulator: Simulator, channels: tuple[list, list, list], channel, order) -> None:
    """Powers and phases of one cell."""
    system, radio = simulator.system, simulator.config.radio
    wanted = [1.1 * system.qos_bps] * len(channel)
    given_order = None if order is None else np.array([order])
    powers, reached = simulator.reference_powers(np.array([channel]), np.array([wanted]), given_order)
    expected_powers, expected = literal.qos_or_sum(system, channel, wanted, order)
    np.testing.assert_allclose(reached[0], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(powers[0], expected_powers, rtol=1e-9, atol=1e-12)
    made = Channels(*(np.array([link]) for link in channels))
    surface, weights = Surface.of(radio), np.linspace(0.5, 2.0, len(channel))
    found = aligned_phases(surface, made, weights, iterations=2)[0]
    assert_equal_phases(found, literal.aligned_phases(radio, *channels, weights, 2))
    found = qos_aligned_phases(system, surface, made, weights[None], given_order, iterations=5)[0]
    expected = literal.qos_aligned_phases(system, radio, *channels, weights, order, 5)
    assert_equal_phases(found, expected)


def assert_equal_phases(found, expected) -> None:
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * np.array(expected)), atol=1e-6)


def assert_places(simulator: Simulator, e: int) -> None:
    """What a place is worth, and what there is without RIS."""
    config, world, scene, links = simulator.config, simulator.world, simulator.scene, simulator.links
    radio, task, users = config.radio, config.task, config.world.num_users
    direct = scene.mean_gain[e, links.direct].tolist()
    bare = literal.predicted_rates(simulator.bare_system, radio, direct, [])
    expected = literal.penalised(bare, task.qos_bps, task.qos_penalty)
    assert bare_values(simulator)[e] == pytest.approx(expected, rel=1e-9)
    # At a node, in the middle of its square, the obstacles from the middles of the users' squares are exact.
    place = simulator.terrain.paths.nodes[7]
    panel = [*place.tolist(), config.world.panel_height_m]
    heading = simulator.bisector(np.broadcast_to(place, (2, 2)))[e]
    ap = simulator.ap_position[e].tolist()
    seen = simulator.terrain.sight_map.seen(scene.users_xy)
    ends = [*world.receivers()[e].tolist(), ap]
    square = int(np.rint((place[0] - seen.grid.x_m) / 0.5)) * seen.grid.rows + int(
        np.rint((place[1] - seen.grid.y_m) / 0.5)
    )
    behind = [int(seen.rows[e, i, square]) / 10 for i in range(len(ends))]
    gains = [literal.mean_gain(radio, end, panel, heading, n) for end, n in zip(ends, behind, strict=True)]
    panels = [(radio.num_elements, gains[-1], gains[:-1])]
    reflected = scene.mean_gain[e, links.reflected].reshape(-1, users)
    incident = scene.mean_gain[e, links.incident]
    panels += [(int(links.elements[s]), incident[s], reflected[s].tolist()) for s in range(1, len(links.elements))]
    rates = literal.predicted_rates(simulator.system, radio, direct, panels)
    found = place_values(simulator, np.broadcast_to(place, (2, 1, 2)))[e, 0]
    assert found == pytest.approx(literal.penalised(rates, task.qos_bps, task.qos_penalty), rel=1e-9)
