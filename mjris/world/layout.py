"""Layouts: what stands where in an office, read from TOML and checked geometrically."""

import math
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from mjris.assets import assets_dir
from mjris.config import ConfigError, Positive, validated

T = TypeVar("T")
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
_Floats = NDArray[np.float64]

Side = Annotated[float, Field(ge=2, le=100)]
Height = Annotated[float, Field(ge=2.2, le=20)]
KindName = Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$")]

ROVER_RADIUS_M = 0.3
"""Around the rover's start, this much floor is free of bricks and walls [m]."""
OVERHEAD_M = 2.0
"""Bricks whose underside is at this height or above do not occupy floor [m]."""

_TOUCH_M = 1e-6  # rounding allowed where a brick touches a wall
_OVERLAP_M = 0.01  # how far bricks of two obstacles may sink into each other
_GRID_M = 0.25
_PASSAGE_M = 0.4  # floor counts as free further than this from bricks and walls
_LEAST_FLOOR_M2 = 5.0
_LEAST_FLOOR_SHARE = 0.05


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Room:
    """The room spans 0..x, 0..y and stands on z = 0."""

    size: tuple[Side, Side, Height]
    """x, y, z [m]."""


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class AccessPoint:
    """Where the AP's array hangs."""

    position: tuple[float, float, float]
    """Centre of the array [m]."""
    facing_deg: float
    """Direction that the array faces: 0 is +x, counter-clockwise."""

    @property
    def facing(self) -> float:
        """Direction that the array faces [rad]."""
        return math.radians(self.facing_deg)


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Brick:
    """An axis-aligned box in the frame of its obstacle."""

    at: tuple[float, float, float]
    """Centre [m]; z from the floor."""
    size: tuple[Positive, Positive, Positive]
    """Full extents [m]."""
    material: str
    """Name of a material in assets/office.xml."""


Bricks = Annotated[tuple[Brick, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Obstacle:
    """A piece of furniture or a wall: bricks that move and block as one body."""

    name: str
    """Unique in the layout: the kind and a number, as in sofa_2."""
    position: tuple[float, float]
    """Origin of the obstacle's frame on the floor [m]."""
    yaw: float
    """Direction of the frame's +x axis, which is the furniture's front, counter-clockwise [rad]."""
    bricks: Bricks


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Layout:
    """An office with everything resolved to bricks."""

    name: str
    room: Room
    ap: AccessPoint
    start: tuple[float, float]
    """Where the rover starts [m]."""
    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _Kind:
    bricks: Bricks


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _Rover:
    start: tuple[float, float]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _Item:
    kind: str
    at: tuple[float, float]
    facing_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _Furniture:
    kinds: dict[KindName, _Kind]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _File:
    room: Room
    ap: AccessPoint
    rover: _Rover
    kinds: dict[KindName, _Kind] = Field(default_factory=dict)
    obstacle: tuple[_Item, ...] = ()


class _Boxes(NamedTuple):
    """All bricks of a layout in the room's frame; row b belongs to obstacle owner[b]."""

    centre: _Floats  # [B, 3]
    half: _Floats  # [B, 3]
    axes: _Floats  # [B, 3, 3], rows are the unit vectors along the box's sides
    owner: NDArray[np.intp]  # [B]


def layout_names() -> list[str]:
    """Names of the layouts in assets/layouts, sorted."""
    return sorted(path.stem for path in (assets_dir() / "layouts").glob("*.toml"))


def load_layout(name_or_path: str) -> Layout:
    """The layout of that name in assets/layouts, or in the .toml file at that path, checked by `check_layout`.

    Raises `ConfigError` where the layout is unknown, a field is wrong or the geometry is impossible.
    """
    names = layout_names()
    if name_or_path in names:
        path = assets_dir() / "layouts" / f"{name_or_path}.toml"
    elif name_or_path.endswith(".toml"):
        path = Path(name_or_path)
    else:
        raise ConfigError(
            f"world.layout: {name_or_path!r} is not known: it is one of {', '.join(names)}, or the path of a .toml file"
        )
    furniture_path = assets_dir() / "furniture.toml"
    furniture = _parse(_Furniture, furniture_path)
    file = _parse(_File, path)
    materials = _material_names()
    _check_materials(furniture.kinds, materials, furniture_path)
    _check_materials(file.kinds, materials, path)
    layout = Layout(
        name=path.stem,
        room=file.room,
        ap=file.ap,
        start=file.rover.start,
        obstacles=_obstacles(file.obstacle, furniture.kinds | file.kinds, path),
    )
    check_layout(layout, source=str(path))
    return layout


def check_layout(layout: Layout, source: str = "layout") -> None:
    """Check that everything fits in the room, nothing overlaps, and the rover has floor to drive on.

    Raises `ConfigError`, naming the obstacles at fault; `source` says where the layout comes from.
    """
    boxes = _boxes(layout)

    def fail(message: str) -> NoReturn:
        raise ConfigError(f"{source}: {message}")

    _check_inside(layout, boxes, fail)
    _check_overlaps(layout, boxes, fail)
    _check_start(layout, boxes, fail)
    _check_floor(layout, boxes, fail)


def _parse(schema: type[T], path: Path) -> T:
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}") from None
    return validated(lambda: TypeAdapter(schema).validate_python(data), str(path))


def _material_names() -> list[str]:
    root = ElementTree.parse(assets_dir() / "office.xml").getroot()
    return sorted(material.attrib["name"] for material in root.iterfind("asset/material"))


def _check_materials(kinds: dict[str, _Kind], materials: list[str], path: Path) -> None:
    for kind, definition in kinds.items():
        for index, brick in enumerate(definition.bricks):
            if brick.material not in materials:
                raise ConfigError(
                    f"{path}: kinds.{kind}.bricks.{index}.material: {brick.material!r} is not known: "
                    f"it is one of {', '.join(materials)}"
                )


def _obstacles(items: tuple[_Item, ...], kinds: dict[str, _Kind], path: Path) -> tuple[Obstacle, ...]:
    count: Counter[str] = Counter()
    obstacles = []
    for index, item in enumerate(items):
        if item.kind not in kinds:
            raise ConfigError(
                f"{path}: obstacle.{index}.kind: {item.kind!r} is not known: it is one of {', '.join(sorted(kinds))}"
            )
        count[item.kind] += 1
        obstacles.append(
            Obstacle(
                name=f"{item.kind}_{count[item.kind]}",
                position=item.at,
                yaw=math.radians(item.facing_deg),
                bricks=kinds[item.kind].bricks,
            )
        )
    return tuple(obstacles)


def _boxes(layout: Layout) -> _Boxes:
    centre, half, axes, owner = [], [], [], []
    for index, obstacle in enumerate(layout.obstacles):
        cos, sin = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        frame = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        for brick in obstacle.bricks:
            centre.append(np.array([*obstacle.position, 0]) + np.array(brick.at) @ frame)
            half.append(np.array(brick.size) / 2)
            axes.append(frame)
            owner.append(index)
    return _Boxes(
        np.reshape(centre, (-1, 3)), np.reshape(half, (-1, 3)), np.reshape(axes, (-1, 3, 3)), np.array(owner, np.intp)
    )


def _plan_distance(points: _Floats, boxes: _Boxes, b: int) -> _Floats:
    """Distance in the plan view from points [..., 2] to brick b [m]; zero within it."""
    local = np.abs((points - boxes.centre[b, :2]) @ boxes.axes[b, :2, :2].T) - boxes.half[b, :2]
    return np.hypot(*np.moveaxis(np.maximum(local, 0), -1, 0))


def _check_inside(layout: Layout, boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    size = np.array(layout.room.size)
    extent = np.einsum("bk,bkd->bd", boxes.half, np.abs(boxes.axes))
    outside = np.maximum(extent - boxes.centre, boxes.centre + extent - size)  # [B, 3]
    for b, d in np.argwhere(outside > _TOUCH_M):
        side = ("a wall in x", "a wall in y", "the floor or the ceiling")[d]
        fail(f"obstacle {layout.obstacles[boxes.owner[b]].name} sticks through {side} by {outside[b, d]:.2f} m")
    position = np.array(layout.ap.position)
    if (position < 0).any() or (position > size).any():
        fail(f"ap.position: {list(layout.ap.position)} is not allowed: the room spans 0 to {list(layout.room.size)}")
    local = np.abs(np.einsum("bkd,bd->bk", boxes.axes, position - boxes.centre))
    for b in np.flatnonzero((local < boxes.half).all(axis=1)):
        name = layout.obstacles[boxes.owner[b]].name
        fail(f"ap.position: {list(layout.ap.position)} is not allowed: it lies within obstacle {name}")


def _check_overlaps(layout: Layout, boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    i, j = np.nonzero(boxes.owner[:, None] < boxes.owner)
    # Separating axes: as all boxes share z, the sides of both are all the directions that need a look.
    normals = np.concatenate([boxes.axes[i], boxes.axes[j]], axis=1)  # [P, 6, 3]
    reach = sum(np.einsum("pk,pnk->pn", boxes.half[b], np.abs(normals @ boxes.axes[b].swapaxes(1, 2))) for b in (i, j))
    apart = np.abs(np.einsum("pnd,pd->pn", normals, boxes.centre[j] - boxes.centre[i]))
    depth = (reach - apart).min(axis=1)
    for pair in np.flatnonzero(depth > _OVERLAP_M):
        first, second = (layout.obstacles[boxes.owner[b[pair]]].name for b in (i, j))
        fail(f"obstacles {first} and {second} overlap by {depth[pair]:.2f} m")


def _standing(boxes: _Boxes) -> NDArray[np.intp]:
    """Indices of the bricks that occupy floor."""
    return np.flatnonzero(boxes.centre[:, 2] - boxes.half[:, 2] < OVERHEAD_M)


def _wall_distance(points: _Floats, room: Room) -> _Floats:
    """Distance from points [..., 2] to the nearest wall [m]; negative outside."""
    return np.minimum(points, np.array(room.size[:2]) - points).min(axis=-1)


def _check_start(layout: Layout, boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    start = np.array(layout.start)
    shown = f"rover.start: {list(layout.start)} is not allowed"
    if _wall_distance(start, layout.room) < ROVER_RADIUS_M:
        fail(f"{shown}: it must be at least {ROVER_RADIUS_M} m inside the room's walls")
    for b in _standing(boxes):
        if _plan_distance(start, boxes, b) < ROVER_RADIUS_M:
            fail(f"{shown}: it is within {ROVER_RADIUS_M} m of obstacle {layout.obstacles[boxes.owner[b]].name}")


def _check_floor(layout: Layout, boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    floor_m2 = layout.room.size[0] * layout.room.size[1]
    area = _reachable_m2(layout, boxes)
    least = max(_LEAST_FLOOR_M2, _LEAST_FLOOR_SHARE * floor_m2)
    if area < least:
        fail(f"no free floor: the rover can reach {area:.1f} m² from its start, and at least {least:.1f} m² are needed")


def _reachable_m2(layout: Layout, boxes: _Boxes) -> float:
    """Area connected to the rover's start where everything is further than the passage clearance [m²]."""
    x, y = (np.arange(_GRID_M / 2, side, _GRID_M) for side in layout.room.size[:2])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    free = _wall_distance(points, layout.room) > _PASSAGE_M
    for b in _standing(boxes):
        free &= _plan_distance(points, boxes, b) > _PASSAGE_M
    from_start = np.where(free, np.linalg.norm(points - layout.start, axis=-1), np.inf)
    reached = np.zeros_like(free)
    reached.flat[from_start.argmin()] = True
    reached &= free
    while True:  # flood fill, one ring a pass
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= free
        if (grown == reached).all():
            return float(reached.sum()) * _GRID_M**2
        reached = grown
