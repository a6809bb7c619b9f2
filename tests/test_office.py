# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math

import mujoco
import numpy as np
import pytest

from mjris.config import Config, Radio, World, preset
from mjris.world.layout import layout_names, load_layout
from mjris.world.office import GROUP_BLOCKERS, GROUP_WALLS, Office, build, hull_height, hull_radius


def office(name: str = "office", **world) -> Office:
    return build(Config(world=World(**world)), load_layout(name))


def names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


@pytest.mark.parametrize("drive", ["wheels", "kinematic"])
@pytest.mark.parametrize("name", layout_names())
def test_layouts_compile_with_a_geom_for_every_brick_in_its_place(name, drive):
    made = office(name, drive=drive)
    data = mujoco.MjData(made.model)
    mujoco.mj_forward(made.model, data)
    for obstacle in made.layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        for index, brick in enumerate(obstacle.bricks):
            geom = made.model.geom(f"{obstacle.name}/{index}")
            x, y, z = brick.at
            middle = [obstacle.position[0] + c * x - s * y, obstacle.position[1] + s * x + c * y, z]
            np.testing.assert_allclose(data.geom_xpos[geom.id], middle, atol=1e-9)
            np.testing.assert_allclose(geom.size, np.array(brick.size) / 2)
            assert geom.group == GROUP_BLOCKERS
            assert made.model.body(int(geom.bodyid[0])).name == obstacle.name
    assert (made.model.geom_group == GROUP_BLOCKERS).sum() == sum(len(o.bricks) for o in made.layout.obstacles)


@pytest.mark.parametrize("name", layout_names())
def test_every_solid_thing_has_a_contact_pair_with_the_hull(name):
    made = office(name)
    model = made.model
    hull = model.geom("rover/hull").id
    pairs = {frozenset((int(a), int(b))) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    solid = [*np.flatnonzero(np.isin(model.geom_group, (GROUP_BLOCKERS, GROUP_WALLS)))]
    solid += [model.geom(f"person{k}/body").id for k in range(made.config.world.num_users)]
    assert {frozenset((hull, int(geom))) for geom in solid} <= pairs
    assert (model.geom_group == GROUP_WALLS).sum() >= 4


def test_walls_enclose_the_room():
    made = office()
    x, y, z = made.layout.room.size
    data = mujoco.MjData(made.model)
    mujoco.mj_forward(made.model, data)
    hit = np.zeros(1, np.int32)
    groups = np.zeros(mujoco.mjNGROUP, np.uint8)
    groups[GROUP_WALLS] = 1
    centre = np.array([x / 2, y / 2, z / 2])
    for direction, far in [((1, 0), x / 2), ((-1, 0), x / 2), ((0, 1), y / 2), ((0, -1), y / 2)]:
        reach = mujoco.mj_ray(made.model, data, centre, np.array([*direction, 0.0]), groups, 1, -1, hit)
        assert reach == pytest.approx(far)


def test_ids_point_at_what_they_name():
    made = office(num_users=6)
    model = made.model
    data = mujoco.MjData(model)
    data.mocap_pos[made.mocap_ids] = np.arange(18).reshape(6, 3)
    pan = 0.4
    data.qpos[made.rover_qpos : made.rover_qpos + 2] = [3.0, 4.0]
    data.qpos[made.pan_qpos] = pan
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose([data.body(f"person{k}/person").xpos for k in range(6)], np.arange(18).reshape(6, 3))
    np.testing.assert_allclose(data.body("rover/chassis").xpos[:2], [3, 4])
    panel = data.body("rover/panel/panel")
    np.testing.assert_allclose(panel.xpos, [3, 4, Config().world.panel_height_m], atol=1e-9)
    np.testing.assert_allclose(panel.xmat.reshape(3, 3)[:, 0], [math.cos(pan), math.sin(pan), 0], atol=1e-9)
    assert (made.bumper.stop - made.bumper.start) % 5 == 0
    np.testing.assert_allclose(data.site("person3/receiver").xpos, [9, 10, 11 + Config().world.user_height_m])


def test_the_access_point_hangs_where_the_layout_says():
    made = office()
    np.testing.assert_array_equal(made.ap_position, made.layout.ap.position)
    facing = np.array([math.cos(made.layout.ap.facing), math.sin(made.layout.ap.facing), 0])
    assert np.linalg.norm(made.ap_axis) == pytest.approx(1)
    assert made.ap_axis @ facing == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(made.model.body("ap").pos, made.ap_position)


@pytest.mark.parametrize(("rows", "cols", "carrier_hz"), [(4, 4, 2e9), (2, 8, 2e9), (8, 3, 5e9), (1, 1, 28e9)])
def test_panel_has_an_element_for_each_of_n_and_lies_within_the_hull(rows, cols, carrier_hz):
    config = Config(radio=Radio(panel_rows=rows, panel_cols=cols, carrier_hz=carrier_hz))
    model = build(config, load_layout("open")).scenery
    geoms = names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom)
    assert sum(name.startswith("rover/panel/element") for name in geoms) == config.radio.num_elements == rows * cols
    data = mujoco.MjData(model)
    for pan in np.linspace(-math.pi, math.pi, 9):
        data.joint("rover/panel/pan").qpos[:] = pan
        mujoco.mj_forward(model, data)
        rover = data.body("rover/chassis").xpos
        for index in [i for i, name in enumerate(geoms) if name.startswith(("rover/panel/", "rover/mast"))]:
            low, high = model.geom_aabb[index][:3], model.geom_aabb[index][3:]
            corners = low + high * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
            placed = data.geom_xpos[index] + corners @ data.geom_xmat[index].reshape(3, 3).T
            assert np.linalg.norm(placed[:, :2] - rover[:2], axis=-1).max() <= hull_radius(config) + 1e-9
            assert placed[:, 2].max() <= hull_height(config) + 1e-9


def test_a_large_panel_weighs_as_much_as_a_small_one_and_its_elements_are_for_the_eye():
    config = Config(radio=Radio(panel_rows=64, panel_cols=64, carrier_hz=60e9))
    large, small = (build(made, load_layout("open")) for made in (config, Config(radio=Radio(carrier_hz=60e9))))
    assert large.model.ngeom == small.model.ngeom
    assert large.scenery.ngeom == small.scenery.ngeom + 64 * 64 - 16
    np.testing.assert_array_equal(large.model.body_mass, small.model.body_mass)
    np.testing.assert_array_equal(large.model.body_inertia, small.model.body_inertia)


def test_neighbouring_elements_are_half_a_wavelength_apart():
    config = preset("classic")
    model = build(config, load_layout("office")).scenery
    pos = np.stack([model.geom(f"rover/panel/element{n}").pos for n in range(16)])
    half = config.radio.wavelength_m / 2
    apart = np.linalg.norm(pos[:, None] - pos[None], axis=-1) + 10 * np.eye(16)
    np.testing.assert_allclose(apart.min(1), half)
    assert np.ptp(pos[:, 1]) == pytest.approx(3 * half)
    assert np.ptp(pos[:, 2]) == pytest.approx(3 * half)


@pytest.mark.parametrize(("slot_s", "ticks", "longest"), [(1.0, 10, 0.02), (1.0, 11, 0.02), (0.5, 10, 0.003)])
def test_time_steps_fill_a_tick(slot_s, ticks, longest):
    step = office("open", slot_s=slot_s, ticks_per_slot=ticks, timestep_s=longest).model.opt.timestep
    assert step <= longest + 1e-12
    assert slot_s / ticks / step == pytest.approx(round(slot_s / ticks / step))


@pytest.mark.parametrize("drive", ["wheels", "kinematic"])
def test_what_is_simulated_moves_as_what_is_seen(drive):
    made = office(drive=drive)
    simulated, seen = made.model, made.scenery
    assert simulated.ngeom < seen.ngeom
    for kind, count in [(mujoco.mjtObj.mjOBJ_BODY, seen.nbody), (mujoco.mjtObj.mjOBJ_JOINT, seen.njnt)]:
        assert names(simulated, kind, count) == names(seen, kind, count)
    moving = seen.body_weldid > 0
    np.testing.assert_array_equal(simulated.body_mass[moving], seen.body_mass[moving])
    np.testing.assert_array_equal(simulated.body_inertia[moving], seen.body_inertia[moving])
    solid = [name for name in names(seen, mujoco.mjtObj.mjOBJ_GEOM, seen.ngeom) if seen.geom(name).group[0] != 2]
    assert names(simulated, mujoco.mjtObj.mjOBJ_GEOM, simulated.ngeom) == solid
