import math
from pathlib import Path

import numpy as np
import pytest

from mjris.config import Config, ConfigError, Radio, World
from mjris.world import placement
from mjris.world.layout import load_layout
from mjris.world.office import PERSON_RADIUS_M
from mjris.world.world import World as Cells

APART_M = 2 * PERSON_RADIUS_M + 0.15
FROM_ROVER_M = 0.25 + PERSON_RADIUS_M + 0.15
FROM_WALL_M = PERSON_RADIUS_M + 0.15


def hall(tmp_path: Path, side_m: float) -> str:
    """An empty square room whose rover starts in the middle."""
    path, middle = tmp_path / "hall.toml", side_m / 2
    path.write_text(
        f"room.size = [{side_m}, {side_m}, 3]\nap.position = [{middle}, {side_m - 0.1}, 2.6]\n"
        f"ap.facing_deg = 270\nrover.start = [{middle}, {middle}]\n"
    )
    return str(path)


def cells(num_users: int, count: int = 1, **world) -> Cells:
    config = Config(world=World(num_users=num_users, drive="kinematic", **world), radio=Radio(num_clusters=1))
    return Cells(config, load_layout(config.world.layout), [np.random.default_rng(e) for e in range(count)])


def placed(made: Cells, seed: int) -> np.ndarray:
    """People of the first cell [K, 2]."""
    made.place(np.array([0]), [np.random.default_rng(seed)])
    return made.crowd.xy[0]


def assert_kept(people: np.ndarray, side_m: float) -> None:
    apart = np.linalg.norm(people[:, None] - people, axis=-1) + 10 * np.eye(len(people))
    assert apart.min() >= APART_M - 1e-12
    assert np.minimum(people, side_m - people).min() >= FROM_WALL_M - 1e-12
    assert np.linalg.norm(people - side_m / 2, axis=-1).min() >= FROM_ROVER_M - 1e-12


def test_as_many_as_are_promised_find_places_whatever_the_luck(tmp_path, monkeypatch):
    path = hall(tmp_path, 5.0)
    # Free is what is within the walls' distance, without the rover's disc; a person takes a disc of APART_M.
    free_m2 = (5 - 2 * FROM_WALL_M) ** 2 - math.pi * FROM_ROVER_M**2
    limit = 1 + free_m2 / (math.pi * APART_M**2)
    with pytest.raises(ConfigError, match=r"^world\.num_users: 40 is not allowed: .* 'hall' .* for \d+ people") as no:
        cells(40, layout=path)
    most = int(str(no.value).split()[-2])
    assert 0.8 * limit < most <= limit
    with pytest.raises(ConfigError, match=f"world.num_users: {most + 1} is not allowed"):
        cells(most + 1, layout=path)
    made = cells(most, layout=path)
    for seed in range(20):
        assert_kept(placed(made, seed), 5.0)
    monkeypatch.setattr(placement, "_TRIES", 1)
    for seed in range(20):
        assert_kept(placed(made, seed), 5.0)


def test_nobody_may_be_left_to_place_in_a_narrow_room(tmp_path):
    with pytest.raises(ConfigError, match=r"at world.clearance_m 1.0 layout 'hall' is sure to have room for 0 people"):
        cells(1, layout=hall(tmp_path, 3.5), clearance_m=1.0)


def test_furniture_of_their_own_is_counted_for_every_cell(monkeypatch):
    counted = []
    monkeypatch.setattr(placement.Placement, "_most", lambda _, places: counted.append(places) or 10)
    cells(4, count=3, layout="open", layout_jitter_m=0.3)
    assert len(set(counted)) == 3


def test_places_are_even_over_what_is_free(tmp_path):
    made = cells(1, layout=hall(tmp_path, 6.0))
    people = np.concatenate([placed(made, seed) for seed in range(1500)]) - 3
    reach, radius = 3 - FROM_WALL_M, np.linalg.norm(people, axis=-1)
    free_m2 = 4 * reach**2 - math.pi * FROM_ROVER_M**2
    within = math.pi * (2**2 - FROM_ROVER_M**2) / free_m2
    error = math.sqrt(within * (1 - within) / 1500)
    assert (radius < 2).mean() == pytest.approx(within, abs=4 * error)
    np.testing.assert_allclose(people.mean(0), 0, atol=4 * reach / math.sqrt(3 * 1500))


def test_where_the_rover_stands_shifts_the_luck_of_nobody_else():
    here, there = cells(12, layout="open"), cells(12, layout="open", start_m=(2.0, 12.0))
    same = []
    for seed in range(30):
        rngs = [np.random.default_rng(seed) for _ in range(2)]
        for made, rng in zip((here, there), rngs, strict=True):
            made.place(np.array([0]), [rng])
        assert rngs[0].bit_generator.state == rngs[1].bit_generator.state
        same.append((here.crowd.xy[0] == there.crowd.xy[0]).all(-1))
    # Only who would stand where one of the rovers is goes elsewhere, and perhaps who would have stood there.
    assert 0.9 < np.mean(same) < 1
