import math
import re

import numpy as np
import pytest

from mjris.config import Config, ConfigError, Radio, World, from_dict
from mjris.simulation.simulator import Simulator
from mjris.world.fit import check_fit, kept_distance
from mjris.world.layout import AccessPoint, Brick, Layout, Obstacle, Room, load_layout

CABINET = Brick(at=(0, 0, 0.6), size=(0.5, 1.0, 1.2), material="wood")
SHELF = Brick(at=(0, 0, 2.0), size=(0.5, 1.0, 0.3), material="wood")


def layout(*bricks: Brick, gap_m: float = 0.55, start: tuple[float, float] = (3.0, 3.0), size=(8, 6, 3)) -> Layout:
    """A room with a start, and an obstacle whose western side is `gap_m` east of (3, 3)."""
    return Layout(
        name="mine",
        room=Room(size=size),
        ap=AccessPoint(position=(4, 5.9, 2.1), facing_deg=270.0),
        start=start,
        obstacles=(Obstacle(name="cabinet_1", position=(3.25 + gap_m, 3.0), yaw=0.0, bricks=bricks),) if bricks else (),
    )


def test_what_the_rover_keeps_is_hull_and_bumper():
    assert kept_distance(Config()) == pytest.approx(0.25 + 0.1)
    wide = Config(radio=Radio(panel_cols=12), world=World(bumper_m=0.2))
    assert kept_distance(wide) == pytest.approx(math.hypot(12 * 0.149896229 / 4 + 0.02, 0.02) + 0.2)


@pytest.mark.parametrize("columns", [7, 12, 30])
def test_the_start_has_room_for_the_hull_of_the_config(columns):
    # Half the panel, its frame and the bumper: 6 columns need the smallest hull's 0.35 m, 7 need 0.383 m.
    made = layout(CABINET, gap_m=0.36)
    check_fit(Config(radio=Radio(panel_cols=6)), made)
    refused = rf"^rover\.start: \[3\.0, 3\.0\] .* cabinet_1 is 0\.36 m .* radio\.panel_cols {columns} and"
    with pytest.raises(ConfigError, match=refused):
        check_fit(Config(radio=Radio(panel_cols=columns)), made)


def test_a_cabinet_beside_the_start_and_a_panel_of_twelve_columns():
    made = layout(CABINET)
    check_fit(Config(radio=Radio(panel_cols=11)), made)
    with pytest.raises(ConfigError, match=r"obstacle cabinet_1 is 0\.55 m away"):
        check_fit(Config(radio=Radio(panel_cols=12)), made)


def test_what_hangs_over_the_hull_leaves_the_start_free():
    made = layout(SHELF, gap_m=-0.2)
    check_fit(Config(), made)
    with pytest.raises(ConfigError, match=r"obstacle cabinet_1 is 0\.00 m away"):
        check_fit(Config(world=World(panel_height_m=1.8)), made)


def test_a_start_of_the_config_is_checked_by_its_own_name():
    made = layout(CABINET, start=(-5.0, 1.0))
    check_fit(Config(world=World(start_m=(1.0, 1.0))), made)
    for start, why in [((3.4, 3.0), "obstacle cabinet_1 is 0.15"), ((7.7, 1.0), "a wall is 0.30"), ((1e300, 1.0), "")]:
        with pytest.raises(ConfigError, match=f"^{re.escape(f'world.start_m: {list(start)} is not allowed: ')}.*{why}"):
            check_fit(Config(world=World(start_m=start)), made)
    with pytest.raises(ConfigError, match=r"^rover\.start: \[-5\.0, 1\.0\] is not allowed: .* a wall is -5\.00 m away"):
        check_fit(Config(), made)


def test_the_panel_stays_between_chassis_and_ceiling():
    # At 2 GHz a row is 7.5 cm high: 34 rows around 1.5 m reach down to 0.216 m, 35 to 0.178 m.
    low = layout(size=(8, 6, 3))
    check_fit(Config(radio=Radio(panel_rows=34)), low)
    for rows, span in [(35, "0.18 m to 2.86 m"), (64, "-0.91 m to 3.95 m")]:
        with pytest.raises(ConfigError, match=f"^radio.panel_rows: {rows} is not allowed: .* {span}, .* at 3 m"):
            check_fit(Config(radio=Radio(panel_rows=rows)), low)
    high = Config(world=World(panel_height_m=2.2))
    check_fit(high, layout(size=(8, 6, 2.41)))
    with pytest.raises(ConfigError, match=r"panel_height_m 2\.2 .* 2\.04 m to 2\.40 m, .* 'mine' at 2\.3 m"):
        check_fit(high, layout(size=(8, 6, 2.3)))


def test_the_aps_array_ends_within_the_walls():
    # Elements 7.5 cm apart, the middle 4 m from either wall.
    made = layout()
    check_fit(Config(radio=Radio(num_antennas=107)), made)
    with pytest.raises(ConfigError, match=r"^radio\.num_antennas: 108 is not allowed: .* 8\.02 m long"):
        check_fit(Config(radio=Radio(num_antennas=108)), made)


def test_a_start_that_is_walled_in_has_no_free_floor():
    sides = [((1, 0, 0.5), (0.1, 2.1, 1)), ((-1, 0, 0.5), (0.1, 2.1, 1)), ((0, 1, 0.5), (1.9, 0.1, 1))]
    pen = [Brick(at=at, size=size, material="wood") for at, size in [*sides, ((0, -1, 0.5), (1.9, 0.1, 1))]]
    made = layout(*pen, gap_m=-0.25)
    with pytest.raises(ConfigError, match=r"'mine' has no free floor: .* can reach 1\.0 m² from its start"):
        check_fit(Config(), made)


def test_a_wide_panel_has_less_floor():
    # Doors of the clinic are 1.5 m wide: 32 columns, 2.4 m, stay in the corridor, which they hardly fit into.
    made = load_layout("clinic")
    check_fit(Config(radio=Radio(panel_cols=8)), made)
    with pytest.raises(ConfigError, match=r"radio\.panel_cols 32"):
        check_fit(Config(radio=Radio(panel_cols=32)), made)


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"world": {"user_height_m": 3.2}}, "world.user_height_m"),
        ({"world": {"user_height_m": 0.0}}, "world.user_height_m"),
        ({"radio": {"panel_rows": 64}}, "radio.panel_rows"),
        ({"radio": {"num_antennas": 400}}, "radio.num_antennas"),
        ({"world": {"start_m": [0.1, 0.1]}}, "world.start_m"),
        ({"world": {"num_users": 4000}}, "world.num_users"),
    ],
)
def test_a_simulator_is_not_made_of_what_does_not_fit(data, field):
    with pytest.raises(ConfigError, match=rf"{field}: .* is not allowed") as raised:
        Simulator(from_dict(data))
    assert "\n" not in str(raised.value)


def test_a_start_heading_may_be_any_angle():
    for heading in (0.0, -725.0, 1e6):
        config = Config(world=World(drive="kinematic", start_heading_deg=heading))
        turned = Simulator(config).world.fleet.heading
        np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * np.radians(heading)), atol=1e-9)
