"""Layouts: what stands where in an office, read from TOML."""

import math
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from mjris.assets import assets_dir
from mjris.config import ConfigError, Positive, validated
from mjris.world.layout_checks import THICKEST_WALL_M, check_layout

T = TypeVar("T")
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
_Floats = NDArray[np.float64]

Side = Annotated[float, Field(ge=2, le=200)]
Height = Annotated[float, Field(ge=2.2, le=20)]
Elements = Annotated[int, Field(ge=1, le=256)]
KindName = Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$")]


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
class Panel:
    """A panel of the RIS at a fixed place: upright, with elements half a wavelength apart."""

    at: tuple[float, float, float]
    """Middle of its elements [m]."""
    facing_deg: float
    """Direction that it faces: 0 is +x, counter-clockwise."""
    rows: Elements
    cols: Elements

    @property
    def facing(self) -> float:
        """Direction that it faces [rad]."""
        return math.radians(self.facing_deg)


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class Layout:
    """An office with everything resolved to bricks."""

    name: str
    room: Room
    ap: AccessPoint
    start: tuple[float, float]
    """Where the rover starts [m]."""
    obstacles: tuple[Obstacle, ...]
    ris: tuple[Panel, ...] = ()
    """Panels beside the rover's, which are as wide and high as the carrier's wavelength has it."""


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
class _Wall:
    """A wall along a line on the floor plan."""

    from_: Annotated[tuple[float, float], Field(alias="from")]
    to: tuple[float, float]
    """The ends of its middle line [m]."""
    thickness_m: Annotated[float, Field(gt=0, le=THICKEST_WALL_M)] = 0.12
    height_m: Positive | None = None
    """To the ceiling by default."""
    material: str = "plaster"


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _Furniture:
    kinds: dict[KindName, _Kind]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class _File:
    room: Room
    ap: AccessPoint
    rover: _Rover
    kinds: dict[KindName, _Kind] = Field(default_factory=dict)
    wall: tuple[_Wall, ...] = ()
    obstacle: tuple[_Item, ...] = ()
    ris: tuple[Panel, ...] = ()


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
    walls = tuple(_wall(wall, index, file.room, materials, path) for index, wall in enumerate(file.wall))
    layout = Layout(
        name=path.stem,
        room=file.room,
        ap=file.ap,
        start=file.rover.start,
        obstacles=walls + _obstacles(file.obstacle, furniture.kinds | file.kinds, len(walls), path),
        ris=file.ris,
    )
    check_layout(layout, source=str(path))
    return layout


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


def _wall(wall: _Wall, index: int, room: Room, materials: list[str], path: Path) -> Obstacle:
    """A wall as an obstacle of one brick."""
    if wall.material not in materials:
        raise ConfigError(
            f"{path}: wall.{index}.material: {wall.material!r} is not known: it is one of {', '.join(materials)}"
        )
    along, height_m = np.subtract(wall.to, wall.from_), wall.height_m or room.size[2]
    length_m = float(np.hypot(*along))
    if length_m == 0:
        raise ConfigError(f"{path}: wall.{index}.to: {list(wall.to)} is not allowed: the wall begins there, too")
    middle = np.add(wall.from_, wall.to) / 2
    size = (length_m, wall.thickness_m, height_m)
    return Obstacle(
        name=f"wall_{index + 1}",
        position=(float(middle[0]), float(middle[1])),
        yaw=math.atan2(along[1], along[0]),
        bricks=(Brick(at=(0.0, 0.0, height_m / 2), size=size, material=wall.material),),
    )


def _obstacles(items: tuple[_Item, ...], kinds: dict[str, _Kind], walls: int, path: Path) -> tuple[Obstacle, ...]:
    count = Counter({"wall": walls})
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
