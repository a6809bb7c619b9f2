"""Panels at fixed places of a layout, beside the rover's: what they are in the office, and what they do to a slot."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from dataclasses import replace

import literal
import mujoco
import numpy as np
import pytest

from mjris.config import ConfigError, preset
from mjris.eval.bound import upper_bound
from mjris.eval.floormap import floor_map
from mjris.eval.optimum import best_known
from mjris.planning.prediction import Arrays, beside_rover
from mjris.radio.surface import Mean
from mjris.show.rollout import record
from mjris.show.video import snapshot
from mjris.simulation.outlook import bare_values, place_values
from mjris.simulation.simulator import Simulator
from mjris.simulation.task import Task
from mjris.world.layout import load_layout
from mjris.world.office import GROUP_WALLS, build
from mjris.world.panels import all_elements

PANELS = "ris = [{ at = [11.99, 5.0, 1.9], facing_deg = 180.0, rows = 3, cols = 5 }, %s]"
SECOND = "{ at = [4.0, 3.0, 1.2], facing_deg = 30.0, rows = 2, cols = 2 }"
PLAN = """
room.size = [12.0, 9.0, 3.0]
ap.position = [6.0, 8.9, 2.5]
ap.facing_deg = 270.0
rover.start = [6.0, 4.0]
obstacle = [{ kind = "cabinet", at = [9.0, 6.0] }]
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("layouts") / "three.toml"
    path.write_text(PANELS % SECOND + PLAN)
    made = preset("classic")
    return replace(made, world=replace(made.world, layout=str(path)), seed=3)


@pytest.fixture(scope="module")
def simulator(config):
    return Simulator(config, 3)


def test_boards_hang_where_they_are_told_and_their_elements_are_those_of_the_radio(config, simulator):
    office = build(config, load_layout(config.world.layout))
    data = mujoco.MjData(office.scenery)
    mujoco.mj_forward(office.scenery, data)
    half = config.radio.wavelength_m / 2
    for name, at, facing, rows, cols in (
        ("ris0", (11.99, 5.0, 1.9), math.pi, 3, 5),
        ("ris1", (4, 3, 1.2), 0.5236, 2, 2),
    ):
        board = office.scenery.geom(f"{name}/board")
        np.testing.assert_allclose(data.geom_xpos[board.id], at)
        np.testing.assert_allclose(board.size[1:], [cols * half / 2 + 0.01, rows * half / 2 + 0.01])
        assert board.group == GROUP_WALLS
        for n in range(rows * cols):
            row, col = divmod(n, cols)
            along = (col - (cols - 1) / 2) * half
            place = [at[0] - math.sin(facing) * along, at[1] + math.cos(facing) * along, at[2]]
            place[2] += (row - (rows - 1) / 2) * half
            # A tile lies 8 mm before the middle of its board.
            tile = data.geom(f"{name}/element{n}").xpos - 0.008 * np.array([math.cos(facing), math.sin(facing), 0])
            np.testing.assert_allclose(tile, place, atol=1e-5)
    assert all_elements(config) == simulator.num_elements == 16 + 15 + 4
    np.testing.assert_allclose(simulator.world.panel_centres()[:, 1:], [[(11.99, 5.0, 1.9), (4, 3, 1.2)]] * 3)
    np.testing.assert_allclose(simulator.world.panel_headings()[:, 1:], [[math.pi, math.radians(30)]] * 3)


def test_boards_stop_rovers_and_people_but_no_links(config, simulator):
    world = simulator.world
    place = np.array([[[4.0, 3.0]]] * 3)
    assert (world.hull_solid.distance(place) == 0).all()
    start, end = np.array([[[4.3, 2.5, 1.2]]] * 3), np.array([[[3.7, 3.5, 1.2]]] * 3)
    assert (world.sight.blockers(start, end) == 0).all()
    low = replace(config, world=replace(config.world, start_m=(4.0, 3.3)))
    with pytest.raises(ConfigError, match=r"world.start_m: .* obstacle ris1 is 0\.\d\d m away"):
        Simulator(low)
    people = np.stack([simulator.world._placement.draw(0, np.random.default_rng(seed)) for seed in range(200)])
    assert np.linalg.norm(people - [4.0, 3.0], axis=-1).min() > 0.22


@pytest.mark.parametrize(
    ("panel", "message"),
    [
        (
            "{ at = [0.0, 3.0, 1.2], facing_deg = 0.0, rows = 2, cols = 2 }",
            r"ris.1: at \[0.0, 3.0, 1.2\] .* reaches 0.006 m through a wall",
        ),
        (
            "{ at = [4.0, 3.0, 1.2], facing_deg = 0.0, rows = 40, cols = 2 }",
            "ris.1: .* through a wall, the floor or the ceiling",
        ),
        ("{ at = [9.0, 6.0, 1.2], facing_deg = 0.0, rows = 2, cols = 2 }", "ris.1: .* deep in obstacle cabinet_1"),
        ("{ at = [11.99, 5.1, 1.9], facing_deg = 180.0, rows = 2, cols = 2 }", "ris.1: .* deep in ris.0"),
        ("{ at = [4.0, 3.0, 1.2], facing_deg = 0.0, rows = 0, cols = 2 }", "ris.1.rows: 0 is not allowed"),
        ("{ at = [4.0, 3.0], facing_deg = 0.0, rows = 1, cols = 2 }", "ris.1.at"),
    ],
)
def test_a_panel_that_cannot_be_gets_one_sentence(panel, message, config, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(PANELS % panel + PLAN)
    with pytest.raises(ConfigError, match=message) as error:
        Simulator(replace(config, world=replace(config.world, layout=str(path))))
    assert "\n" not in str(error.value)


def test_links_of_all_panels_are_those_of_their_places(config, simulator):
    """Mean gains by hand, and channels with as many rows as there are elements."""
    scene, links, world = simulator.scene, simulator.links, simulator.world
    assert scene.blockers.shape == scene.mean_gain.shape == (3, 4 + 3 * 4 + 3)
    assert scene.channels.incident.shape == (3, 35, 4)
    assert scene.channels.reflected.shape == (3, 4, 35)
    reflected = scene.mean_gain[:, links.reflected].reshape(3, 3, 4)
    for e in range(3):
        for s, heading in enumerate(world.panel_headings()[e]):
            panel = world.panel_centres()[e, s]
            ends = [*world.receivers()[e], simulator.ap_position[e]]
            gains = [*reflected[e, s], scene.mean_gain[e, links.incident][s]]
            for end, gain in zip(ends, gains, strict=True):
                n = world.sight.blockers(end[None, None], panel[None, None], ids=np.array([e]))[0, 0]
                assert gain == pytest.approx(literal.mean_gain(config.radio, end, panel, heading, n), rel=1e-9)


def test_what_elements_add_is_the_sum_over_all_panels(simulator):
    """The effective channel element by element, whichever panel an element is of."""
    scene, phases = simulator.scene, np.random.default_rng(0).uniform(-3, 3, (3, 35))
    found = simulator.effective_channel(phases)
    for e in range(3):
        for k in range(4):
            for m in range(4):
                total = scene.channels.direct[e, k, m]
                for n in range(35):
                    through = scene.channels.reflected[e, k, n] * scene.channels.incident[e, n, m]
                    total += through * np.exp(1j * phases[e, n])
                assert found[e, k, m] == pytest.approx(total, rel=1e-9)


def test_closed_forms_are_below_the_optimum_and_that_below_the_bound(config, simulator):
    scene, radio = simulator.scene, config.radio
    phases = simulator.reference_phases()
    _, closed = simulator.reference_powers(simulator.effective_channel(phases))
    best = best_known(scene.known, simulator.clusters, radio, 0.0, np.random.default_rng(0))
    bound = upper_bound(scene.known, simulator.clusters, radio)
    assert (closed.sum(1) <= best.rates_bps.sum(1) * (1 + 1e-9)).all()
    assert (best.rates_bps.sum(1) <= bound).all()


def test_paths_beside_the_rover_are_summed_by_hand(simulator):
    rng = np.random.default_rng(4)
    direct, incident, reflected = 10 ** rng.uniform(-9, -6, (2, 4)), rng.random((2, 3)), rng.random((2, 3, 4))
    found = beside_rover(
        simulator.system, Arrays(4, 16, Mean(0.7, 0.5)), direct, incident, reflected, np.array([6, 10, 1])
    )
    for e in range(2):
        for k in range(4):
            amplitude, power = math.sqrt(direct[e, k]), 0.0
            for s, count in enumerate((6, 10, 1)):
                gain = incident[e, s] * reflected[e, s, k]
                amplitude += count / 2 * 0.7 * math.sqrt(gain)
                power += (count * 0.5 - count / 2 * 0.49) * gain
            assert found.coherent[e, k] == pytest.approx(amplitude, rel=1e-12)
            assert found.scattered[e, k] == pytest.approx(power, rel=1e-12)


def test_the_radio_map_counts_fixed_panels_wherever_the_rover_is(config, simulator, tmp_path):
    """Against a layout in which the rover's panel is the only one, at the place of a fixed one."""
    far = np.full((3, 1, 2), 1e7)
    assert (place_values(simulator, far)[:, 0] != bare_values(simulator)).any()
    none = replace(config, radio=replace(config.radio, element_amplitude=0.0))
    silent = Simulator(none, 3)
    np.testing.assert_allclose(place_values(silent, far)[:, 0], bare_values(silent), rtol=1e-9)


def test_the_floor_map_adds_all_panels_in_phase(config):
    alone = Simulator(config)
    floor = floor_map(alone, resolution_m=0.9)
    y, x = 3, 5
    place = np.array([floor.x_m[x], floor.y_m[y], config.world.user_height_m])
    amplitude = 10 ** (-floor.path_loss_db[y, x] / 20)
    scene, centres = alone.scene, alone.world.panel_centres()[0]
    for s, (centre, heading, count) in enumerate(
        zip(centres, alone.world.panel_headings()[0], (16, 15, 4), strict=True)
    ):
        n = alone.world.sight.blockers(place[None, None], centre[None, None])[0, 0]
        gain = literal.mean_gain(config.radio, place, centre, heading, n)
        amplitude += count * math.sqrt(gain * scene.mean_gain[0, alone.links.incident][s])
    snr = config.radio.tx_power_w * 4 * amplitude**2 / config.radio.noise_w
    assert floor.ris_snr_db[y, x] == pytest.approx(10 * math.log10(snr), abs=1e-6)


@pytest.mark.parametrize("observation", ["csi", "map"])
def test_agents_act_on_and_see_all_panels(config, observation):
    control = "elements" if observation == "csi" else "weights"
    task = Task(replace(config, task=replace(config.task, observation=observation, phase_control=control)), 2)
    assert task.action_size == 2 + (35 if observation == "csi" else 4) + 4
    outcome = task.step(np.random.default_rng(1).uniform(-1, 1, (2, task.action_size)))
    assert np.isfinite(outcome.observation).all()
    assert outcome.observation.shape == (2, task.observation_size)
    if observation == "csi":
        scene, at = task.simulator.scene, 4 + 8 + 19 + 2 * 16
        # The first elements of the rover's panel, of the second and of the third, each by the loss of its own link.
        for n, s in ((0, 0), (16, 1), (31, 2)):
            loss = scene.path_loss_db[0, task.simulator.links.incident][s]
            expected = scene.known.incident[0, n].real * 10 ** (loss / 20)
            np.testing.assert_allclose(outcome.observation[0, at + 4 * n : at + 4 * n + 4], expected, rtol=1e-5)
            at_user = at + 2 * 35 * 4
            loss = scene.path_loss_db[0, task.simulator.links.reflected].reshape(3, 4)[s, 1]
            seen = scene.known.reflected[0, 1, n].real * 10 ** (loss / 20)
            assert outcome.observation[0, at_user + 35 + n] == pytest.approx(seen, rel=1e-5)


def test_a_film_shows_every_panel(config):
    task = Task(config)
    rollout = record(task, lambda _: np.zeros((1, task.action_size)), 2, 5)
    assert rollout.phases_rad.shape == (2, 35)
    office = task.simulator.world.office(0)
    picture = snapshot(config, office, rollout, 0, width=640, height=480)
    turned = replace(rollout, phases_rad=rollout.phases_rad + np.where(np.arange(35) >= 16, 2.0, 0.0))
    changed = np.abs(picture.astype(int) - snapshot(config, office, turned, 0, width=640, height=480)).max(-1) > 40
    # In words on the left, and on the walls of the room.
    assert changed[:, : round(0.26 * 640)].sum() > 100
    assert changed[:, round(0.26 * 640) :].sum() > 5
