"""What is known of channels and places: errors and ages as they are said to be, and what they cost."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from mjris.config import Config, ConfigError, Knowledge, Radio, World, preset
from mjris.eval.playing import play
from mjris.eval.policies import no_ris, reference_controls
from mjris.radio import knowledge
from mjris.radio.fading import complex_normal
from mjris.simulation.simulator import Simulator

CELLS = 40


def config(knows: Knowledge | None = None, *, walk_scale_m=0.3, **task) -> Config:
    made = preset("classic")
    radio = replace(made.radio, difference_factor=1.0, knowledge=knows or Knowledge(), panel_rows=8, panel_cols=8)
    world = replace(made.world, walk_scale_m=walk_scale_m)
    return replace(made, world=world, radio=radio, task=replace(made.task, **task), seed=1)


def stepped(made: Config, displacement=(0.2, 0.1), slots=3) -> Simulator:
    simulator = Simulator(made, CELLS)
    phases, powers = np.zeros((CELLS, simulator.num_elements)), np.zeros((CELLS, 4))
    for _ in range(slots):
        simulator.step(np.tile(displacement, (CELLS, 1)), phases, powers)
    return simulator


def relative_errors(simulator: Simulator) -> list[np.ndarray]:
    """Of every link's entries, over its mean power [L][entries, all cells]."""
    scene, found = simulator.scene, [[] for _ in range(simulator.scene.mean_gain.shape[1])]
    for known, true, link_of in zip(scene.known, scene.channels, simulator.link_of, strict=True):
        power = scene.mean_gain[:, link_of]
        error = np.where(power > 0, abs(known - true) ** 2 / np.where(power > 0, power, 1), np.nan)
        for link in np.unique(link_of):
            found[link].append(error[:, link_of == link].ravel())
    return [np.concatenate(each) for each in found]


def test_by_default_all_is_known():
    scene = stepped(config()).scene
    assert scene.known is scene.channels
    np.testing.assert_array_equal(scene.known_users_xy, scene.users_xy)


@pytest.mark.parametrize("nmse_db", [-20.0, 0.0])
def test_the_error_is_the_share_of_the_mean_power_that_it_is_said_to_be(nmse_db):
    for error in relative_errors(stepped(config(Knowledge(nmse_db=nmse_db)))):
        assert np.nanmean(error) == pytest.approx(10 ** (nmse_db / 10), rel=0.25)


@given(st.integers(0, 2**32 - 1), st.floats(-1, 1))
def test_aged_fading_has_its_correlation_and_power(seed, correlation):
    rng = np.random.default_rng(seed)
    diffuse, innovation = complex_normal(rng, (2, 20_000))
    old = knowledge.aged(diffuse, innovation, np.array(correlation))
    assert np.mean(abs(old) ** 2) == pytest.approx(1, abs=0.05)
    assert np.mean((old * diffuse.conj()).real) == pytest.approx(correlation, abs=0.05)


def test_clarke_is_bessels_function():
    assert knowledge.clarke(np.array(0.0), 0.1) == 1
    assert knowledge.clarke(np.array(0.1 * 2.404825557695773 / (2 * np.pi)), 0.1) == pytest.approx(0, abs=1e-12)


def test_age_costs_what_the_ends_of_a_link_have_moved():
    age_s = 0.04
    simulator = stepped(config(Knowledge(age_s=age_s), walk_scale_m=0.0), displacement=(0.3, 0.0))
    errors = relative_errors(simulator)
    # Nobody walks: the direct links are known as they are.
    assert all(np.nanmax(errors[link]) < 1e-20 for link in range(4))
    # The rover came some 0.3 m in the last slot, 12 mm in the age; behind obstacles all is diffuse.
    link, users = simulator.links.reflected, np.arange(4)
    before = simulator._knowing._before
    assert before is not None
    moved = age_s * np.linalg.norm(simulator.world.fleet.xy - before.panels[:, 0, :2], axis=1)
    assert np.median(moved) == pytest.approx(age_s * 0.3, rel=0.05)
    power = abs(simulator.scene.known.reflected - simulator.scene.channels.reflected) ** 2
    gain, blocked = simulator.scene.mean_gain[:, link], simulator.scene.blockers[:, link] > 0
    blocked &= gain > 0
    error = power.mean(-1)[blocked] / gain[blocked]
    correlation = special.j0(2 * np.pi * np.repeat(moved[:, None], len(users), 1) / simulator.config.radio.wavelength_m)
    assert blocked.sum() > 20
    assert error.mean() == pytest.approx(np.mean(2 * (1 - correlation[blocked])), rel=0.1)


def test_what_is_old_was_true_then():
    """With fading that stays and a whole slot of age: those of the slot before, but for its losses."""
    frozen = config(Knowledge(age_s=1.0), walk_scale_m=0.0)
    frozen = replace(frozen, radio=replace(frozen.radio, fading_memory=1.0, rician_k_db=60.0))
    simulator = stepped(frozen, slots=2)
    before = simulator.scene
    simulator.step(np.tile((0.2, 0.0), (CELLS, 1)), np.zeros((CELLS, 64)), np.zeros((CELLS, 4)))
    now, sight = simulator.scene, simulator.links.incident
    clear = (before.blockers[:, sight] == 0)[:, 0] & (now.blockers[:, sight] == 0)[:, 0]
    assert clear.sum() > 5
    ratio = now.known.incident[clear] / before.channels.incident[clear]
    np.testing.assert_allclose(np.angle(ratio), 0, atol=0.02)


def test_from_positions_alone_channels_are_straight_paths():
    simulator = stepped(config(Knowledge(source="positions", position_error_m=0.5)))
    scene = simulator.scene
    offset = scene.known_users_xy - scene.users_xy
    inside = ((scene.known_users_xy > 0) & (scene.known_users_xy < simulator.room_m[:, None])).all(-1)
    assert offset[inside].std() == pytest.approx(0.5, rel=0.15)
    e, k, n = 3, 2, 17
    elements = simulator.links
    power = scene.mean_gain[e, elements.reflected][k]
    assert abs(scene.known.reflected[e, k, n]) ** 2 == pytest.approx(power, rel=1e-6)
    assert abs(scene.known.direct[e, k]) == pytest.approx(np.sqrt(scene.mean_gain[e, k]), rel=1e-6)


def test_pilots_and_control_cost_their_share_of_the_rate():
    plain, costly = (stepped(config(knows)) for knows in (Knowledge(), Knowledge(pilot_s=2e-3, control_s=0.05)))
    rng = np.random.default_rng(0)
    phases, powers = rng.uniform(-3, 3, (CELLS, 64)), np.full((CELLS, 4), 0.02)
    still = np.zeros((CELLS, 2))
    free, net = (simulator.step(still, phases, powers) for simulator in (plain, costly))
    np.testing.assert_allclose(net.rates_bps, (1 - 64 * 2e-3 - 0.05) * free.rates_bps, rtol=1e-12)
    np.testing.assert_array_equal(net.bare_rates_bps, free.bare_rates_bps)
    assert costly.net_share == pytest.approx(1 - 64 * 2e-3 - 0.05)


def test_knowing_less_never_pays():
    values = []
    for knows in (Knowledge(), Knowledge(nmse_db=-5.0), Knowledge(nmse_db=5.0), Knowledge(source="positions")):
        values.append(play(config(knows, slots=6), reference_controls(), 24, 7).value_bps.mean())
    assert values[0] > values[1] > values[2]
    assert values[0] > values[3]
    bare = [
        play(config(knows, slots=4), no_ris(), 8, 7).sum_rate_bps.mean()
        for knows in (Knowledge(), Knowledge(pilot_s=1e-3))
    ]
    assert bare[0] == bare[1]


def test_the_same_seed_knows_the_same_and_part_of_the_cells_may_begin_anew():
    knows = Knowledge(nmse_db=-3.0, age_s=0.1, position_error_m=0.3)
    first, second = (stepped(config(knows)) for _ in range(2))
    np.testing.assert_array_equal(first.scene.known.incident, second.scene.known.incident)
    before = first.scene
    first.reset(np.array([0]))
    for known, kept in zip(first.scene.known, before.known, strict=True):
        np.testing.assert_array_equal(known[1:], kept[1:])
        assert (known[0] != kept[0]).any()


def test_parts_of_a_slot_know_what_is_old_by_then():
    made = config(Knowledge(age_s=0.3, nmse_db=-10.0), phase_updates_per_slot=5)
    slot = Simulator(made, 3).step(np.full((3, 2), 0.2), np.zeros((3, 64)), np.full((3, 4), 0.02))
    assert np.isfinite(slot.rates_bps).all()
    assert len(slot.channels) == 10


def test_what_cannot_be_is_refused():
    with pytest.raises(ConfigError, match=r"radio.knowledge.age_s: 2.0 is not allowed"):
        Config(radio=Radio(knowledge=Knowledge(age_s=2.0)))
    with pytest.raises(ConfigError, match=r"radio.knowledge.nmse_db: -3.0 is not allowed: with radio.knowledge.source"):
        Knowledge(source="positions", nmse_db=-3.0)
    with pytest.raises(ConfigError, match=r"radio.knowledge.pilot_s: 0.1 is not allowed: with 16 elements"):
        Simulator(Config(world=World(drive="kinematic"), radio=Radio(knowledge=Knowledge(pilot_s=0.1))), 1)
