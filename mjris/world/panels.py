"""The panels of a cell: the rover's comes first, then those at the fixed places that its layout has for them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError, Radio
from mjris.world.layout import Brick, Layout, Obstacle, Panel, load_layout
from mjris.world.layout_checks import boxes_of, outside_m, overlap_m

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_FRAME_M = 0.01
"""A board is that much larger than its elements on every side."""
_BOARD_HALF_M = 0.006
"""Half its thickness."""
_MOUNT_M = 1e-3
"""A board may sink that far into what it is mounted on."""


def board_half_m(radio: Radio, rows: int, cols: int) -> tuple[float, float, float]:
    """Half sides of a panel's board [m], whose elements are half a wavelength apart."""
    quarter_m = radio.wavelength_m / 4
    return _BOARD_HALF_M, cols * quarter_m + _FRAME_M, rows * quarter_m + _FRAME_M


def panel_sizes(radio: Radio, layout: Layout) -> IntArray:
    """Rows and columns of all panels [S, 2]."""
    return np.array([(radio.panel_rows, radio.panel_cols), *((panel.rows, panel.cols) for panel in layout.ris)])


def all_elements(config: Config) -> int:
    """N, elements of all panels in a config's layout. Raises `ConfigError` where there is no such layout."""
    return int(panel_sizes(config.radio, load_layout(config.world.layout)).prod(1).sum())


def with_boards(radio: Radio, layout: Layout) -> Layout:
    """The layout with the boards of its panels as obstacles after all others, as nothing can stand where they hang."""
    return replace(layout, obstacles=layout.obstacles + tuple(_boards(radio, layout)))


def check_boards(radio: Radio, layout: Layout) -> None:
    """Check that the layout's panels are within the room, and in nothing else.

    Raises `ConfigError`, one sentence that names the panel at fault.
    """
    furniture = len(layout.obstacles)
    boxes, first = boxes_of(with_boards(radio, layout)), sum(len(each.bricks) for each in layout.obstacles)
    outside = outside_m(boxes, layout.room)
    for index, panel in enumerate(layout.ris):
        board = first + index
        depth = overlap_m(boxes, np.arange(board), np.full(board, board))
        if outside[board].max() > _MOUNT_M:
            trouble = f"reaches {outside[board].max():.3f} m through a wall, the floor or the ceiling"
        elif board and depth.max() > _MOUNT_M:
            other = int(boxes.owner[depth.argmax()])
            name = f"obstacle {layout.obstacles[other].name}" if other < furniture else f"ris.{other - furniture}"
            trouble = f"is {depth.max():.3f} m deep in {name}"
        else:
            continue
        width_m, height_m = (2 * half for half in board_half_m(radio, panel.rows, panel.cols)[1:])
        raise ConfigError(
            f"ris.{index}: at {list(panel.at)} with {panel.rows} rows and {panel.cols} cols is not allowed: in layout "
            f"{layout.name!r} with radio.carrier_hz {radio.carrier_hz:g} its board of {width_m:.3f} m × "
            f"{height_m:.3f} m {trouble}"
        )


def _boards(radio: Radio, layout: Layout) -> list[Obstacle]:
    return [
        Obstacle(name=board_name(index), position=panel.at[:2], yaw=panel.facing, bricks=(_board(radio, panel),))
        for index, panel in enumerate(layout.ris)
    ]


def board_name(index: int) -> str:
    """What the body of a layout's panel is called."""
    return f"ris{index}"


def _board(radio: Radio, panel: Panel) -> Brick:
    depth, width, height = (2 * half for half in board_half_m(radio, panel.rows, panel.cols))
    return Brick(at=(0.0, 0.0, panel.at[2]), size=(depth, width, height), material="board")
