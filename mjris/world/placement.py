"""Where people stand when an episode begins: anywhere free, and for how many that can be promised."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.world.footprints import Footprints
from mjris.world.layout import Layout
from mjris.world.layout_checks import boxes_of, wall_distance
from mjris.world.office import PERSON_HEIGHT_M, PERSON_RADIUS_M, hull_radius
from mjris.world.panels import with_boards

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_TRIES = 32
"""Places that are drawn for a person; where none is free, one is picked of all that are left."""
_STRIP = 32
"""How many columns of the grid below are counted at a time."""
_GRID_M = 0.05
"""Distance between the places that are counted, and picked of then."""


class Placement:
    """Random free places of people in E cells, for one layout or one a cell.

    Every person has draws of its own, and each reset takes equally many: where one rover or person stands does not
    shift the luck of others.
    """

    def __init__(self, config: Config, layouts: list[Layout], start: FloatArray):
        """Keep people from walls, furniture, the rover's `start` [2] [m] and each other.

        Raises `ConfigError` where there may be no place left for the last of them.
        """
        world = config.world
        self._users = world.num_users
        self._layouts = layouts
        self._furniture = [_furniture(with_boards(config.radio, layout)) for layout in layouts]
        self._start = start
        self._from_solid_m = PERSON_RADIUS_M + world.clearance_m
        self._from_rover_m = PERSON_RADIUS_M + hull_radius(config) + world.clearance_m
        self._apart_m = 2 * PERSON_RADIUS_M + world.clearance_m
        for own, layout in enumerate(layouts):
            most, places = 0, 0
            for strip in self._free_strips(own):
                places += len(strip)
                most = self._most(places)
                if world.num_users <= most:
                    break  # in a large room there are millions of places
            if world.num_users > most:
                raise ConfigError(
                    f"world.num_users: {world.num_users} is not allowed: at world.clearance_m {world.clearance_m} "
                    f"layout {layout.name!r} is sure to have room for {most} people"
                )

    def draw(self, cell: int, rng: np.random.Generator) -> FloatArray:
        """Places [K, 2] [m] in a cell."""
        own = cell % len(self._layouts)
        drawn = rng.random((_TRIES + 1, self._users, 2))
        tried = drawn[:-1] * self._layouts[own].room.size[:2]
        free = self._free(own, tried)
        places = np.empty((self._users, 2))
        for k in range(self._users):
            chosen = tried[free[:, k] & self._apart(tried[:, k], places[:k]), k]
            if not len(chosen):
                grid = np.concatenate(list(self._free_strips(own)))
                left = grid[self._apart(grid, places[:k])]
                chosen = left[int(drawn[-1, k, 0] * len(left)) :]
            places[k] = chosen[0]
        return places

    def _most(self, places: int) -> int:
        """For how many people a grid with so many free places has room, wherever each of them stands.

        A person takes those that are closer than two people may be. The squares around them, one for each, lie in
        a disc that is wider by half a diagonal, so that its area says how many they are at most.
        """
        taken = math.pi * (self._apart_m / _GRID_M + math.sqrt(0.5)) ** 2
        return 1 + (places - 1) // math.floor(taken) if places else 0

    def _free_strips(self, own: int) -> Iterator[FloatArray]:
        """All places of a grid over a layout that are free but for other people, in strips along y [n, 2] [m]."""
        x, y = (np.arange(_GRID_M / 2, side, _GRID_M) for side in self._layouts[own].room.size[:2])
        for columns in np.array_split(x, -(-len(x) // _STRIP)):
            grid = np.stack(np.meshgrid(columns, y, indexing="ij"), axis=-1)
            yield grid[self._free(own, grid)]

    def _free(self, own: int, places: FloatArray) -> BoolArray:
        """Which of `places` [..., 2] [m] in a layout keep from everything solid and the rover [...]."""
        furniture = self._furniture[own].distance(places.reshape(1, -1, 2)).reshape(places.shape[:-1])
        solid = np.minimum(furniture, wall_distance(places, self._layouts[own].room))
        from_rover = np.linalg.norm(places - self._start, axis=-1)
        return (solid >= self._from_solid_m) & (from_rover >= self._from_rover_m)

    def _apart(self, places: FloatArray, people: FloatArray) -> BoolArray:
        """Which of `places` [n, 2] [m] keep from `people` [k, 2] [m], [n]."""
        away = np.linalg.norm(places[:, None] - people, axis=-1)
        return (away >= self._apart_m).all(-1)


def _furniture(layout: Layout) -> Footprints:
    """Outlines of the bricks that a person can meet, before anything is compiled."""
    boxes = boxes_of(layout)
    met = boxes.between(0, PERSON_HEIGHT_M)
    parts = boxes.centre[met, :2], boxes.half[met, :2], boxes.axes[met, 0, :2]
    return Footprints(*(np.ascontiguousarray(part.T[:, None]) for part in parts))
