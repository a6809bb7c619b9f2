"""Films an episode: the office from above, links in the colour of their sight, rates in words, the rover close by."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import imageio_ffmpeg
import mediapy
import mujoco
import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.radio.links import Links
from mjris.show.overlay import Overlay, Picture, phase_rgb
from mjris.show.palette import BLOCKED, CLEAR, ROVER, rgb, user_colour
from mjris.show.rollout import Rollout
from mjris.world.office import GROUP_BLOCKERS, Office
from mjris.world.panels import board_name, panel_sizes

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_SHOWN_GROUPS = (0, 1, 2, 3)
_HIDDEN_GROUP = 4
_ENCODING = ("-preset", "veryfast")
_COLUMN_SHARE = 0.26
_CLOSE_M = 4.0
"""The camera that follows the rover sees no further than this from it."""
_FRAMED_ASPECT = 1.15
"""Cameras show the whole room in pictures that are at least so wide, width by height."""


class Line(NamedTuple):
    """A link to draw."""

    start: FloatArray
    """[3] [m]"""
    end: FloatArray
    """[3] [m]"""
    rgba: FloatArray
    """[4] in [0, 1]"""
    radius_m: float


def write_video(
    config: Config,
    office: Office,
    rollout: Rollout,
    path: Path,
    *,
    camera: str = "overview",
    width: int = 960,
    height: int = 720,
    fps: int = 10,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> None:
    """Film a rollout to an MP4 file, one frame a tick; `progress` hears of every frame.

    The file appears under its name when it is whole. Raises `ConfigError` for odd sizes, an unknown camera, or where
    nothing can be rendered.
    """
    if width % 2 or height % 2:
        raise ConfigError(f"video size: {width} × {height} is not allowed: H.264 needs even numbers of pixels")
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    path.parent.mkdir(parents=True, exist_ok=True)
    film = _film(config, office, rollout, range(rollout.frames), camera, width, height)
    partial = path.with_name(f".{path.stem}.partial.mp4")
    try:
        # The default preset takes twice the time, for files of the same size and quality.
        with mediapy.VideoWriter(partial, (height, width), fps=fps, crf=20, ffmpeg_args=_ENCODING) as writer:
            for done, picture in enumerate(film):
                writer.add_image(picture)
                progress(done + 1, rollout.frames)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def snapshot(
    config: Config,
    office: Office,
    rollout: Rollout,
    frame: int,
    *,
    camera: str = "overview",
    width: int = 960,
    height: int = 720,
) -> Picture:
    """One frame [height, width, 3] of what `write_video` films; negative frames count from the end."""
    return next(_film(config, office, rollout, [range(rollout.frames)[frame]], camera, width, height))


def link_lines(
    links: Links, ap: FloatArray, panels: FloatArray, receivers: FloatArray, blockers: IntArray
) -> list[Line]:
    """Lines of all links [L] for an AP [3], panels [S, 3], receivers [K, 3] [m] and obstacles in their way [L]."""
    starts, ends = links.ends(ap[None], panels[None], receivers[None])
    clear, blocked = (np.array([*rgb(colour), alpha]) / 255 for colour, alpha in ((CLEAR, 230), (BLOCKED, 110)))
    return [
        Line(start, end, blocked, 0.02) if count else Line(start, end, clear, 0.035)
        for start, end, count in zip(starts[0], ends[0], blockers, strict=True)
    ]


def _film(
    config: Config, office: Office, rollout: Rollout, frames: range | list[int], camera: str, width: int, height: int
) -> Iterator[Picture]:
    """Finished pictures of some frames."""
    column = round(_COLUMN_SHARE * width)
    overlay = Overlay(rollout, panel_sizes(config.radio, office.layout).tolist(), column, height)
    stage = _Stage(config, office, rollout, camera, width - column, height)
    with stage.renderer(width - column, height) as main, stage.renderer(*overlay.inset_size) as inset:
        # Shadows take most of the time, and nobody misses them in the small picture.
        inset.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        for frame in frames:
            stage.pose(frame)
            with stage.close_only():
                close = stage.shoot(inset, "rover/chase")
            words = overlay.draw(rollout.slot_of(frame), close)
            yield np.concatenate([words, stage.shoot(main, camera)], 1)


class _Stage:
    """A copy of the office in the colours of the film, posed as a rollout says."""

    def __init__(self, config: Config, office: Office, rollout: Rollout, camera: str, width: int, height: int):
        self._config, self._office, self._rollout = config, office, rollout
        self._model = copy.copy(office.scenery)
        self._data = mujoco.MjData(self._model)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = np.isin(np.arange(mujoco.mjNGROUP), _SHOWN_GROUPS)
        screen = self._model.vis.global_
        screen.offwidth, screen.offheight = max(screen.offwidth, width), max(screen.offheight, height)
        elements = panel_sizes(config.radio, office.layout).prod(1)
        self._links = Links(config.world.num_users, elements)
        panels = ["rover/panel", *(board_name(index) for index in range(len(office.layout.ris)))]
        self._elements = [
            self._model.geom(f"{panel}/element{n}").id
            for panel, count in zip(panels, elements.tolist(), strict=True)
            for n in range(count)
        ]
        self._model.geom_matid[self._elements] = -1
        self._lines: list[Line] = []
        self._widen(camera, width / height)
        for user in range(config.world.num_users):
            self._paint(f"person{user}/torso", np.array([*rgb(user_colour(user)), 255]) / 255)
        # The cameras look from the south, over this wall.
        self._paint("wall_south", np.array([0.93, 0.92, 0.89, 0.25]))

    def renderer(self, width: int, height: int) -> mujoco.Renderer:
        """An offscreen renderer. Raises `ConfigError` where OpenGL is missing."""
        try:
            return mujoco.Renderer(self._model, height, width)
        # OpenGL loaders raise errors of many kinds, AttributeError among them.
        except Exception as error:
            raise ConfigError(
                "rendering: no OpenGL context can be made off screen: install the system packages libegl1 and "
                "libgl1-mesa-dri and set MUJOCO_GL=egl, or set MUJOCO_GL=osmesa with libosmesa6"
            ) from error

    def pose(self, frame: int) -> None:
        """Put everything where it was in a frame."""
        rollout, data, world = self._rollout, self._data, self._config.world
        slot = rollout.slot_of(frame)
        data.qpos, data.mocap_pos, data.mocap_quat = (
            rollout.qpos[frame],
            rollout.mocap_pos[frame],
            rollout.mocap_quat[frame],
        )
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_camlight(self._model, data)
        self._model.geom_rgba[self._elements, :3] = [phase_rgb(phase) for phase in rollout.phases_rad[slot]]
        start = self._office.rover_qpos
        rover = [*data.qpos[start : start + 2], world.panel_height_m]
        panels = np.array([rover, *(panel.at for panel in self._office.layout.ris)])
        receivers = data.mocap_pos[self._office.mocap_ids].copy()
        receivers[:, 2] = world.user_height_m
        lines = link_lines(self._links, self._office.ap_position, panels, receivers, rollout.blockers[slot])
        self._lines = lines[self._links.direct] if self._config.task.ris == "none" else lines

    def shoot(self, renderer: mujoco.Renderer, camera: str) -> Picture:
        """A picture of the present pose."""
        renderer.update_scene(self._data, camera, self._option)
        scene = renderer.scene
        self._fade(scene, self._before_rover(camera))
        for line in self._lines:
            geom = _next_geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), line.rgba)
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, line.radius_m, line.start, line.end)
        xy = self._data.qpos[self._office.rover_qpos :][:2]
        disc = np.array([*rgb(ROVER), 150]) / 255
        _next_geom(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, np.array([0.5, 0.005, 0]), np.array([*xy, 0.01]), disc)
        return renderer.render()

    @contextmanager
    def close_only(self) -> Iterator[None]:
        """Leave out what is far from the rover: every geom costs time, seen or not."""
        model, rover = self._model, self._data.qpos[self._office.rover_qpos :][:2]
        shown, radius = model.geom_group.copy(), model.geom_rbound
        away = np.linalg.norm(self._data.geom_xpos[:, :2] - rover, axis=-1) - radius
        # A plane has no radius.
        model.geom_group[(away > _CLOSE_M) & (radius > 0)] = _HIDDEN_GROUP
        try:
            yield
        finally:
            model.geom_group[:] = shown

    def _before_rover(self, camera: str) -> IntArray:
        """The bricks that hide the rover's base or its panel from a camera, -1 for none [2]."""
        data = self._data
        eye = data.cam_xpos[self._model.camera(camera).id]
        ways = np.stack([data.body(f"rover/{part}").xpos - eye for part in ("chassis", "panel/panel")])
        groups = (np.arange(mujoco.mjNGROUP) == GROUP_BLOCKERS).astype(np.uint8)
        geom, distance = np.empty(2, np.int32), np.empty(2)
        mujoco.mj_multiRay(self._model, data, eye, ways.ravel(), groups, True, -1, geom, distance, None, 2, 1e9)
        # Distances are in lengths of the way.
        return np.where(distance < 1, geom, -1)

    def _fade(self, scene: mujoco.MjvScene, geoms: IntArray) -> None:
        """Let one see through some geoms; -1 stands for none."""
        if (geoms < 0).all():
            return
        for shown in scene.geoms[: scene.ngeom]:
            if shown.objtype == mujoco.mjtObj.mjOBJ_GEOM and shown.objid in geoms:
                shown.rgba[3] = 0.35
                shown.transparent = True

    def _widen(self, camera: str, aspect: float) -> None:
        """Open the camera's angle in narrow pictures."""
        names = [self._model.camera(index).name for index in range(self._model.ncam)]
        if camera not in names:
            raise ConfigError(f"camera: {camera!r} is not known: it is one of {', '.join(names)}")
        half = math.radians(self._model.cam_fovy[names.index(camera)] / 2)
        half = math.atan(math.tan(half) * max(1, _FRAMED_ASPECT / aspect))
        self._model.cam_fovy[names.index(camera)] = math.degrees(2 * half)

    def _paint(self, geom: str, rgba: FloatArray) -> None:
        index = self._model.geom(geom).id
        self._model.geom_matid[index] = -1
        self._model.geom_rgba[index] = rgba


def _next_geom(
    scene: mujoco.MjvScene, kind: mujoco.mjtGeom, size: FloatArray, place: FloatArray, rgba: FloatArray
) -> mujoco.MjvGeom:
    """A geom appended to the scene, for the eye only."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), rgba.astype(np.float32))
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1
    return geom
