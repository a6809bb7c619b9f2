"""What planning knows of the offices of E cells: the ways of their rovers, and sight between squares of the floor."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjris.planning.paths import Paths
from mjris.planning.sight_map import SightMap
from mjris.world.fit import WAY_MARGIN_M
from mjris.world.office import PERSON_RADIUS_M
from mjris.world.sight import Sight
from mjris.world.world import World

FloatArray = NDArray[np.floating]


class Terrain:
    """Ways and sight in a world, both worked out when first asked for."""

    def __init__(self, world: World):
        self._world = world

    @cached_property
    def paths(self) -> Paths:
        """Shortest ways for the rovers."""
        world = self._world
        room = world.office(0).layout.room.size[:2]
        return Paths(world.hull_solid, room, world.start, world.hull_radius_m + world.config.bumper_m + WAY_MARGIN_M)

    @cached_property
    def sight_map(self) -> SightMap:
        """Furniture between the users' and the panel's height, and to the AP; people and rovers do not count."""
        world, config = self._world, self._world.config
        ap = np.stack([office.ap_position for office in world.offices])
        room = np.array(world.office(0).layout.room.size[:2])
        sight = Sight(world.offices, in_db=world.losses_in_db)
        return SightMap(sight, room, world.start, ap, config.user_height_m, config.panel_height_m)

    def way_toward(self, goal: FloatArray) -> FloatArray:
        """The next slot's displacement [E, 2] [m] on the shortest ways to `goal` [E, 2] [m], and around people."""
        world, here = self._world, self._world.fleet.xy
        target = self.paths.toward(here, goal)
        move = self.paths.around(here, target, world.crowd.xy, self.paths.keep_m + PERSON_RADIUS_M) - here
        reach = world.config.max_speed_mps * world.config.slot_s
        return move * np.minimum(1, reach / np.maximum(np.linalg.norm(move, axis=-1, keepdims=True), 1e-12))
