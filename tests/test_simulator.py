import copy
import math
from dataclasses import replace
from typing import Any

import literal
import numpy as np
import pytest

from mjris.config import Config, Hardware, Radio, Task, World, preset
from mjris.planning.radio_map import penalised
from mjris.radio import access, serving
from mjris.radio.powers import qos_or_sum
from mjris.simulation.scene import Slot
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import first_cells


def config(drive: str = "kinematic", task: Task | None = None, layout: str = "office", **radio) -> Config:
    world = World(drive=drive, layout=layout)  # pyright: ignore[reportArgumentType]
    return Config(world=world, radio=Radio(**radio), task=task or Task())


def inputs(simulator: Simulator, rng: np.random.Generator, cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random displacements, phases and powers."""
    radio, users = simulator.config.radio, simulator.config.world.num_users
    phases = rng.uniform(-math.pi, math.pi, (cells, radio.num_elements))
    return rng.uniform(-0.35, 0.35, (cells, 2)), phases, rng.uniform(0, radio.tx_power_w / users, (cells, users))


def play(simulator: Simulator, slots: int, seed: int = 0) -> list[Slot]:
    rng = np.random.default_rng(seed)
    return [simulator.step(*inputs(simulator, rng, simulator.num_cells)) for _ in range(slots)]


def assert_same(a: Slot, b: Slot, cell: int, tolerance: float) -> None:
    """Cell `cell` of slot `a` is the one of slot `b`."""
    np.testing.assert_allclose(a.rates_bps[cell], b.rates_bps[0], rtol=tolerance)
    np.testing.assert_allclose(a.displacement_m[cell], b.displacement_m[0], atol=tolerance)
    np.testing.assert_allclose(a.scene.users_xy[cell], b.scene.users_xy[0], atol=tolerance)
    np.testing.assert_array_equal(a.scene.blockers[cell], b.scene.blockers[0])
    for one, other in zip(a.scene.channels, b.scene.channels, strict=True):
        np.testing.assert_allclose(one[cell], other[0], rtol=0, atol=tolerance * abs(other).max())


@pytest.mark.parametrize(("drive", "tolerance"), [("kinematic", 1e-12), ("wheels", 1e-9)])
@pytest.mark.parametrize("factor", [0.0, 0.5])
def test_cells_together_are_cells_one_by_one(drive, tolerance, factor):
    assert_cells_alone_give_the_same(config(drive, difference_factor=factor, fading_memory=0.7), tolerance)


def test_cells_with_furniture_of_their_own_are_cells_one_by_one():
    world = World(drive="kinematic", layout="open", layout_jitter_m=0.3, body_blockage=True)
    assert_cells_alone_give_the_same(Config(world=world, radio=Radio(decoding_order="static")), 1e-12)


def assert_cells_alone_give_the_same(settings: Config, tolerance: float) -> None:
    together = Simulator(settings, cells=3)
    rng = np.random.default_rng(6)
    commands = [inputs(together, rng, 3) for _ in range(8)]
    slots = [together.step(*command) for command in commands]
    for cell in range(3):
        single = Simulator(settings, [first_cells(settings, 3)[cell]])
        for slot, command in zip(slots, commands, strict=True):
            move, phases, powers = (part[cell : cell + 1] for part in command)
            assert_same(slot, single.step(move, phases, powers), cell, tolerance)


def blocked_fading(simulator: Simulator) -> np.ndarray:
    """Small-scale fading of the direct channels [E, K, M] where the link is blocked, NaN elsewhere."""
    scene = simulator.scene
    direct = scene.channels.direct * 10 ** (scene.path_loss_db[:, :4, None] / 20)
    return np.where(scene.blockers[:, :4, None] > 0, direct, np.nan)


def fading_of_two_cells(factor: float) -> tuple[np.ndarray, np.ndarray]:
    simulator = Simulator(config(difference_factor=factor), cells=16)
    pairs = []
    for _ in range(40):
        play(simulator, 1)
        fading = blocked_fading(simulator)
        pairs.append(np.stack([fading[:-1], fading[1:]]).reshape(2, -1))
    pairs = np.concatenate(pairs, 1)
    first, second = pairs[:, ~np.isnan(pairs).any(0)]
    assert first.size > 300
    return first, second


def test_difference_factor_zero_is_the_same_fading_in_all_cells():
    np.testing.assert_allclose(*fading_of_two_cells(0.0), atol=1e-9)


@pytest.mark.parametrize("factor", [0.4, 1.0])
def test_difference_factor_is_what_correlation_lacks(factor):
    first, second = fading_of_two_cells(factor)
    # Pairs overlap and a shared draw serves all cells, so that few are independent: a loose bound.
    assert abs(np.mean(first * second.conj()) - (1 - factor)) < 0.1
    assert np.mean(abs(first) ** 2) == pytest.approx(1, abs=0.15)


def test_frozen_fading():
    still = replace(World(drive="kinematic"), walk_scale_m=0.0)
    frozen = Simulator(Config(world=still, radio=Radio(fading_memory=1.0)), cells=2)
    fresh = Simulator(Config(world=still, radio=Radio(fading_memory=0.0)), cells=2)
    rest = np.zeros((2, 2)), np.zeros((2, 16)), np.full((2, 4), 0.025)
    for simulator, same in [(frozen, True), (fresh, False)]:
        before = simulator.scene.channels
        after = simulator.step(*rest).scene.channels
        assert [np.allclose(a, b, rtol=1e-12, atol=0) for a, b in zip(before, after, strict=True)] == [same] * 3
        simulator.reset()
        assert not np.allclose(simulator.scene.channels.incident, after.incident, rtol=1e-3, atol=0)


def standing(num_cells: int, rician_k_db: float, memory: float) -> Simulator:
    """Cells whose people stay where they are."""
    world = World(drive="kinematic", walk_scale_m=0.0)
    return Simulator(Config(world=world, radio=Radio(rician_k_db=rician_k_db, fading_memory=memory)), num_cells)


def direct_fading(simulator: Simulator, slots: int) -> np.ndarray:
    """Small-scale fading of the direct channels while nothing moves, [T, E, K, M]."""
    rest = np.zeros((simulator.num_cells, 2)), np.zeros((simulator.num_cells, 16)), np.full((simulator.num_cells, 4), 0)
    amplitude = 10 ** (simulator.scene.path_loss_db[:, :4, None] / 20)
    return np.stack([simulator.step(*rest).scene.channels.direct * amplitude for _ in range(slots)])


@pytest.mark.parametrize("memory", [0.0, 0.6])
def test_fading_memory_is_the_correlation_of_blocked_links_over_the_slots(memory):
    simulator = standing(8, 7.0, memory)
    fading = direct_fading(simulator, 400)[:, simulator.scene.blockers[:, :4] > 0]
    assert fading.shape[1] >= 4
    for lag in (1, 3):
        assert np.mean(fading[lag:] * fading[:-lag].conj()) == pytest.approx(memory**lag, abs=0.1)
    assert np.mean(abs(fading) ** 2) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("k_db", [0.0, 7.0])
def test_links_in_sight_have_the_k_factor(k_db):
    simulator = standing(8, k_db, 0.0)
    fading = direct_fading(simulator, 400)[:, simulator.scene.blockers[:, :4] == 0]
    assert fading.shape[1] >= 4
    constant, scattered = np.mean(abs(fading.mean(0)) ** 2), np.mean(fading.var(0))
    assert 10 * np.log10(constant / scattered) == pytest.approx(k_db, abs=0.4)
    assert constant + scattered == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("pattern", ["isotropic", "cosine"])
def test_channels_in_sight_are_path_lengths_and_patterns(pattern):
    simulator = Simulator(config(layout="open", rician_k_db=60.0, element_pattern=pattern), cells=3)
    world, wavelength = simulator.config.world, 299_792_458 / 2e9
    scene = play(simulator, 4)[-1].scene
    seen = 0
    for e in range(3):
        ap, facing = simulator.world.office(e).ap_position, simulator.world.office(e).layout.ap.facing
        turn = scene.panel_heading[e]
        line = np.array([-math.sin(facing), math.cos(facing), 0])
        antennas = [ap + (m - 1.5) * wavelength / 2 * line for m in range(4)]
        panel = np.array([*scene.rover_xy[e], world.panel_height_m])
        across = np.array([-math.sin(turn), math.cos(turn), 0])
        elements = [
            panel + ((col - 1.5) * across + np.array([0, 0, row - 1.5])) * wavelength / 2
            for row in range(4)
            for col in range(4)
        ]
        users = [np.array([*xy, world.user_height_m]) for xy in scene.users_xy[e]]

        def gain(end: np.ndarray, panel=panel, turn=turn) -> float:
            cosine = float((end - panel) @ [math.cos(turn), math.sin(turn), 0]) / math.dist(end, panel)
            return 1 if pattern == "isotropic" else 2 * 1.57 * max(cosine, 0) ** 0.57

        links = [(scene.channels.direct[e, k], [user], antennas, 1) for k, user in enumerate(users)]
        links += [(scene.channels.reflected[e, k], [user], elements, gain(user)) for k, user in enumerate(users)]
        links += [(scene.channels.incident[e], elements, antennas, gain(ap))]
        for link, (got, ends, starts, pattern_gain) in enumerate(links):
            if scene.blockers[e, link] == 0:
                amplitude = 10 ** (-scene.path_loss_db[e, link] / 20) * math.sqrt(pattern_gain)
                expected = [
                    [amplitude * np.exp(-2j * np.pi * math.dist(a, b) / wavelength) for b in starts] for a in ends
                ]
                # The diffuse part is 60 dB below.
                np.testing.assert_allclose(got.reshape(len(ends), -1), expected, rtol=0, atol=6e-3 * amplitude)
                seen += 1
    assert seen > 15


def test_static_order_is_that_of_the_first_slot():
    simulator = Simulator(config(decoding_order="static"), cells=4)
    radio, rng = simulator.config.radio, np.random.default_rng(1)
    differs = 0
    for _ in range(2):
        order = None
        for _ in range(8):
            move, phases, powers = inputs(simulator, rng, 4)
            effective = simulator.effective_channel(phases)
            if order is None:
                order = access.decoding_order(effective, powers, simulator.clusters, radio.noise_w)
            noma = effective, powers, simulator.clusters, radio.bandwidth_hz, radio.noise_w
            expected, dynamic = access.noma_rates(*noma, order), access.noma_rates(*noma)
            np.testing.assert_allclose(simulator.step(move, phases, powers).rates_bps, expected, rtol=1e-12)
            differs += not np.allclose(expected, dynamic)
        simulator.reset()
    assert differs > 4


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_without_ris_only_the_direct_channel_counts(scheme):
    simulator = Simulator(config(task=Task(ris="none"), scheme=scheme), cells=3)
    rng = np.random.default_rng(2)
    move, phases, powers = inputs(simulator, rng, 3)
    direct = simulator.scene.channels.direct
    np.testing.assert_array_equal(simulator.effective_channel(phases), direct)
    rates = access.noma_rates if scheme == "noma" else access.oma_rates
    radio = simulator.config.radio
    expected = rates(direct, powers, simulator.clusters, radio.bandwidth_hz, radio.noise_w)
    np.testing.assert_allclose(simulator.step(move, phases, powers).rates_bps, expected, rtol=1e-12)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_bare_rates_are_those_without_ris_under_the_reference_powers(scheme):
    simulator = Simulator(config(scheme=scheme, task=Task(reward="gain")), cells=3)
    radio, task = simulator.config.radio, simulator.config.task
    direct = simulator.scene.channels.direct
    powers, _ = qos_or_sum(serving.System.of(radio, simulator.clusters, task.qos_bps), direct)
    rates = access.noma_rates if scheme == "noma" else access.oma_rates
    expected = rates(direct, powers, simulator.clusters, radio.bandwidth_hz, radio.noise_w)
    bare_bps = play(simulator, 1)[0].bare_rates_bps
    np.testing.assert_allclose(bare_bps, expected, rtol=1e-9)


def test_one_user_and_one_antenna_in_watts_and_hertz():
    settings = Config(
        world=World(drive="kinematic", num_users=1),
        radio=Radio(num_antennas=1, num_clusters=1, bandwidth_hz=3e6, tx_power_dbm=23.0, noise_dbm_per_mhz=-40.0),
    )
    simulator = Simulator(settings)
    phases = np.linspace(-3, 3, 16)[None]
    direct, incident, reflected = simulator.scene.channels
    gain = abs(direct[0, 0, 0] + (reflected[0, 0] * np.exp(1j * phases[0])) @ incident[0, :, 0]) ** 2
    snr = 0.19952623 * gain / 3e-7
    slot = simulator.step(np.zeros((1, 2)), phases, np.array([[settings.radio.tx_power_w]]))
    assert slot.rates_bps[0, 0] == pytest.approx(3e6 * math.log2(1 + snr), rel=1e-6)


@pytest.mark.parametrize("carrier_hz", [2e9, 5e9])
def test_path_losses_are_the_papers_formulas_at_the_scenes_distances(carrier_hz):
    simulator = Simulator(config(carrier_hz=carrier_hz), cells=6)
    world = simulator.config.world
    for slot in play(simulator, 5):
        scene = slot.scene
        for e in range(6):
            ap = np.array(simulator.world.office(e).layout.ap.position)
            panel = np.array([*scene.rover_xy[e], world.panel_height_m])
            users = [np.array([*xy, world.user_height_m]) for xy in scene.users_xy[e]]
            ends = [(ap, user) for user in users] + [(panel, user) for user in users] + [(ap, panel)]
            for (a, b), n, loss in zip(ends, scene.blockers[e], scene.path_loss_db[e], strict=True):
                assert loss == pytest.approx(literal.path_loss_db("paper", math.dist(a, b), n, carrier_hz), abs=1e-9)


def test_mean_power_of_the_channels_is_path_loss_and_pattern():
    simulator = Simulator(config(layout="open", element_pattern="isotropic"), cells=16)
    ratios = []
    for slot in play(simulator, 30):
        gain = 10 ** (-slot.scene.path_loss_db / 10)
        direct, incident, reflected = (np.mean(abs(part) ** 2, -1) for part in slot.scene.channels)
        ratios.append(
            [(direct / gain[:, :4]).mean(), (reflected / gain[:, 4:8]).mean(), (incident.mean(-1) / gain[:, 8]).mean()]
        )
    np.testing.assert_allclose(np.mean(ratios, 0), 1, atol=0.05)


def test_seeds_reproduce_and_differ():
    simulator = Simulator(config(difference_factor=0.5), cells=2)
    runs = []
    for seed in (5, 5, 6):
        simulator.seed(seed)
        simulator.reset()
        runs.append(play(simulator, 3)[-1])
    np.testing.assert_array_equal(runs[0].rates_bps, runs[1].rates_bps)
    np.testing.assert_array_equal(runs[0].scene.channels.reflected, runs[1].scene.channels.reflected)
    assert not np.allclose(runs[0].rates_bps, runs[2].rates_bps)


def test_resetting_one_cell_leaves_the_others_where_they_are():
    simulator = Simulator(config(), cells=3)
    before = play(simulator, 3)[-1].scene
    after = simulator.reset(np.array([1]))
    for cell, same in [(0, True), (1, False), (2, True)]:
        assert np.array_equal(before.users_xy[cell], after.users_xy[cell]) == same
        assert np.array_equal(before.rover_xy[cell], after.rover_xy[cell]) == same
        assert np.allclose(before.channels.direct[cell], after.channels.direct[cell], rtol=1e-12, atol=0) == same
    np.testing.assert_allclose(after.rover_xy[1], simulator.world.office(1).layout.start)


def test_the_panel_faces_between_access_point_and_users():
    simulator = Simulator(config(), cells=4)
    for slot in play(simulator, 3):
        for e in range(4):
            here = complex(*slot.scene.rover_xy[e])
            ap = complex(*simulator.ap_position[e, :2]) - here
            users = np.mean([(complex(*xy) - here) / abs(complex(*xy) - here) for xy in slot.scene.users_xy[e]])
            middle = ap / abs(ap) + users / abs(users)
            assert abs(np.exp(1j * slot.scene.panel_heading[e]) - middle / abs(middle)) < 1e-9


def test_arrays_of_any_size_leave_places_and_steps_as_they_are():
    small, large = (
        Simulator(config(layout="open", difference_factor=1.0, panel_cols=columns, num_antennas=antennas), cells=2)
        for columns, antennas in ((2, 2), (8, 4))
    )
    for simulator in (small, large):
        for _ in range(3):
            parked = np.zeros((2, 2))
            simulator.step(parked, np.zeros((2, simulator.config.radio.num_elements)), np.zeros((2, 4)))
    np.testing.assert_array_equal(small.scene.users_xy, large.scene.users_xy)


@pytest.mark.parametrize("wrong", ["displacement_m", "phases_rad", "powers_w", "pan_rad"])
def test_what_is_not_finite_or_of_another_shape_is_refused(wrong):
    simulator = Simulator(config(), cells=3)
    good: dict[str, Any] = {
        "displacement_m": np.zeros((3, 2)),
        "phases_rad": np.zeros((3, 16)),
        "powers_w": np.zeros((3, 4)),
        "pan_rad": np.zeros(3),
    }
    scene = simulator.scene
    for value in (np.nan, np.inf):
        bad: dict[str, Any] = good | {
            wrong: np.where(np.arange(good[wrong].size) == 2, value, 0).reshape(good[wrong].shape)
        }
        with pytest.raises(ValueError, match=f"{wrong}: {value} in entry .* of cell .* is not allowed"):
            simulator.step(**bad)
    for shape in ((2, *good[wrong].shape[1:]), (3, 5), ()):
        bad = good | {wrong: np.zeros(shape)}
        with pytest.raises(ValueError, match=f"{wrong}: an array of shape"):
            simulator.step(**bad)
    assert simulator.scene is scene
    simulator.step(**good)


def static(**fields) -> Config:
    return config(decoding_order="static", **fields)


def test_the_closed_forms_know_the_static_order():
    """In its first slot an episode's order is that of the gains; later, what is allocated is what that order gives."""
    simulator = Simulator(static(task=Task(qos_bps=2e3)), cells=48)
    moves, better = np.zeros((48, 2)), []
    for slot in range(6):
        order = simulator.order.copy()
        assert (order < 0).all() == (slot == 0)
        phases = simulator.random_phases()  # closed-form ones would choose who is the strongest
        effective = simulator.effective_channel(phases)
        powers, promised = simulator.reference_powers(effective, None, order)
        result = simulator.step(moves, phases, powers)
        np.testing.assert_allclose(result.rates_bps, promised, rtol=1e-9)
        if slot:
            np.testing.assert_array_equal(simulator.order, order)
            # Who does not know the order gets less out of it wherever that is not the order of the gains.
            unaware, _ = simulator.reference_powers(effective)
            kept = simulator.rates(effective, unaware, order)
            better.append(penalised(promised, 2e3, 2.0) - penalised(kept, 2e3, 2.0))
    assert np.min(better) >= -1e-3
    assert np.max(better) > 1e3


def test_a_static_order_does_not_matter_where_one_user_of_a_cluster_has_all():
    simulator = Simulator(static(), cells=8)
    play(simulator, 3)
    powers = np.zeros((8, 4))
    powers[:, [1, 2]] = 0.05
    effective = simulator.effective_channel(np.zeros((8, 16)))
    dynamic = simulator.rates(effective, powers)
    np.testing.assert_array_equal(simulator.rates(effective, powers, simulator.order), dynamic)
    np.testing.assert_array_equal(simulator.rates(effective, powers, simulator.order[..., ::-1].copy()), dynamic)


def held(updates: int, **world) -> Config:
    made = config("kinematic", Task(phase_updates_per_slot=updates))
    return replace(made, world=replace(made.world, **world))


def test_phases_that_are_held_see_what_a_plain_loop_over_the_ticks_sees():
    """Tick by tick, by a simulator whose slots are that short and whose people go on in one direction."""
    still = {"walk_scale_m": 0.0, "bumper_m": 0.25, "clearance_m": 0.25, "pan": "locked"}
    simulator = Simulator(held(2, ticks_per_slot=4, **still), cells=3)
    fast = Simulator(held(0, ticks_per_slot=1, slot_s=0.25, **still), cells=3)
    fast.world.crowd.place(np.arange(3), simulator.world.crowd.xy)
    fast.world.fleet.place(np.arange(3), simulator.world.fleet.xy, simulator.world.fleet.heading)
    memory = math.cos(math.acos(simulator.config.radio.fading_memory) / 4)
    diffuse = simulator._diffuse.copy()
    fresh = Simulator(held(2, ticks_per_slot=4, **still), cells=3)._draw_diffuse(np.arange(3))
    assert memory == pytest.approx(math.cos(math.pi / 8))
    asked, seen = [], []

    def retune(channels):
        asked.append(channels)
        return np.full((3, 16), 0.5), np.full((3, 4), 0.02)

    phases, powers, move = np.zeros((3, 16)), np.full((3, 4), 0.01), np.tile([0.4, 0.3], (3, 1))
    slot = simulator.step(move, phases, powers, None, retune)
    expected = np.zeros((3, 4))
    for tick in range(4):
        angle = tick / 4 * math.pi / 2
        fast._diffuse = math.cos(angle) * diffuse + math.sin(angle) * fresh
        channels = fast.look().channels
        seen.append(channels)
        if tick == 2:
            phases, powers = np.full((3, 16), 0.5), np.full((3, 4), 0.02)
        response = np.exp(1j * phases)
        effective = channels.direct + (channels.reflected * response[:, None]) @ channels.incident
        clusters, radio = fast.clusters, fast.config.radio
        expected += access.noma_rates(effective, powers, clusters, radio.bandwidth_hz, radio.noise_w) / 4
        fast.world.fleet.place(np.arange(3), fast.world.fleet.xy + move / 4, np.arctan2(move[:, 1], move[:, 0]))
    assert len(asked) == 1
    np.testing.assert_allclose(asked[0].reflected, seen[2].reflected, rtol=1e-6)
    np.testing.assert_allclose(slot.rates_bps, expected, rtol=1e-6)
    assert len(slot.channels) == 4
    np.testing.assert_allclose(slot.channels[3].direct, seen[3].direct, rtol=1e-6)


def test_phases_that_are_held_lose_and_updates_bring_it_back():
    """Closed forms over no RIS, in the very same slots: the more often they are set, the more they gain."""
    gains = []
    for updates in (0, 1, 10):
        simulator = Simulator(held(updates), cells=24)

        def retune(channels, simulator=simulator):
            phases = simulator.reference_phases(None, channels)
            effective = simulator.effective_channel(phases, channels)
            return phases, simulator.reference_powers(effective, None, simulator.order)[0]

        total = np.zeros(2)
        for _ in range(8):
            phases, powers = retune(simulator.scene.channels)
            slot = simulator.step(np.zeros((24, 2)), phases, powers, None, retune)
            total += slot.rates_bps.sum(), slot.bare_rates_bps.sum()
        gains.append(total[0] / total[1] - 1)
    assert gains[1] < gains[2]
    assert gains[1] < gains[0]


@pytest.mark.parametrize("pan", ["auto", "action"])
def test_a_fixed_panel_faces_the_room_for_good_and_a_turning_one_its_users(pan):
    headings = {}
    for ris in ("fixed", "turning"):
        made = config(task=Task(ris=ris), layout="clinic")
        simulator = Simulator(replace(made, world=replace(made.world, pan=pan, start_m=(5.0, 8.0))), 3)
        rng, turn = np.random.default_rng(0), np.full(3, 0.3)
        seen = [simulator.scene.panel_heading]
        for _ in range(3):
            _, phases, powers = inputs(simulator, rng, 3)
            slot = simulator.step(np.zeros((3, 2)), phases, powers, turn if pan == "action" else None)
            seen.append(slot.scene.panel_heading)
        headings[ris] = np.exp(1j * np.array(seen))
    start = simulator.world.start
    ap, middle = simulator.ap_position[0, :2], simulator.room_m[0] / 2
    facing = (ap - start) / np.linalg.norm(ap - start) + (middle - start) / np.linalg.norm(middle - start)
    np.testing.assert_allclose(headings["fixed"], complex(*facing) / np.linalg.norm(facing), atol=1e-9)
    assert (np.abs(np.diff(headings["turning"], axis=0)) > 1e-6).all()


def quiet(**hardware) -> Simulator:
    made = preset("classic")
    return Simulator(replace(made, radio=replace(made.radio, surface=Hardware(**hardware)), seed=4), 3)


def test_dead_elements_reflect_nothing_and_are_others_in_every_cell():
    simulator = quiet(dead_share=0.25)
    assert (simulator.dead.sum(1) == 4).all()
    assert len({tuple(own) for own in simulator.dead.tolist()}) == 3
    for _ in range(2):
        scene, phases = simulator.scene, np.random.default_rng(0).uniform(-3, 3, (3, 16))
        assert (scene.channels.incident[simulator.dead] == 0).all()
        assert (scene.channels.incident[~simulator.dead] != 0).all()
        turned = np.where(simulator.dead, phases + 1, phases)
        same = simulator.effective_channel(turned)
        np.testing.assert_array_equal(same, simulator.effective_channel(phases))
        simulator.step(np.zeros((3, 2)), phases, np.full((3, 4), 0.02))


def test_phase_noise_is_missed_by_whoever_decides():
    """The same scenes with and without: what is known stays, and rates are those of phases that are off."""
    plain, noisy = quiet(), quiet(phase_noise_deg=40.0)
    phases, powers = plain.reference_phases(), np.full((3, 4), 0.02)
    np.testing.assert_array_equal(noisy.reference_phases(), phases)
    missed = copy.deepcopy(noisy._streams).phase_noise(16, math.radians(40.0))
    assert missed.std() == pytest.approx(math.radians(40.0), rel=0.3)
    known, truth = noisy.effective_channel(phases), noisy.effective_channel(phases + missed)
    expected = noisy.rates(truth, powers, None, known)
    np.testing.assert_allclose(noisy.step(np.zeros((3, 2)), phases, powers).rates_bps, expected, rtol=1e-9)
    ideal = plain.step(np.zeros((3, 2)), phases, powers).rates_bps
    assert (abs(expected / ideal - 1) > 1e-3).sum() > 3


def test_nothing_else_changes_with_hardware_that_is_ideal_in_the_end():
    """Streams of noise and of dead elements are their own: places and fading stay as they are."""
    plain, noisy = quiet(), quiet(phase_noise_deg=20.0, dead_share=0.25, phase_bits=2)
    for simulator in (plain, noisy):
        simulator.step(np.full((3, 2), 0.2), np.zeros((3, 16)), np.full((3, 4), 0.02))
    np.testing.assert_array_equal(plain.scene.users_xy, noisy.scene.users_xy)
    np.testing.assert_array_equal(plain.scene.channels.direct, noisy.scene.channels.direct)
    np.testing.assert_array_equal(plain.scene.channels.reflected, noisy.scene.channels.reflected)
