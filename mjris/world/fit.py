"""Whether the rover, the panels and the antennas of a config fit into a layout, and have floor to drive on."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.jit.compiled import compiled
from mjris.world.layout import Layout
from mjris.world.layout_checks import Boxes, boxes_of, plan_distance, wall_distance
from mjris.world.office import CHASSIS_HEIGHT_M, HULL_FLOOR_GAP_M, hull_height, hull_radius, panel_bottom
from mjris.world.panels import check_boards, with_boards

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

WAY_MARGIN_M = 0.05
"""Ways leave this much more room than the bumper asks for, a tick's way at the default speed [m]."""
_GRID_M = 0.25
_LEAST_FLOOR_M2 = 5.0
_LEAST_FLOOR_SHARE = 0.05


def kept_distance(config: Config) -> float:
    """How far the rover's middle keeps from furniture and walls [m]: its hull and its bumper."""
    return hull_radius(config) + config.world.bumper_m


def check_fit(config: Config, layout: Layout) -> None:
    """Check panels and antennas against the room, the rover's start, and the floor that it can reach from there.

    The layout is one that `check_layout` passes. Raises `ConfigError`, one sentence that names the fields at fault.
    """
    _check_panel(config, layout)
    _check_antennas(config, layout)
    check_boards(config.radio, layout)
    solid = with_boards(config.radio, layout)
    boxes = boxes_of(solid)
    at_hull = boxes.between(HULL_FLOOR_GAP_M, hull_height(config))
    _check_start(config, solid, boxes, at_hull)
    _check_floor(config, solid, boxes, at_hull)


def rover_start(config: Config, layout: Layout) -> tuple[float, float]:
    """Where the rover starts [m]: the config's place, or else the layout's."""
    return layout.start if config.world.start_m is None else config.world.start_m


def _check_panel(config: Config, layout: Layout) -> None:
    bottom, top = panel_bottom(config), hull_height(config)
    ceiling = layout.room.size[2]
    if bottom < CHASSIS_HEIGHT_M or top > ceiling:
        raise ConfigError(
            f"radio.panel_rows: {config.radio.panel_rows} is not allowed: with world.panel_height_m "
            f"{config.world.panel_height_m} and radio.carrier_hz {config.radio.carrier_hz:g} panel and mast span "
            f"{bottom:.2f} m to {top:.2f} m, and there is room from the chassis at {CHASSIS_HEIGHT_M} m to the "
            f"ceiling of layout {layout.name!r} at {ceiling:g} m"
        )


def _check_antennas(config: Config, layout: Layout) -> None:
    radio, (x, y, _) = config.radio, layout.ap.position
    half = (radio.num_antennas - 1) * radio.wavelength_m / 4
    along_x, along_y = half * abs(math.sin(layout.ap.facing)), half * abs(math.cos(layout.ap.facing))
    if min(x, layout.room.size[0] - x) < along_x or min(y, layout.room.size[1] - y) < along_y:
        raise ConfigError(
            f"radio.num_antennas: {radio.num_antennas} is not allowed: at radio.carrier_hz {radio.carrier_hz:g} the "
            f"AP's array is {2 * half:.2f} m long, and around ap.position {list(layout.ap.position)} it reaches "
            f"through a wall of layout {layout.name!r}"
        )


def _check_start(config: Config, layout: Layout, boxes: Boxes, at_hull: NDArray[np.intp]) -> None:
    start, keep = np.array(rover_start(config, layout)), kept_distance(config)
    gaps = {"a wall": float(wall_distance(start, layout.room))}
    for b in at_hull:
        name = f"obstacle {layout.obstacles[boxes.owner[b]].name}"
        gaps[name] = min(gaps.get(name, math.inf), float(plan_distance(start, boxes, b)))
    nearest = min(gaps, key=lambda name: gaps[name])
    if gaps[nearest] < keep:
        field = "rover.start" if config.world.start_m is None else "world.start_m"
        raise ConfigError(
            f"{field}: {start.tolist()} is not allowed: in layout {layout.name!r} {nearest} is {gaps[nearest]:.2f} m "
            f"away, and {_needs(config)}"
        )


def _check_floor(config: Config, layout: Layout, boxes: Boxes, at_hull: NDArray[np.intp]) -> None:
    floor_m2 = layout.room.size[0] * layout.room.size[1]
    area = _reachable_m2(layout, boxes, at_hull, np.array(rover_start(config, layout)), kept_distance(config))
    least = max(_LEAST_FLOOR_M2, _LEAST_FLOOR_SHARE * floor_m2)
    if area < least:
        raise ConfigError(
            f"layout {layout.name!r} has no free floor: {_needs(config)}, so that it can reach {area:.1f} m² from its "
            f"start, and at least {least:.1f} m² are needed"
        )


def _needs(config: Config) -> str:
    return (
        f"the rover needs {kept_distance(config):.2f} m, which are its hull of {hull_radius(config):.2f} m with "
        f"radio.panel_cols {config.radio.panel_cols} and world.bumper_m {config.world.bumper_m}"
    )


def _reachable_m2(layout: Layout, boxes: Boxes, at_hull: NDArray[np.intp], start: FloatArray, keep_m: float) -> float:
    """Area connected to the rover's start that ways may lead over [m²]."""
    x, y = (np.arange(_GRID_M / 2, side, _GRID_M) for side in layout.room.size[:2])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    keep_m += WAY_MARGIN_M
    free: BoolArray = wall_distance(points, layout.room) > keep_m
    for b in at_hull:
        # Only what is near is looked at, so that large rooms take no longer for every brick.
        reach_m = keep_m + float(np.hypot(*boxes.half[b, :2]))
        low, high = ((boxes.centre[b, :2] + way * reach_m) / _GRID_M for way in (-1, 1))
        window = tuple(slice(max(int(low[i]), 0), int(high[i]) + 2) for i in range(2))
        free[window] &= plan_distance(points[window], boxes, b) > keep_m
    from_start = np.where(free, np.linalg.norm(points - start, axis=-1), np.inf)
    i, j = divmod(int(from_start.argmin()), free.shape[1])
    return _connected(free, i, j) * _GRID_M**2


@compiled
def _connected(free: BoolArray, i: int, j: int) -> int:
    """How many free squares are connected to one of them over their sides, itself included."""
    if not free[i, j]:
        return 0
    left, todo, count = free.copy(), [(i, j)], 1
    left[i, j] = False
    while todo:
        i, j = todo.pop()
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            a, b = i + di, j + dj
            if 0 <= a < left.shape[0] and 0 <= b < left.shape[1] and left[a, b]:
                left[a, b] = False
                count += 1
                todo.append((a, b))
    return count
