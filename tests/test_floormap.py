import math
from dataclasses import fields, replace

import literal
import numpy as np
import pytest

from mjris.config import ConfigError, preset
from mjris.eval.floormap import FloorMap, floor_map
from mjris.planning import prediction
from mjris.simulation.outlook import place_values
from mjris.simulation.simulator import Simulator

ROOM = """
room.size = [6.0, 8.0, 3.0]
ap.position = [3.0, 7.8, 2.6]
ap.facing_deg = 270.0
rover.start = [3.0, 2.0]
obstacle = [{ kind = "block", at = [2.0, 5.0] }]
[kinds.block]
bricks = [{ at = [0.0, 0.0, 1.5], size = [1.6, 0.2, 3.0], material = "plaster" }]
"""
AP = np.array([3.0, 7.8, 2.6])
USER_M, PANEL_M = 1.1, 1.5


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("layouts") / "room.toml"
    path.write_text(ROOM)
    office = preset("classic")
    return replace(office, world=replace(office.world, layout=str(path), num_users=2), seed=3)


@pytest.fixture(scope="module")
def simulator(config):
    return Simulator(config)


@pytest.fixture(scope="module")
def floor(simulator):
    return floor_map(simulator)


def behind_the_block(x, y):
    """Whether the way from the AP to (x, y) crosses 1.2 … 2.8 × 4.9 … 5.1, which reaches the ceiling."""
    near, far = ((AP[1] - face) / (AP[1] - y) for face in (5.1, max(4.9, y)))
    ends = [AP[0] + share * (x - AP[0]) for share in (near, far)]
    return y < 5.1 and min(ends) < 2.8 and max(ends) > 1.2


def at(floor, x, y):
    """Row and column of the cell that holds a point."""
    return int(np.abs(floor.y_m - y).argmin()), int(np.abs(floor.x_m - x).argmin())


def loss_by_hand(distance, blocked):
    return literal.path_loss_db("paper", distance, int(blocked), 2e9)


def test_the_grid_tiles_the_floor(floor, simulator):
    np.testing.assert_allclose(floor.x_m, np.arange(60) * 0.1 + 0.05)
    np.testing.assert_allclose(floor.y_m, np.arange(80) * 0.1 + 0.05)
    assert floor.blockers.shape == floor.path_loss_db.shape == floor.ris_rate_bps.shape == (80, 60)
    odd = floor_map(simulator, resolution_m=0.7, place_resolution_m=1.0)
    # 6 m and 8 m in cells of at most 0.7 m: 9 of 0.667 m and 12 of 0.667 m.
    np.testing.assert_allclose(odd.x_m, (np.arange(9) + 0.5) * 6 / 9)
    np.testing.assert_allclose(odd.y_m, (np.arange(12) + 0.5) * 8 / 12)
    assert odd.place_gain_bps.shape == (8, 6)


def test_shadow_and_path_loss_are_those_of_one_wall(floor):
    for row, y in enumerate(floor.y_m):
        for column, x in enumerate(floor.x_m):
            if floor.in_furniture[row, column]:
                continue
            blocked = behind_the_block(x, y)
            assert floor.blockers[row, column] == blocked, (x, y)
            distance = max(1.0, math.dist((x, y, USER_M), AP))
            assert floor.path_loss_db[row, column] == pytest.approx(loss_by_hand(distance, blocked), rel=1e-12)
    assert 0.1 < (floor.blockers > 0).mean() < 0.5


def test_furniture_is_where_nobody_stands(floor):
    x, y = np.meshgrid(floor.x_m, floor.y_m)
    np.testing.assert_array_equal(floor.in_furniture, (abs(x - 2.0) < 0.8) & (abs(y - 5.0) < 0.1))


def test_snr_and_rate_by_hand(floor):
    row, column = at(floor, 4.55, 3.05)
    loss = loss_by_hand(math.dist((4.55, 3.05, USER_M), AP), False)
    # 20 dBm, four antennas, -30 dBm of noise in 1 MHz.
    snr_db = 20 + 10 * math.log10(4) - loss + 30
    assert floor.snr_db[row, column] == pytest.approx(snr_db, rel=1e-12)
    assert floor.rate_bps[row, column] == pytest.approx(1e6 * math.log2(1 + 10 ** (snr_db / 10)), rel=1e-12)


def test_the_ris_adds_its_aligned_cascade(config):
    paper = replace(config, radio=replace(config.radio, element_pattern="isotropic", element_amplitude=0.8))
    floor = floor_map(Simulator(paper), rover_xy_m=(4.4, 5.5))
    panel = (4.4, 5.5, PANEL_M)
    row, column = at(floor, 2.05, 3.05)
    assert floor.blockers[row, column] == 1
    user = (2.05, 3.05, USER_M)
    # The way from the panel passes the block in the east: it crosses y = 5 at x = 3.93 and y = 4.9 at 3.82.
    direct = 10 ** (-loss_by_hand(math.dist(user, AP), True) / 20)
    incident = 10 ** (-loss_by_hand(math.dist(panel, AP), False) / 20)
    reflected = 10 ** (-loss_by_hand(math.dist(panel, user), False) / 20)
    snr = 0.1 * 4 * (direct + 16 * 0.8 * incident * reflected) ** 2 / 1e-6
    assert floor.ris_snr_db[row, column] == pytest.approx(10 * math.log10(snr), rel=1e-12)
    assert floor.ris_rate_bps[row, column] == pytest.approx(1e6 * math.log2(1 + snr), rel=1e-12)


def test_the_rate_is_the_prediction_for_a_single_user(simulator, config):
    floor = floor_map(simulator, resolution_m=1.0, rover_xy_m=(0.7, 5.5), panel_heading_rad=0.1)
    alone = replace(config.radio, num_clusters=1)
    panel = np.array([0.7, 5.5, PANEL_M])
    normal = np.array([math.cos(0.1), math.sin(0.1), 0])

    def gain(end):
        count = simulator.world.sight.blockers(np.array([[end]]), panel[None, None])[0, 0]
        way = end - panel
        cosine = max(0.0, way @ normal / np.linalg.norm(way))
        pattern = 2 * 1.57 * cosine**0.57
        return 10 ** (-loss_by_hand(max(1, np.linalg.norm(way)), count) / 10 - 0.4 * max(0, count - 1)) * pattern

    for row, y in enumerate(floor.y_m):
        for column, x in enumerate(floor.x_m):
            direct = np.array([10 ** (-floor.path_loss_db[row, column] / 10)])
            reflected = np.array([gain(np.array([x, y, USER_M]))])
            rate = prediction.predicted_rates(direct, np.array(gain(AP)), reflected, np.array([[0]]), alone, 1e4)
            np.testing.assert_allclose(floor.ris_rate_bps[row, column], rate[0], rtol=1e-9)
    assert (floor.ris_snr_db > floor.snr_db + 1).any()


def test_behind_the_panel_nothing_is_added(simulator):
    east = floor_map(simulator, rover_xy_m=(3.0, 3.0), panel_heading_rad=0.0)
    x, _ = np.meshgrid(east.x_m, east.y_m)
    np.testing.assert_allclose(east.ris_snr_db[x < 3], east.snr_db[x < 3], rtol=1e-14)
    # The AP is exactly beside the panel here, so nothing reaches it either.
    np.testing.assert_allclose(east.ris_snr_db, east.snr_db, atol=1e-6)
    north = floor_map(simulator, rover_xy_m=(3.0, 3.0), panel_heading_rad=math.pi / 2)
    _, y = np.meshgrid(north.x_m, north.y_m)
    np.testing.assert_allclose(north.ris_snr_db[y < 3], north.snr_db[y < 3], rtol=1e-13)
    assert (north.ris_snr_db[y > 3] > north.snr_db[y > 3]).all()


def test_the_panel_stands_and_faces_as_the_scene_says(floor, simulator, config):
    np.testing.assert_array_equal(floor.ris_xy_m, [3.0, 2.0])
    users = simulator.scene.users_xy[0]
    np.testing.assert_array_equal(floor.users_xy_m, users)
    toward_ap = AP[:2] - floor.ris_xy_m
    toward_users = ((users - floor.ris_xy_m) / np.linalg.norm(users - floor.ris_xy_m, axis=1)[:, None]).mean(0)
    middle = toward_ap / np.linalg.norm(toward_ap) + toward_users / np.linalg.norm(toward_users)
    assert floor.ris_heading_rad == pytest.approx(math.atan2(middle[1], middle[0]))
    locked = Simulator(replace(config, world=replace(config.world, pan="locked")))
    assert floor_map(locked, resolution_m=1.0).ris_heading_rad == locked.scene.rover_heading[0]


def test_the_worth_of_places_is_that_of_the_radio_map(floor, simulator):
    assert floor.place_gain_bps.shape == (32, 24)
    row, column = 20, 20
    place = np.array([[[floor.place_x_m[column], floor.place_y_m[row]]]])
    value = place_values(simulator, place)[0, 0]
    assert floor.place_gain_bps[row, column] == pytest.approx(value - floor.bare_value_bps, rel=1e-9)
    assert np.nanmax(floor.place_gain_bps) > 1e3


@pytest.mark.parametrize("qos_bps", [1e3, 1e9])
def test_a_panel_that_reflects_nothing_is_worth_nothing(config, qos_bps):
    task = replace(config.task, qos_bps=qos_bps)
    dark = Simulator(replace(config, task=task, radio=replace(config.radio, element_amplitude=0.0)))
    floor = floor_map(dark, place_resolution_m=1.0)
    np.testing.assert_allclose(floor.place_gain_bps, 0, atol=1e-6)
    np.testing.assert_allclose(floor.ris_snr_db, floor.snr_db, rtol=1e-13)


def test_places_are_where_the_rover_can_stand(floor, simulator, config):
    keep = simulator.world.hull_radius_m + config.world.bumper_m
    x, y = np.meshgrid(floor.place_x_m, floor.place_y_m)
    walls = np.minimum.reduce([x, y, 6 - x, 8 - y])
    block = np.hypot(np.maximum(abs(x - 2.0) - 0.8, 0), np.maximum(abs(y - 5.0) - 0.1, 0))
    np.testing.assert_array_equal(np.isnan(floor.place_gain_bps), np.minimum(walls, block) < keep)


def test_people_cast_shadows_if_bodies_block(config):
    solid = Simulator(replace(config, world=replace(config.world, body_blockage=True)))
    floor = floor_map(solid)
    clear = floor_map(Simulator(config)).blockers
    np.testing.assert_array_equal(floor.users_xy_m, solid.scene.users_xy[0])
    more = floor.blockers - clear
    assert more.min() == 0
    for x, y in floor.users_xy_m:
        way = np.array([x, y]) - AP[:2]
        # The AP is 1.5 m above the receivers, and 0.85 m above a head.
        behind = np.array([x, y]) + 0.35 * way / np.linalg.norm(way)
        assert more[at(floor, *behind)] >= 1


def test_saved_arrays_are_the_fields(floor, tmp_path):
    floor.save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as saved:
        assert set(saved) == {field.name for field in fields(FloorMap)}
        for name, values in saved.items():
            np.testing.assert_array_equal(values, getattr(floor, name))


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"resolution_m": 0.01}, "resolution_m: 0.01 is not allowed: it must be from 0.02 to 1 m"),
        ({"place_resolution_m": 1.5}, "place_resolution_m: 1.5 is not allowed"),
        ({"resolution_m": math.nan}, "resolution_m: nan"),
        ({"rover_xy_m": (6.5, 1.0)}, "rover: 6.5 1 is not allowed: the room goes from 0 0 to 6 8"),
        ({"rover_xy_m": (2.0, 5.0)}, r"rover: 2 5 is not allowed: the rover's hull would stand 0\.\d\d m in furniture"),
        ({"panel_heading_rad": math.inf}, "heading: inf is not allowed"),
    ],
)
def test_bad_wishes_are_refused_in_words(simulator, wish, words):
    with pytest.raises(ConfigError, match=words):
        floor_map(simulator, **wish)
