"""From a layout and the parts in assets/ to one compiled MuJoCo model, and the ids that the rest uses."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjris.assets import assets_dir
from mjris.config import Config, Radio, look_loss_db
from mjris.world.layout import Layout, Panel
from mjris.world.panels import board_half_m, board_name

FloatArray = NDArray[np.floating]

GROUP_BLOCKERS = 1
"""Geom group of the furniture bricks, which block links."""
GROUP_VISUALS = 2
"""Geom group of what is for the eye only; the simulated model goes without."""
GROUP_WALLS = 3
"""Geom group of what is solid and blocks no links: the room's outer walls, and the boards of fixed panels."""
GROUP_PEOPLE = 5
"""Geom group of the people's capsules, which block links if asked to and are not shown."""

WALL_THICKNESS_M = 0.1
PERSON_RADIUS_M = 0.22
PERSON_HEIGHT_M = 1.75
HULL_FLOOR_GAP_M = 0.03
CHASSIS_HEIGHT_M = 0.2
"""Top of the rover's chassis above the floor, below which no panel reaches."""
MAST_RADIUS_M = 0.02
"""As rover.xml has it."""
_AXLE_HEIGHT_M = 0.08
_HULL_MIN_RADIUS_M = 0.25


def hull_radius(config: Config) -> float:
    """Radius of the cylinder that encloses rover and panel at every pan angle [m]."""
    half_width = config.radio.panel_cols * config.radio.wavelength_m / 4
    return max(_HULL_MIN_RADIUS_M, math.hypot(half_width + 0.02, 0.02))


def hull_height(config: Config) -> float:
    """Height of the hull's top above the floor [m]."""
    return config.world.panel_height_m + config.radio.panel_rows * config.radio.wavelength_m / 4 + 0.05


def panel_bottom(config: Config) -> float:
    """Height of the panel's lower edge above the floor [m]."""
    return config.world.panel_height_m - board_half_m(config.radio, config.radio.panel_rows, 1)[2]


def feeler_reach(config: Config) -> float:
    """From what distance on the bumper reports things [m]: a tick before the rover is within what it keeps."""
    world = config.world
    return world.bumper_m + world.max_speed_mps * world.slot_s / world.ticks_per_slot


class Boxes(NamedTuple):
    """The upright boxes of an office."""

    centre: FloatArray
    """[B, 3] [m]"""
    half: FloatArray
    """Half sides [B, 3] [m]."""
    axis: FloatArray
    """Unit vectors of their own x directions [B, 2]."""
    body: NDArray[np.int64]
    """The bodies that they belong to [B]; the boxes of one follow each other."""
    weight: FloatArray
    """What one in the way counts [B], once for every body: one, or what is lost in it [dB]."""


@dataclass(frozen=True)
class Office:
    """A compiled office with its rover and people, and where things are in it."""

    model: mujoco.MjModel
    """What is simulated: all that can touch or block."""
    layout: Layout
    config: Config

    @cached_property
    def scenery(self) -> mujoco.MjModel:
        """The same bodies and joints with all that is for the eye as well."""
        return compose(self.config, self.layout).compile()

    @cached_property
    def ap_position(self) -> FloatArray:
        """Centre of the AP's array, [3] [m]."""
        return np.array(self.layout.ap.position)

    @cached_property
    def ap_axis(self) -> FloatArray:
        """Unit vector along the AP's array, [3]: horizontal, across the direction it faces."""
        facing = self.layout.ap.facing
        return np.array([-math.sin(facing), math.cos(facing), 0.0])

    @cached_property
    def rover_qpos(self) -> int:
        """Where the rover's free joint (x, y, z, quaternion) starts in qpos."""
        return int(self.model.joint("rover/free").qposadr[0])

    @cached_property
    def pan_qpos(self) -> int:
        """Where the panel's pan angle stands in qpos."""
        return int(self.model.joint("rover/panel/pan").qposadr[0])

    @cached_property
    def mocap_ids(self) -> slice:
        """Mocap indices of the people, which follow each other."""
        first = int(self.model.body("person0/person").mocapid[0])
        return slice(first, first + self.config.world.num_users)

    def boxes(self, *groups: int) -> Boxes:
        """The boxes of some geom groups."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        chosen = np.isin(self.model.geom_group, groups)
        return Boxes(
            centre=data.geom_xpos[chosen],
            half=self.model.geom_size[chosen],
            axis=data.geom_xmat[chosen].reshape(-1, 3, 3)[:, :2, 0],
            body=self.model.geom_bodyid[chosen].astype(np.int64),
            weight=np.ones(chosen.sum()),
        )

    def losses(self, *groups: int) -> Boxes:
        """The boxes of some geom groups, each a body of its own that counts what is lost in it [dB]."""
        boxes = self.boxes(*groups)
        looks = self.model.geom_matid[np.isin(self.model.geom_group, groups)]
        carrier_hz = self.config.radio.carrier_hz
        lost = np.array([look_loss_db(self.model.mat(int(look)).name, carrier_hz) for look in looks])
        return boxes._replace(body=np.arange(len(looks)), weight=lost)

    @cached_property
    def bumper(self) -> slice:
        """The bumper's readings in sensordata: rows of found, distance [m], normal (3)."""
        sensor = self.model.sensor("rover/bumper")
        return slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))


def build(config: Config, layout: Layout) -> Office:
    """Compile a layout with the rover, its panel and the people of `config`."""
    spec = _without_elements(config, layout)
    # Every geom costs time in each ray and each physics step, whether it can be met or not.
    for geom in [geom for geom in spec.geoms if geom.group == GROUP_VISUALS]:
        spec.delete(geom)
    return Office(spec.compile(), layout, config)


def compose(config: Config, layout: Layout) -> mujoco.MjSpec:
    """The scene as an editable spec: shell, furniture, AP, people, rover and panel."""
    spec, radio = _without_elements(config, layout), config.radio
    _add_elements(spec, radio, "rover/panel", spec.body("rover/panel/panel"), radio.panel_rows, radio.panel_cols)
    for index, panel in enumerate(layout.ris):
        name = board_name(index)
        _add_elements(spec, radio, name, spec.body(name), panel.rows, panel.cols)
    return spec


def _without_elements(config: Config, layout: Layout) -> mujoco.MjSpec:
    """All but the panel's elements, which may be thousands, and of which each takes milliseconds to be deleted."""
    spec = _part("office")
    ticks_s = config.world.slot_s / config.world.ticks_per_slot
    spec.option.timestep = ticks_s / math.ceil(ticks_s / config.world.timestep_s - 1e-9)
    _add_shell(spec, layout)
    _add_furniture(spec, layout)
    _add_access_point(spec, layout)
    _add_people(spec, config)
    _add_rover(spec, config)
    for index, panel in enumerate(layout.ris):
        _add_board(spec, config, board_name(index), panel)
    _add_contacts(spec, config)
    return spec


def _part(name: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(assets_dir() / f"{name}.xml"))


def _add_shell(spec: mujoco.MjSpec, layout: Layout) -> None:
    x, y, z = layout.room.size
    scale = max(x / 15, y / 20)
    # The view of office.xml is that of 15 m × 20 m.
    spec.camera("overview").pos = [x / 2, y / 2 - 16.5 * scale, 19.5 * scale]
    floor = spec.geom("floor")
    floor.size, floor.pos = [x / 2, y / 2, 0.1], [x / 2, y / 2, 0]
    t = WALL_THICKNESS_M
    sides = {
        "wall_west": ([-t / 2, y / 2, z / 2], [t / 2, y / 2 + t, z / 2]),
        "wall_east": ([x + t / 2, y / 2, z / 2], [t / 2, y / 2 + t, z / 2]),
        "wall_south": ([x / 2, -t / 2, z / 2], [x / 2 + t, t / 2, z / 2]),
        "wall_north": ([x / 2, y + t / 2, z / 2], [x / 2 + t, t / 2, z / 2]),
    }
    for name, (pos, size) in sides.items():
        _add_box(spec.worldbody, spec.find_default("wall"), name, pos, size, "wall")
    _add_box(
        spec.worldbody,
        spec.find_default("ceiling"),
        "ceiling",
        [x / 2, y / 2, z + 0.05],
        [x / 2, y / 2, 0.05],
        "ceiling",
    )


def _add_furniture(spec: mujoco.MjSpec, layout: Layout) -> None:
    for obstacle in layout.obstacles:
        body = spec.worldbody.add_body(
            name=obstacle.name,
            pos=[*obstacle.position, 0],
            quat=[math.cos(obstacle.yaw / 2), 0, 0, math.sin(obstacle.yaw / 2)],
        )
        for index, brick in enumerate(obstacle.bricks):
            half = [length / 2 for length in brick.size]
            _add_box(body, spec.find_default("brick"), f"{obstacle.name}/{index}", brick.at, half, brick.material)


def _add_box(body, default, name: str, pos, half_size, material: str) -> None:
    body.add_geom(
        default, name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=list(pos), size=list(half_size), material=material
    )


def _add_access_point(spec: mujoco.MjSpec, layout: Layout) -> None:
    facing = layout.ap.facing
    quat = [math.cos(facing / 2), 0, 0, math.sin(facing / 2)]
    body = spec.worldbody.add_body(name="ap", pos=list(layout.ap.position), quat=quat)
    visual = spec.find_default("visual")
    _add_box(body, visual, "ap/case", [0, 0, 0], [0.03, 0.14, 0.08], "ap")


def _add_people(spec: mujoco.MjSpec, config: Config) -> None:
    for k in range(config.world.num_users):
        person = _part("person")
        person.body("person").add_site(name="receiver", pos=[0.0, 0.0, config.world.user_height_m], size=[0.03, 0, 0])
        spec.attach(person, prefix=f"person{k}/", frame=spec.worldbody.add_frame())


def _add_rover(spec: mujoco.MjSpec, config: Config) -> None:
    rover = _part("rover")
    hull = rover.geom("hull")
    top = hull_height(config)
    hull.size = [hull_radius(config), (top - HULL_FLOOR_GAP_M) / 2, 0]
    hull.pos = [0, 0, (top + HULL_FLOOR_GAP_M) / 2 - _AXLE_HEIGHT_M]
    mast = rover.geom("mast")
    mast.fromto = [0, 0, 0.12, 0, 0, config.world.panel_height_m - _AXLE_HEIGHT_M]
    rover.attach(_panel(config), prefix="panel/", frame=_mast_top(rover, config))
    spec.attach(rover, prefix="rover/", frame=spec.worldbody.add_frame())


def _add_contacts(spec: mujoco.MjSpec, config: Config) -> None:
    """All that can touch, pair by pair: with MuJoCo's search over all bodies a step takes a third longer."""
    world = config.world
    capsules = [f"person{k}/body" for k in range(world.num_users)]
    solid = [geom.name for geom in spec.geoms if geom.group in (GROUP_BLOCKERS, GROUP_WALLS)]
    for name in solid + capsules:
        spec.add_pair(geomname1="rover/hull", geomname2=name, gap=feeler_reach(config), margin=0, condim=1)
    if world.drive == "wheels":
        for side in ("left", "right"):
            spec.add_pair(
                geomname1=f"rover/tread_{side}", geomname2="floor", condim=3, friction=[1, 1, 0.005, 1e-4, 1e-4]
            )
        for end in ("front", "back"):
            spec.add_pair(geomname1=f"rover/caster_{end}", geomname2="floor", condim=1)


def _mast_top(rover: mujoco.MjSpec, config: Config) -> mujoco.MjsFrame:
    return rover.body("chassis").add_frame(pos=[0, 0, config.world.panel_height_m - _AXLE_HEIGHT_M])


def _panel(config: Config) -> mujoco.MjSpec:
    """The rover's panel, which is its board."""
    ris = _part("ris")
    ris.geom("board").size = board_half_m(config.radio, config.radio.panel_rows, config.radio.panel_cols)
    return ris


def _add_board(spec: mujoco.MjSpec, config: Config, name: str, panel: Panel) -> None:
    """The board of a fixed panel, which is in the way of whatever drives or walks."""
    quat = [math.cos(panel.facing / 2), 0, 0, math.sin(panel.facing / 2)]
    body = spec.worldbody.add_body(name=name, pos=list(panel.at), quat=quat)
    half = board_half_m(config.radio, panel.rows, panel.cols)
    _add_box(body, spec.find_default("wall"), f"{name}/board", [0, 0, 0], half, "rover/panel/ris_board")


def _add_elements(spec: mujoco.MjSpec, radio: Radio, name: str, body: mujoco.MjsBody, rows: int, cols: int) -> None:
    """A tile for every reflecting element of a panel, half a wavelength apart, row by row from the bottom."""
    spacing = radio.wavelength_m / 2
    for n in range(rows * cols):
        row, col = divmod(n, cols)
        body.add_geom(
            spec.find_default("rover/panel/ris"),
            name=f"{name}/element{n}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.008, (col - (cols - 1) / 2) * spacing, (row - (rows - 1) / 2) * spacing],
            size=[0.003, 0.4 * spacing, 0.4 * spacing],
            material="rover/panel/ris_element",
        )
