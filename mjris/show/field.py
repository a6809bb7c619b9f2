"""The motion field of an agent: where it heads from every place of the floor, with people at fixed places."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mjris.config import Config
from mjris.eval.floormap import FloorMap, floor_map
from mjris.eval.playing import independent
from mjris.eval.policies import Act, agent_policies
from mjris.show.maps import draw_boards, draw_furniture
from mjris.show.palette import user_colour
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task
from mjris.world.office import Office

FloatArray = NDArray[np.floating]

_SPACING_M = 0.75
_ARROW_M = 0.7
_STILL = 0.1
"""Shorter moves count as staying, as a share of the way of a slot."""
_WIDTH_IN = 3.5
"""Half a page."""
_INK = "#222222"
_LIGHT = ListedColormap(colormaps["YlGnBu"](np.linspace(0, 0.6, 256)))


@dataclass(frozen=True)
class MotionField:
    """What an agent would do in one scene from each of P places."""

    office: Office
    places_m: FloatArray
    """[P, 2] [m]"""
    heading: FloatArray
    """Commanded displacements as shares of what a slot allows [P, 2]."""
    floor: FloorMap
    """Of the same scene; coarse but for what places are worth."""


def motion_field(config: Config, act: Act, seed: int) -> MotionField:
    """The field of an agent over the floor that the rover can reach, in the first held-out scene of `seed`.

    But for jitter: furniture stands at the layout's own places. All places share people and fading, being the same cell
    of one simulator many times.
    """
    policy = agent_policies(act)[0]
    still = independent(policy.changed(replace(config, world=replace(config.world, layout_jitter_m=0.0))))
    cell = CellId(seed, 0)
    alone = Simulator(still, [cell])
    places = reachable_places(alone)
    task = Task(still, [cell] * len(places))
    simulator, world = task.simulator, task.simulator.world
    world.fleet.place(np.arange(len(places)), places, world.fleet.heading)
    simulator.look()
    move_m = policy.controls(task).displacement_m
    standing = world.clearance() > 0
    return MotionField(
        office=alone.world.office(0),
        places_m=places[standing],
        heading=move_m[standing] / (still.world.max_speed_mps * still.world.slot_s),
        floor=floor_map(alone, resolution_m=1.0),
    )


def reachable_places(simulator: Simulator, spacing_m: float = _SPACING_M) -> FloatArray:
    """Places [P, 2] [m] of a grid over the floor of a simulator's first cell that its rover can reach, people apart."""
    world, paths = simulator.world, simulator.terrain.paths
    room = np.array(world.office(0).layout.room.size[:2])
    x, y = ((np.arange(count) + 0.5) * length / count for count, length in zip(room // spacing_m, room, strict=True))
    places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    nodes = paths.nodes[paths.reachable[0]]
    nearest = nodes[((places[:, None] - nodes) ** 2).sum(-1).argmin(1)]
    return places[world.free_share(nearest[None], places[None], paths.keep_m)[0] == np.inf]


def plot_motion_field(config: Config, field: MotionField, path: Path) -> None:
    """Write the arrows over the plan of the office and what places are worth to the RIS, as a PNG or PDF file."""
    office, floor = field.office, field.floor
    x, y, _ = office.layout.room.size
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(_WIDTH_IN, (_WIDTH_IN - 1.2) * y / x + 1.1), dpi=300, layout="compressed")
        axes = figure.add_subplot()
        worth = axes.imshow(floor.place_gain_bps / 1e6, origin="lower", extent=(0, x, 0, y), cmap=_LIGHT, zorder=1)
        draw_furniture(axes, office, config.world.user_height_m)
        draw_boards(axes, office)
        _draw_arrows(axes, field)
        _draw_marks(axes, office, floor)
        axes.set(xlim=(0, x), ylim=(0, y), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set_title("Where the agent heads from each place")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(6, integer=True))
        label = "predicted sum rate over no RIS [Mb/s]"
        bar = figure.colorbar(worth, ax=axes, label=label, shrink=0.7, aspect=18)
        bar.outline.set_linewidth(0.5)
        figure.legend(loc="outside lower center", ncols=4, frameon=False, columnspacing=1.0, handletextpad=0.4)
        figure.savefig(path)


def _draw_arrows(axes: Axes, field: MotionField) -> None:
    """Directions as arrows of one length, which slow agents need to be seen; dots where the agent stays."""
    speed = np.linalg.norm(field.heading, axis=-1, keepdims=True)
    still = speed[:, 0] < _STILL
    axes.plot(*field.places_m[still].T, ls="", marker=".", ms=2.5, color=_INK, zorder=4, label="stays")
    direction = field.heading[~still] / speed[~still]
    size: dict[str, Any] = {"width": 0.04, "headwidth": 5, "headlength": 5, "headaxislength": 4.5}
    units: dict[str, Any] = {"angles": "xy", "units": "xy", "scale_units": "xy", "scale": 1 / _ARROW_M}
    axes.quiver(*field.places_m[~still].T, *direction.T, color=_INK, zorder=4, **units, **size)


def _draw_marks(axes: Axes, office: Office, floor: FloorMap) -> None:
    style: dict[str, Any] = {"ls": "", "mec": _INK, "mew": 0.7, "clip_on": False, "zorder": 5}
    axes.plot(
        *floor.ap_xyz_m[:2],
        marker=(3, 0, np.degrees(office.layout.ap.facing) - 90),
        ms=8,
        color="white",
        label="AP",
        **style,
    )
    for user, place in enumerate(floor.users_xy_m):
        axes.plot(*place, marker="o", ms=4.5, color=user_colour(user), label=f"user {user + 1}", **style)
