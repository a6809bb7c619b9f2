import numpy as np
import pytest

from mjris.config import Config, Radio, World
from mjris.envs.gym_env import OfficeEnv
from mjris.radio import access
from mjris.radio.serving import System
from mjris.simulation.constraints import NAMES, ascending, evaluate, within_budget, within_room
from mjris.simulation.simulator import Simulator

CLUSTERS = np.array([[0, 1], [2, 3]])


def simulator(num_cells: int = 4, **radio) -> Simulator:
    return Simulator(Config(world=World(drive="kinematic"), radio=Radio(**radio)), num_cells)


def commands(made: Simulator, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random displacements, phases and powers within their limits."""
    radio, cells = made.config.radio, made.num_cells
    phases = rng.uniform(-np.pi, np.pi, (cells, radio.num_elements))
    return rng.uniform(-0.35, 0.35, (cells, 2)), phases, rng.uniform(0, radio.tx_power_w / 4, (cells, 4))


def test_the_hull_must_be_inside_the_room():
    places = np.array([[0.25, 3.0], [0.2499, 3.0], [9.75, 3.0], [9.7501, 3.0], [5.0, 0.1], [5.0, 5.8], [-1.0, 3.0]])
    inside = within_room(places, 0.25, np.array([10.0, 6.0]))
    assert inside.tolist() == [True, False, True, False, False, False, False]


def test_rooms_of_several_cells_differ():
    inside = within_room(np.array([[7.0, 3.0], [7.0, 3.0]]), 0.25, np.array([[10.0, 6.0], [7.0, 6.0]]))
    assert inside.tolist() == [True, False]


@pytest.mark.parametrize(
    ("scheme", "powers", "kept"),
    [
        ("noma", [0.05, 0.0, 0.02, 0.03], True),
        ("noma", [0.05, 1e-9, 0.02, 0.03], False),  # 2e-8 above the cluster's share
        ("noma", [0.05, 1e-12, 0.02, 0.03], True),  # rounding
        ("noma", [0.06, 0.02, 0.0, 0.01], False),  # one cluster too much, the whole of it too little
        ("noma", [0.06, -0.02, 0.0, 0.01], False),
        ("oma", [0.025, 0.025, 0.025, 0.025], True),
        ("oma", [0.03, 0.0, 0.0, 0.0], False),
    ],
)
def test_power_of_a_cluster_by_hand(scheme, powers, kept):
    assert within_budget(np.array([powers]), CLUSTERS, scheme, 0.1).tolist() == [kept]


def test_clusters_need_not_be_in_the_order_of_the_users():
    powers = np.array([[0.04, 0.04, 0.01, 0.01]])
    assert not within_budget(powers, CLUSTERS, "noma", 0.1)[0]
    assert within_budget(powers, np.array([[0, 2], [3, 1]]), "noma", 0.1)[0]


def test_an_order_must_ascend_in_every_cluster():
    gains = np.array([[1.0, 2.0, 4.0, 3.0]] * 3)
    orders = np.array([[[0, 1], [3, 2]], [[1, 0], [3, 2]], [[0, 1], [2, 3]]])
    assert ascending(gains, np.ones((3, 4)), orders).tolist() == [True, False, False]
    assert ascending(np.ones((1, 4)), np.ones((1, 4)), orders[:1]).all()  # equal gains may be decoded either way
    # Who has no power decodes nothing, and nothing of theirs is decoded.
    powers = np.array([[1.0, 1, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1]])
    assert ascending(gains, powers, orders).all()
    three, wrong = np.array([[1.0, 3.0, 2.0]]), np.array([[[0, 1, 2]]])
    assert not ascending(three, np.ones((1, 3)), wrong)[0]
    assert ascending(three, np.array([[1.0, 0, 1]]), wrong)[0]


def test_every_constraint_is_reported_on_its_own():
    config = Config()
    arguments = {
        "rover_xy": np.array([[5.0, 5.0]]),
        "hull_radius_m": 0.25,
        "room_m": np.array([[10.0, 10.0]]),
        "effective": np.diag([1.0 + 0j, 2.0, 3.0, 4.0])[None],
        "known": np.diag([1.0 + 0j, 2.0, 3.0, 4.0])[None],
        "powers_w": np.full((1, 4), 0.02),
        "order": np.array([[[0, 1], [2, 3]]]),
        "rates_bps": np.full((1, 4), 1e4),
        "collisions": np.array([0]),
    }
    # Beams are zero-forced on users 1 and 3, whom the beam of the other cluster does not reach.
    broken = {
        "in_room": {"rover_xy": np.array([[5.0, 9.9]])},
        "power": {"powers_w": np.full((1, 4), 0.03)},
        "decoding_order": {"order": np.array([[[0, 1], [3, 2]]])},
        "qos": {"rates_bps": np.array([[1e4, 1e4, 9999.0, 1e4]])},
        "collision_free": {"collisions": np.array([2])},
    }
    assert all(evaluate(config, System.of(config.radio, CLUSTERS, 0.0), **arguments).by_cell()[0].values())
    assert tuple(broken) == NAMES
    for name, change in broken.items():
        kept = evaluate(config, System.of(config.radio, CLUSTERS, 0.0), **(arguments | change)).by_cell()[0]
        assert [each for each, value in kept.items() if not value] == [name]


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_room_and_power_of_a_slot_are_those_of_the_array_functions(scheme):
    rng, config = np.random.default_rng(4), Config(radio=Radio(scheme=scheme))
    places, room = rng.uniform(-1, 11, (200, 2)), rng.uniform(8, 10, (200, 2))
    powers = rng.uniform(-0.001, 0.026 if scheme == "oma" else 0.06, (200, 4))
    channel = np.ones((200, 4, 4), complex)
    arguments = {"effective": channel, "known": channel, "order": None, "collisions": np.zeros(200, int)}
    kept = evaluate(
        config,
        System.of(config.radio, CLUSTERS, 0.0),
        rover_xy=places,
        hull_radius_m=0.3,
        room_m=room,
        powers_w=powers,
        rates_bps=np.ones((200, 4)),
        **arguments,
    )
    np.testing.assert_array_equal(kept.in_room, within_room(places, 0.3, room))
    np.testing.assert_array_equal(kept.power, within_budget(powers, CLUSTERS, scheme, config.radio.tx_power_w))
    assert 20 < kept.in_room.sum() < 180
    assert 20 < kept.power.sum() < 180


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_a_dynamic_order_is_always_kept_and_so_are_room_and_power(scheme):
    made, rng = simulator(16, scheme=scheme), np.random.default_rng(0)
    met = []
    for _ in range(10):
        slot = made.step(*commands(made, rng))
        kept = slot.constraints
        assert kept.in_room.all()
        assert kept.power.all()
        assert kept.decoding_order.all()
        np.testing.assert_array_equal(kept.qos, slot.qos_met.all(-1))
        np.testing.assert_array_equal(kept.collision_free, slot.collisions == 0)
        met.append(kept.qos)
    assert 0 < np.mean(met) < 1


def test_a_static_order_is_kept_where_it_is_the_dynamic_one():
    made, rng = simulator(16, decoding_order="static"), np.random.default_rng(1)
    kept, first = [], None
    for _ in range(12):
        move, phases, powers = commands(made, rng)
        now = access.decoding_order(made.effective_channel(phases), powers, made.clusters, made.config.radio.noise_w)
        first = now if first is None else first
        got = made.step(move, phases, powers).constraints.decoding_order
        np.testing.assert_array_equal(got, (now == first).all((-2, -1)))
        kept.append(got)
    assert np.all(kept[0])
    assert 0 < np.mean(kept[1:]) < 1


def test_too_much_power_is_noticed_in_the_slot():
    made, rng = simulator(), np.random.default_rng(2)
    move, phases, powers = commands(made, rng)
    powers[1] *= 4 * made.config.radio.tx_power_w / powers[1].sum()
    assert made.step(move, phases, powers).constraints.power.tolist() == [True, False, True, True]


def test_info_has_every_constraint_as_a_plain_bool():
    env = OfficeEnv()
    env.reset(seed=3)
    for _ in range(5):
        info = env.step(env.action_space.sample())[4]
        assert tuple(info["constraints"]) == NAMES
        assert all(type(value) is bool for value in info["constraints"].values())
        assert info["constraints"]["qos"] == info["qos_met"].all()
        assert info["constraints"]["collision_free"] == (info["collisions"] == 0)
