"""What gets through things: losses of materials, of people and of the rover itself."""

import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.assets import assets_dir
from mjris.config import BODY_DB, LOOKS, MATERIALS, Config, ConfigError, Radio, World, from_dict, preset
from mjris.radio.equations import path_loss_db, rician_k
from mjris.radio.tables import LinkTable
from mjris.simulation.outlook import place_values
from mjris.simulation.simulator import Simulator
from mjris.world.layout import load_layout
from mjris.world.office import build
from mjris.world.sight import Sight

ROOM = """
room.size = [10.0, 10.0, 3.0]
ap.position = [5.0, 9.8, 2.5]
ap.facing_deg = 270.0
rover.start = [5.0, 5.0]
"""


@pytest.mark.parametrize(
    ("material", "carrier_hz", "loss_db"),
    [
        ("glass", 28e9, 7.6),
        ("coated_glass", 28e9, 31.4),
        ("concrete", 10e9, 45.0),
        ("wood", 10e9, 6.05),
        ("plasterboard", 10e9, 1.2 + 0.277 * 10**0.7076),
        ("metal", 1e9, 100.0),
    ],
)
def test_losses_are_those_of_the_tables(material, carrier_hz, loss_db):
    assert MATERIALS[material].loss_db(carrier_hz) == pytest.approx(loss_db)


def test_plasterboard_is_two_boards_of_its_permittivity():
    for ghz in (2, 10, 28):
        absorbed = 0.025 * 1636 * 0.0116 * ghz**0.7076 / math.sqrt(2.94)
        assert MATERIALS["plasterboard"].loss_db(ghz * 1e9) == pytest.approx(absorbed + 1.2, rel=0.01)


def test_every_look_of_bricks_has_a_material():
    root = ElementTree.parse(assets_dir() / "office.xml").getroot()
    looks = {material.attrib["name"] for material in root.iterfind("asset/material")}
    assert looks - {"floor", "wall", "ceiling", "ap"} == set(LOOKS)
    assert set(LOOKS.values()) == set(MATERIALS)


def walls(tmp_path, *materials: str) -> str:
    """A room with walls of these materials across it, from south to north, and a rover south of them."""
    lines = ",".join(
        f'{{ from = [2.0, {6 + 0.8 * i}], to = [8.0, {6 + 0.8 * i}], material = "{material}" }}'
        for i, material in enumerate(materials)
    )
    path = tmp_path / "walls.toml"
    path.write_text(ROOM + f"wall = [{lines}]\n")
    return str(path)


def test_ways_lose_what_every_wall_takes(tmp_path):
    config = Config(radio=Radio(carrier_hz=10e9, obstacles="materials"))
    office = build(config, load_layout(walls(tmp_path, "glass", "concrete", "plaster")))
    ends = (
        np.array([[[5.0, 5.0, 1.5], [5.0, 6.3, 1.5], [1.0, 1.0, 1.0]]]),
        np.array([[[5.0, 9.0, 2.0]] * 2 + [[1.0, 9.0, 1.0]]]),
    )
    plaster = MATERIALS["plasterboard"].loss_db(10e9)
    np.testing.assert_allclose(Sight([office], in_db=True).blockers(*ends), [[4 + 45 + plaster, 45 + plaster, 0]])
    np.testing.assert_array_equal(Sight([office]).blockers(*ends), [[3, 2, 0]])


@given(st.floats(1, 50), st.floats(0, 200), st.sampled_from([2e9, 10e9, 28e9]))
def test_through_or_around_whichever_is_more(distance_m, lost_db, carrier_hz):
    counted, table = (LinkTable.of(Radio(carrier_hz=carrier_hz, obstacles=kind)) for kind in ("counted", "materials"))
    clear, around = (path_loss_db(counted, distance_m**2, n) for n in (0, 1))
    assert path_loss_db(table, distance_m**2, lost_db) == pytest.approx(min(clear + lost_db, max(around, clear)))
    assert rician_k(table, lost_db) == pytest.approx(counted.rician_k * 10 ** (-lost_db / 10), rel=1e-9)


def simulator(layout: str, users: int = 2, cells: int = 2, **world) -> Simulator:
    config = preset("classic")
    radio = replace(config.radio, carrier_hz=10e9, obstacles="materials", num_clusters=1)
    world = replace(config.world, layout=layout, num_users=users, **world)
    return Simulator(replace(config, world=world, radio=radio, seed=1), cells)


def test_a_scene_and_its_radio_map_lose_by_material(tmp_path):
    """A pane of glass costs little, concrete much, and nothing more than the way around."""
    found = []
    for material in ("glass", "concrete"):
        made = simulator(walls(tmp_path, material))
        made.world.crowd.place(np.arange(2), np.tile([[4.5, 4.0], [5.5, 4.0]], (2, 1, 1)))
        scene = made.look()
        distance = math.dist(made.ap_position[0], [4.5, 4.0, 1.1])
        clear, around = (path_loss_db(made.link_table._replace(materials=False), distance**2, n) for n in (0, 1))
        expected = min(clear + MATERIALS[material].loss_db(10e9), around)
        assert scene.path_loss_db[0, 0] == pytest.approx(expected)
        assert scene.blockers[0, 0] == 1
        found.append(place_values(made, np.full((2, 1, 2), 5.0))[0, 0])
    assert found[0] > found[1]


def test_people_and_the_rover_are_in_the_way(tmp_path):
    path = tmp_path / "empty.toml"
    path.write_text(ROOM)
    made = simulator(str(path), body_blockage=True, rover_blockage=True)
    made.world.crowd.place(np.arange(2), np.tile([[5.0, 2.0], [5.0, 3.0]], (2, 1, 1)))
    made.world.fleet.place(np.arange(2), np.array([[5.0, 4.23], [2.0, 4.23]]), np.zeros(2))
    scene = made.look()
    lost = scene.path_loss_db[:, 0]
    distance = math.dist(made.ap_position[0], [5.0, 2.0, 1.1])
    clear, around = (path_loss_db(made.link_table._replace(materials=False), distance**2, n) for n in (0, 1))
    # In cell 0 the rover's panel stands before the AP, in cell 1 only the other person is in the way.
    assert lost[0] == pytest.approx(around)
    assert lost[1] == pytest.approx(min(clear + BODY_DB, around))
    assert scene.blockers[0, 0] == scene.blockers[1, 0] + 1
    # Never for links over its own panel.
    np.testing.assert_array_equal(scene.blockers[:, made.links.incident], 0)


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"radio.obstacles"):
        from_dict({"radio": {"obstacles": "paper"}})
    with pytest.raises(ConfigError, match=r"wall.0.material: 'cheese' is not known"):
        load_layout(walls(tmp_path, "cheese"))
    assert World(rover_blockage=True).rover_blockage
