"""The rover's path through an office, seen from above."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from pathlib import Path

import mujoco
import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mjris.show.maps import draw_boards
from mjris.show.palette import ROVER, STOPS, user_colour
from mjris.show.rollout import Rollout
from mjris.world.office import GROUP_BLOCKERS, Office

FloatArray = NDArray[np.floating]

_GRID_M = 0.1
_HEIGHTS = ListedColormap(np.linspace(0.88, 0.35, 256)[:, None] * np.ones(3))
_INK = "#222222"
_HATCH = "#c3d0de"
_WIDTH_IN = 3.5
"""Half a page."""
HEIGHTS_LABEL = "height of furniture [m]"


def plot_trajectory(office: Office, rollout: Rollout, path: Path) -> None:
    """Write the path of an episode, with its stops, the users' walks and the AP's shadow, as a PNG or PDF file."""
    x, y, _ = office.layout.room.size
    with rc_context({"font.size": 7, "hatch.linewidth": 0.5, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(_WIDTH_IN, (_WIDTH_IN - 1.0) * y / x + 1.1), dpi=300, layout="compressed")
        axes = figure.add_subplot()
        heights, handles = draw_trajectory(axes, office, rollout)
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
        figure.colorbar(heights, ax=axes, shrink=0.5, aspect=14, label=HEIGHTS_LABEL)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def draw_trajectory(axes: Axes, office: Office, rollout: Rollout) -> tuple[ScalarMappable, list[Artist]]:
    """What `plot_trajectory` shows, on axes: the scale of the furniture's heights [m], and what a legend needs."""
    x, y, _ = office.layout.room.size
    axes.set(xlim=(0, x), ylim=(0, y), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6, integer=True))
    _draw_shadow(axes, office)
    heights = _draw_furniture(axes, office)
    draw_boards(axes, office)
    _draw_access_point(axes, office)
    _draw_path(axes, rollout.rover_xy)
    _draw_walks(axes, rollout.users_xy)
    hatched = Patch(facecolor="none", edgecolor=_HATCH, hatch="//////", linewidth=0, label="no line of sight")
    return heights, [*axes.get_legend_handles_labels()[0], hatched]


def shadow(office: Office, spacing_m: float = _GRID_M) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Where furniture hides a receiver from the AP: x [nx] [m], y [ny] [m], hidden [ny, nx]."""
    width, depth, _ = office.layout.room.size
    x, y = (np.arange(spacing_m / 2, length, spacing_m) for length in (width, depth))
    height = office.model.site("person0/receiver").pos[2]
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), height)], -1)
    data = mujoco.MjData(office.model)
    mujoco.mj_kinematics(office.model, data)
    ways = (points - office.ap_position).reshape(-1, 3)
    groups = (np.arange(mujoco.mjNGROUP) == GROUP_BLOCKERS).astype(np.uint8)
    geom, distance = np.empty(len(ways), np.int32), np.empty(len(ways))
    mujoco.mj_multiRay(
        office.model, data, office.ap_position, ways.ravel(), groups, True, -1, geom, distance, None, len(ways), 1e9
    )
    # Distances are in lengths of the way, -1 where the ray meets nothing.
    return x, y, ((distance >= 0) & (distance < 1)).reshape(points.shape[:2])


def _draw_shadow(axes: Axes, office: Office) -> None:
    x, y, hidden = shadow(office)
    axes.contourf(x, y, hidden.astype(float), levels=[0.5, 1.5], colors="none", hatches=["//////"], zorder=1)
    drawn = axes.collections[-1]
    drawn.set_edgecolor(_HATCH)
    drawn.set_linewidth(0)


def _draw_furniture(axes: Axes, office: Office) -> ScalarMappable:
    """Bricks from the lowest top to the highest, dark where they are high; returns the scale of heights [m]."""
    model = office.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bricks = np.flatnonzero(model.geom_group == GROUP_BLOCKERS)
    top = data.geom_xpos[bricks, 2] + model.geom_size[bricks, 2]
    order = np.argsort(top, kind="stable")
    patches = []
    for brick in bricks[order]:
        half, centre, turn = model.geom_size[brick], data.geom_xpos[brick], data.geom_xmat[brick]
        angle = math.degrees(math.atan2(turn[3], turn[0]))
        corner = centre[:2] - half[:2]
        patches.append(Rectangle(tuple(corner), *(2 * half[:2]), angle=angle, rotation_point="center"))
    drawn = PatchCollection(patches, cmap=_HEIGHTS, norm=Normalize(0, office.layout.room.size[2]), zorder=2)
    drawn.set(array=top[order], edgecolor="white", linewidth=0.3)
    axes.add_collection(drawn)
    return drawn


def _draw_access_point(axes: Axes, office: Office) -> None:
    x, y, _ = office.ap_position
    facing = office.layout.ap.facing
    marker = (3, 0, math.degrees(facing) - 90)
    axes.plot(x, y, ls="", marker=marker, ms=7, color=_INK, mec="white", mew=0.6, clip_on=False, zorder=6, label="AP")


def _draw_walks(axes: Axes, users_xy: FloatArray) -> None:
    for user, walk in enumerate(np.moveaxis(users_xy, 1, 0)):
        colour = user_colour(user)
        axes.plot(*walk.T, color=colour, lw=0.7, zorder=3)
        axes.plot(
            *walk[-1], ls="", marker="o", ms=4.5, color=colour, mec=_INK, mew=0.5, zorder=5, label=f"user {user + 1}"
        )


def _draw_path(axes: Axes, rover_xy: FloatArray) -> None:
    axes.plot(*rover_xy.T, color=ROVER, lw=1.4, zorder=4, label="path of the RIS")
    axes.plot(*rover_xy.T, ls="", marker="*", ms=3.5, color=STOPS, mew=0, zorder=4, label="stop of a slot")
    for place, marker, words in ((rover_xy[0], "s", "start"), (rover_xy[-1], "D", "end")):
        axes.plot(*place, ls="", marker=marker, ms=4.5, color=ROVER, mec=_INK, mew=0.7, zorder=6, label=words)
