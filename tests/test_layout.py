import math
from dataclasses import replace

import numpy as np
import pytest

from mjris.config import ConfigError, preset
from mjris.world import layout as layout_module
from mjris.world.layout import Layout, layout_names, load_layout
from mjris.world.layout_checks import check_layout
from mjris.world.office import build
from mjris.world.sight import Sight

HEAD = """
room.size = [6.0, 5.0, 3.0]
ap.position = [3.0, 4.9, 2.6]
ap.facing_deg = 270.0
rover.start = [3.0, 2.0]
"""

BOX = """
[kinds.box]
bricks = [{ at = [0, 0, 0.5], size = [1.0, 0.5, 1.0], material = "wood" }]
"""


def load(tmp_path, obstacles: str, head: str = HEAD, kinds: str = BOX) -> Layout:
    path = tmp_path / "mine.toml"
    path.write_text(f"{head}\nobstacle = [{obstacles}]\n{kinds}")
    return load_layout(str(path))


def bricks(layout: Layout):
    """Every brick as (obstacle, rotation room -> brick [3, 3], centre [3], half size [3])."""
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        rotation = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        for brick in obstacle.bricks:
            centre = [*obstacle.position, 0] + rotation.T @ brick.at
            yield obstacle, rotation, centre, np.array(brick.size) / 2


def in_sight(layout: Layout, source, targets) -> np.ndarray:
    """Slab test: whether the segments from source [3] to targets [n, 3] meet no brick, [n]."""
    clear = np.ones(len(targets), bool)
    for _, rotation, centre, half in bricks(layout):
        origin = rotation @ (source - centre)
        direction = (targets - source) @ rotation.T
        with np.errstate(divide="ignore"):
            ends = np.stack([(-half - origin) / direction, (half - origin) / direction])
        enter, leave = ends.min(0).max(-1), ends.max(0).min(-1)
        clear &= ~((enter < leave) & (leave > 0) & (enter < 1))
    return clear


def free_floor(layout: Layout, clearance: float, grid: float = 0.125) -> tuple[np.ndarray, np.ndarray]:
    """Points of the floor [nx, ny, 2], and whether they keep clear of walls and of bricks below 2 m, [nx, ny]."""
    size = np.array(layout.room.size[:2])
    points = np.stack(np.meshgrid(*(np.arange(grid / 2, side, grid) for side in size), indexing="ij"), -1)
    free: np.ndarray = np.all(np.minimum(points, size - points) >= clearance, axis=-1)
    for _, rotation, centre, half in bricks(layout):
        if centre[2] - half[2] < 2:
            beyond = np.abs((points - centre[:2]) @ rotation[:2, :2].T) - half[:2]
            free = free & (np.linalg.norm(np.maximum(beyond, 0), axis=-1) > clearance)
    return points, free


def connected(free: np.ndarray, seed: tuple[int, int]) -> int:
    """How many free cells a walk in four directions from the seed visits."""
    stack, seen = [seed], {seed}
    while stack:
        i, j = stack.pop()
        for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if all(0 <= k < n for k, n in zip(cell, free.shape, strict=True)) and free[cell] and cell not in seen:
                seen.add(cell)
                stack.append(cell)
    return len(seen)


def shadow(layout: Layout, clearance: float) -> float:
    points, free = free_floor(layout, clearance)
    receivers = np.concatenate([points[free], np.full((free.sum(), 1), 1.1)], axis=-1)
    return 1 - in_sight(layout, np.array(layout.ap.position), receivers).mean()


@pytest.mark.parametrize("clearance", [0.0, 0.37])
def test_office_has_radio_shadow(clearance):
    assert 0.25 <= shadow(load_layout("office"), clearance) <= 0.5


def test_layouts_differ_in_radio_shadow():
    assert shadow(load_layout("open"), 0.37) < 0.2
    assert shadow(load_layout("clinic"), 0.37) > 0.45


def test_office_shadow_can_be_served_from_places_that_see_the_ap():
    layout = load_layout("office")
    ap = np.array(layout.ap.position)
    points, free = free_floor(layout, 0.42, grid=0.5)
    panels = np.concatenate([points[free], np.full((free.sum(), 1), 1.5)], axis=-1)
    panels = panels[in_sight(layout, ap, panels)]
    users = np.concatenate([points[free], np.full((free.sum(), 1), 1.1)], axis=-1)
    users = users[~in_sight(layout, ap, users)]
    serving = np.array([in_sight(layout, user, panels).sum() for user in users])
    assert serving.min() > 0
    assert np.median(serving) > 50


@pytest.mark.parametrize("name", layout_names())
def test_rover_reaches_nearly_all_free_floor(name):
    layout = load_layout(name)
    points, free = free_floor(layout, 0.42)
    seed = np.unravel_index(np.linalg.norm(points - layout.start, axis=-1).argmin(), free.shape)
    assert free[seed]
    assert connected(free, (int(seed[0]), int(seed[1]))) > 0.98 * free.sum()


def test_office_is_light_enough_to_simulate():
    layout = load_layout("office")
    assert layout.room.size == (15, 20, 3)
    assert len(layout.obstacles) <= 35
    assert sum(len(obstacle.bricks) for obstacle in layout.obstacles) <= 95


def test_every_bundled_brick_has_a_material_of_the_scene():
    materials = layout_module._material_names()
    for name in layout_names():
        assert {brick.material for obstacle in load_layout(name).obstacles for brick in obstacle.bricks} <= set(
            materials
        )


def test_obstacles_are_named_and_placed(tmp_path):
    layout = load(tmp_path, '{ kind = "box", at = [1, 1] }, { kind = "box", at = [1, 3.5], facing_deg = 90 }')
    assert layout.name == "mine"
    assert [obstacle.name for obstacle in layout.obstacles] == ["box_1", "box_2"]
    assert layout.obstacles[1].position == (1, 3.5)
    assert layout.obstacles[1].yaw == pytest.approx(math.pi / 2)
    assert layout.ap.facing == pytest.approx(3 * math.pi / 2)


def test_a_layout_overrides_kinds_of_the_furniture(tmp_path):
    layout = load(tmp_path, '{ kind = "sofa", at = [1, 1] }', kinds=BOX.replace("box", "sofa"))
    assert [brick.size for brick in layout.obstacles[0].bricks] == [(1, 0.5, 1)]


def test_array_of_tables_reads_the_same(tmp_path):
    inline = load(tmp_path, '{ kind = "box", at = [1, 1] }')
    path = tmp_path / "mine.toml"
    path.write_text(f'{HEAD}{BOX}[[obstacle]]\nkind = "box"\nat = [1, 1]\n')
    assert load_layout(str(path)) == inline


def test_touching_the_walls_and_each_other_is_allowed(tmp_path):
    layout = load(tmp_path, '{ kind = "box", at = [0.5, 0.25] }, { kind = "box", at = [1.5, 0.25] }')
    assert len(layout.obstacles) == 2


@pytest.mark.parametrize(
    ("at", "facing", "overlap"),
    [
        ([2.0, 1.0], 0, False),  # end to end
        ([1.98, 1.0], 0, True),
        ([1.0, 1.76], 90, False),  # a T, 1 cm apart
        ([1.0, 1.72], 90, True),
        ([1.735, 1.735], 45, False),  # a corner before the turned box, whose axes alone separate them
        ([1.715, 1.715], 45, True),
    ],
)
def test_overlaps_are_found_at_any_angle(tmp_path, at, facing, overlap):
    obstacles = f'{{ kind = "box", at = [1, 1] }}, {{ kind = "box", at = {at}, facing_deg = {facing} }}'
    if overlap:
        with pytest.raises(ConfigError, match="obstacles box_1 and box_2 overlap by 0"):
            load(tmp_path, obstacles)
    else:
        load(tmp_path, obstacles)


WALL = """
[kinds.wall]
bricks = [{ at = [0, 0, 1.5], size = [0.1, 2.0, 3.0], material = "plaster" }]
[kinds.low]
bricks = [{ at = [0, 0, 0.5], size = [0.1, 2.0, 1.0], material = "plaster" }]
[kinds.two]
bricks = [
  { at = [0, 0, 1.5], size = [0.1, 2.0, 3.0], material = "plaster" },
  { at = [0, 1.5, 1.5], size = [0.1, 1.0, 3.0], material = "plaster" },
]
"""


@pytest.mark.parametrize(
    ("kind", "at", "facing", "joint"),
    [
        ("wall", [1.5, 4.5], 0, True),  # one line, touching
        ("wall", [1.5, 4.45], 0, True),  # one line, sharing 5 cm
        ("wall", [1.5, 4.35], 0, False),  # sharing more than they are thick
        ("wall", [1.52, 2.5], 0, False),  # one within the other
        ("wall", [1.35, 4.0], 10, False),  # nearly so
        ("wall", [2.45, 3.45], 90, True),  # an L
        ("wall", [2.45, 2.5], 90, True),  # a T
        ("wall", [1.5, 2.5], 90, True),  # a cross
        ("wall", [2.0, 2.9], 60, True),  # askew
        ("low", [2.45, 2.5], 90, False),  # furniture
        ("two", [2.45, 2.5], 90, False),
        ("box", [1.5, 2.5], 90, False),
    ],
)
def test_walls_may_meet_at_joints(tmp_path, kind, at, facing, joint):
    items = f'{{ kind = "wall", at = [1.5, 2.5] }}, {{ kind = "{kind}", at = {at}, facing_deg = {facing} }}'
    head = HEAD.replace("[6.0, 5.0, 3.0]", "[6.0, 6.0, 3.0]").replace("[3.0, 2.0]", "[4.5, 4.5]")
    if joint:
        assert len(load(tmp_path, items, head, BOX + WALL).obstacles) == 2
    else:
        with pytest.raises(ConfigError, match=r"obstacles wall_1 and .*_[12] overlap by 0"):
            load(tmp_path, items, head, BOX + WALL)


def test_a_plan_of_many_walls_with_joints(tmp_path):
    """Rooms of 3 m along both sides of a corridor, each wall 5 cm into those that it meets."""
    rows = [f'{{ kind = "long", at = [{6 * i + 3.1}, {y}], facing_deg = 90 }}' for y in (3.0, 6.0) for i in range(8)]
    across = [f'{{ kind = "cross", at = [{3 * i + 3}, {y}] }}' for y in (1.5, 7.5) for i in range(16)]
    kinds = "\n".join(
        f'[kinds.{name}]\nbricks = [{{ at = [0, 0, 1.5], size = [0.1, {length}, 3.0], material = "plaster" }}]'
        for name, length in (("long", 6.1), ("cross", 3.0))
    )
    head = "room.size = [49.0, 9.0, 3.0]\nap.position = [1, 4.5, 2.6]\nap.facing_deg = 0.0\nrover.start = [4.5, 4.5]\n"
    made = load(tmp_path, ", ".join(rows + across), head, kinds)
    assert len(made.obstacles) == 48
    # From the corridor through the joint of a long wall and one across: both are counted.
    sight = Sight([build(preset("classic"), made)])
    start, end = np.array([[[4.5, 4.5, 1.5]]]), np.array([[[7.5, 0.5, 1.5]]])
    joint = start + (end - start) * 0.375  # at (5.6, 3.0): the long wall alone, then the one across at x = 6
    assert joint[0, 0, 1] == pytest.approx(3.0)
    assert sight.blockers(start, end).tolist() == [[2]]
    assert sight.blockers(start, np.array([[[5.9, 0.5, 1.5]]])).tolist() == [[1]]


def test_walls_are_lines_on_the_plan(tmp_path):
    walls = """wall = [
      { from = [1.0, 0.0], to = [1.0, 2.0] },
      { from = [1.0, 2.0], to = [2.5, 3.5], thickness_m = 0.2, height_m = 1.4, material = "glass" },
    ]
    """
    made = load(tmp_path, '{ kind = "wall", at = [5.0, 2.0] }', HEAD + walls, WALL)
    first, second, third = made.obstacles
    assert [obstacle.name for obstacle in made.obstacles] == ["wall_1", "wall_2", "wall_3"]
    assert (first.position, second.position, third.position) == ((1.0, 1.0), (1.75, 2.75), (5.0, 2.0))
    assert (first.yaw, second.yaw) == (pytest.approx(math.pi / 2), pytest.approx(math.pi / 4))
    assert first.bricks[0].size == (2.0, 0.12, 3.0)
    assert second.bricks[0].size == pytest.approx((1.5 * math.sqrt(2), 0.2, 1.4))
    assert (second.bricks[0].at, second.bricks[0].material) == ((0.0, 0.0, 0.7), "glass")


@pytest.mark.parametrize(
    ("wall", "message"),
    [
        ("from = [1, 1], to = [1, 1]", r"wall.0.to: \[1.0, 1.0\] is not allowed: the wall begins there, too"),
        ("from = [1, 1], to = [1, 9]", "obstacle wall_1 sticks through a wall in y by 4.00 m"),
        ("from = [1, 1], to = [1, 2], thickness_m = 0.5", "wall.0.thickness_m: 0.5 is not allowed"),
        ("from = [1, 1], to = [1, 2], height_m = 4", "obstacle wall_1 sticks through the floor or the ceiling"),
        ('from = [1, 1], to = [1, 2], material = "cheese"', "wall.0.material: 'cheese' is not known"),
        ("to = [1, 2]", "wall.0.from"),
    ],
)
def test_walls_that_cannot_be_are_refused(tmp_path, wall, message):
    with pytest.raises(ConfigError, match=message) as error:
        load(tmp_path, "", HEAD + f"wall = [{{ {wall} }}]\n")
    assert "\n" not in str(error.value)


def test_stacked_obstacles_do_not_overlap(tmp_path):
    lamp = '[kinds.lamp]\nbricks = [{ at = [0, 0, 2.5], size = [0.5, 0.5, 0.5], material = "metal" }]'
    layout = load(tmp_path, '{ kind = "box", at = [1, 1] }, { kind = "lamp", at = [1, 1] }', kinds=BOX + lamp)
    assert layout.obstacles[1].name == "lamp_1"


def test_bricks_overhead_leave_the_start_free(tmp_path):
    lamp = '[kinds.lamp]\nbricks = [{ at = [0, 0, 2.5], size = [6.0, 4.0, 0.5], material = "metal" }]'
    assert load(tmp_path, '{ kind = "lamp", at = [3, 2] }', kinds=lamp).start == (3, 2)


@pytest.mark.parametrize(
    ("obstacles", "head", "kinds", "message"),
    [
        (
            '{ kind = "throne", at = [1, 1] }',
            HEAD,
            BOX,
            "obstacle.0.kind: 'throne' is not known: it is one of .*box.*sofa",
        ),
        ("", HEAD, BOX.replace("wood", "cheese"), "kinds.box.bricks.0.material: 'cheese' is not known: .*wood"),
        ("", HEAD, BOX.replace("0.5, 1.0]", "0.0, 1.0]"), "bricks.0.size.1: 0.0 is not allowed: .* greater than 0"),
        ("", HEAD, "[kinds.box]\nbricks = []", "kinds.box.bricks: .* is not allowed"),
        ("", HEAD, "[kinds.box]\nbrick = []", "kinds.box.bricks? is"),
        ("", HEAD.replace("6.0", "nan"), BOX, "room.size.0: nan is not allowed"),
        ("", HEAD.replace("6.0, ", ""), BOX, "room.size.2 is missing"),
        ("", HEAD.replace("rover", "robot"), BOX, "ro(ver is missing|bot is not a known field)"),
        ("", HEAD.replace("2.6]", "3.6]"), BOX, r"ap.position: \[3.0, 4.9, 3.6\] is not allowed: the room spans"),
        ("", HEAD.replace("2.6]", "0.0]"), BOX, r"ap.position: \[3.0, 4.9, 0.0\] is not allowed: .* must lie within"),
        ("", HEAD.replace("2.6]", "3.0]"), BOX, r"ap.position: \[3.0, 4.9, 3.0\] is not allowed: .* must lie within"),
        ("", HEAD.replace("4.9,", "5.0,"), BOX, r"ap.position: \[3.0, 5.0, 2.6\] is not allowed: .* must lie within"),
        ('{ kind = "box", at = [0.3, 1] }', HEAD, BOX, "obstacle box_1 sticks through a wall in x by 0.20 m"),
        ('{ kind = "box", at = [1, 4.6], facing_deg = 90 }', HEAD, BOX, "box_1 sticks through a wall in y by 0.10 m"),
        ('{ kind = "box", at = [1, 1] }', HEAD, BOX.replace("0.5]", "2.7]"), "sticks through the floor or the ceiling"),
        (
            '{ kind = "box", at = [3, 4.75] }',
            HEAD,
            BOX.replace("[0, 0, 0.5]", "[0, 0, 2.5]"),
            "ap.position: .* within obstacle box_1",
        ),
        ("", HEAD, "[kinds.", "is not valid TOML"),
    ],
)
def test_bad_layouts_are_refused(tmp_path, obstacles, head, kinds, message):
    with pytest.raises(ConfigError, match=message) as caught:
        load(tmp_path, obstacles, head, kinds)
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "message"), [("ofice", "clinic, office, open"), ("gone.toml", "cannot be read")])
def test_unknown_layouts(name, message):
    with pytest.raises(ConfigError, match=message):
        load_layout(name)


def test_check_layout_says_where_the_layout_comes_from():
    layout = load_layout("open")
    moved = replace(layout, obstacles=(replace(layout.obstacles[0], position=(-1.0, 5.0)), *layout.obstacles[1:]))
    with pytest.raises(ConfigError, match=r"^jittered: obstacle pillar_1 sticks through a wall in x"):
        check_layout(moved, source="jittered")
