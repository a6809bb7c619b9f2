"""Similar, not equal: a layout whose furniture stands a little elsewhere in every cell."""

import math
from dataclasses import replace

import numpy as np

from mjris.config import ConfigError
from mjris.world.layout import Layout
from mjris.world.layout_checks import check_layout

_TRIES = 3


def jittered(layout: Layout, distance_m: float, rng: np.random.Generator) -> Layout:
    """The layout with every obstacle moved by up to `distance_m` [m], uniformly over the disc.

    An obstacle that would meet a wall, another one or the rover's start stays where it is.
    """
    for index in range(len(layout.obstacles)):
        for _ in range(_TRIES):
            radius, angle = distance_m * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
            moved = _moved(layout, index, radius * math.cos(angle), radius * math.sin(angle))
            try:
                check_layout(moved)
            except ConfigError:
                continue
            layout = moved
            break
    return layout


def _moved(layout: Layout, index: int, dx: float, dy: float) -> Layout:
    obstacle = layout.obstacles[index]
    x, y = obstacle.position
    others = layout.obstacles
    return replace(
        layout, obstacles=(*others[:index], replace(obstacle, position=(x + dx, y + dy)), *others[index + 1 :])
    )
