import math
from dataclasses import replace

import literal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjris.config import ConfigError, preset
from mjris.eval.building import band_plan, leakage_table, leakage_w, storey_height_m
from mjris.eval.floormap import floor_map
from mjris.simulation.simulator import Simulator

OFFICE = preset("classic")
FOUR_FLOORS = replace(OFFICE, federation=replace(OFFICE.federation, num_cells=4))
AP = np.array([3.0, 4.0, 2.6])


@pytest.fixture(scope="module")
def simulator():
    return Simulator(FOUR_FLOORS)


@pytest.fixture(scope="module")
def floor(simulator):
    return floor_map(simulator, resolution_m=1.0, place_resolution_m=1.0)


def test_bands_alternate_between_floors():
    # The paper's example: odd floors on one band, even floors on the other.
    np.testing.assert_array_equal(band_plan(5, 2), [0, 1, 0, 1, 0])
    np.testing.assert_array_equal(band_plan(4, 3), [0, 1, 2, 0])
    np.testing.assert_array_equal(band_plan(1, 1), [0])


@given(st.integers(1, 60), st.integers(2, 9))
def test_floors_on_one_band_are_as_far_apart_as_bands_allow(num_floors, num_bands):
    plan = band_plan(num_floors, num_bands)
    assert len(plan) == num_floors
    assert set(plan.tolist()) == set(range(min(num_floors, num_bands)))
    same = [abs(u - v) for u in range(num_floors) for v in range(u) if plan[u] == plan[v]]
    assert min(same, default=num_bands) == num_bands


@pytest.mark.parametrize(
    ("floors", "bands", "words"),
    [
        (3, 1, "bands: 1 is not allowed: for 3 floors it must be at least 2, so that adjacent floors differ"),
        (1, 0, "bands: 0 is not allowed: for 1 floors it must be at least 1"),
        (0, 2, "floors: 0 is not allowed"),
    ],
)
def test_plans_that_cannot_be_are_refused(floors, bands, words):
    with pytest.raises(ConfigError, match=words):
        band_plan(floors, bands)


def test_leakage_by_hand():
    right_below = np.array([[3.0, 4.0, 1.1]])
    power = leakage_w(right_below, AP, np.array([2, -2, 1]), 3.0, OFFICE.radio)
    # 2 floors up the AP is 6 + 2.6 - 1.1 = 7.5 m away behind two slabs: 66.0206 - 28 + 22.3141 + 15 + 4 = 79.3347 dB;
    # 2 floors down 4.5 m: 66.0206 - 28 + 16.6569 + 19 = 73.6775 dB; 1 up 4.5 m and one slab: 69.6775 dB. 20 dBm go out.
    np.testing.assert_allclose(10 * np.log10(power[:, 0] * 1e3), [-59.3347, -53.6775, -49.6775], atol=1e-4)


def test_leakage_falls_with_the_distance_in_the_plan():
    places = np.array([[[3.0, 4.0, 1.1], [6.0, 8.0, 1.1]]])
    power = leakage_w(places, AP, np.array([-1]), 3.3, OFFICE.radio)
    assert power.shape == (1, 1, 2)
    near, far = 1.8, math.hypot(5, 1.8)
    assert power[0, 0, 0] / power[0, 0, 1] == pytest.approx((far / near) ** 2.55)


def test_the_table_is_what_loops_give(floor, simulator):
    storey_m = storey_height_m(simulator.world.office(0), 0.3)
    assert storey_m == pytest.approx(3.3)
    table = leakage_table(floor, FOUR_FLOORS, storey_m, 2)
    assert table.floors_apart.tolist() == [1, 2, 3]
    assert table.same_band.tolist() == [False, True, False]
    assert set(table.noise_dbm) == {-30.0}
    for n, row in zip((1, 2, 3), table.to_dict("records"), strict=True):
        powers, quiet, loud = [], [], []
        for i, y in enumerate(floor.y_m):
            for j, x in enumerate(floor.x_m):
                if floor.in_furniture[i, j]:
                    continue
                power = 0.0
                for rise in (n * 3.3, -n * 3.3):
                    distance = math.dist((x, y, 1.1 - rise), floor.ap_xyz_m)
                    loss = literal.path_loss_db("paper", distance, n, 2e9)
                    power += 0.1 * 10 ** (-loss / 10)
                snr = 10 ** (floor.snr_db[i, j] / 10)
                powers.append(power)
                quiet.append(math.log2(1 + snr))
                loud.append(math.log2(1 + snr * 1e-6 / (1e-6 + power)))
        mean_dbm = 10 * math.log10(sum(powers) / len(powers) * 1e3)
        worst_dbm = 10 * math.log10(max(powers) * 1e3)
        assert row["interference_dbm"] == pytest.approx(mean_dbm)
        assert row["interference_worst_dbm"] == pytest.approx(worst_dbm)
        assert row["inr_db"] == pytest.approx(mean_dbm + 30)
        assert row["inr_worst_db"] == pytest.approx(worst_dbm + 30)
        assert row["rate_lost_percent"] == pytest.approx(100 * (1 - sum(loud) / sum(quiet)))
        lost = [1 - after / before for before, after in zip(quiet, loud, strict=True)]
        assert row["rate_lost_worst_percent"] == pytest.approx(100 * max(lost))


def test_what_the_paper_neglects_is_below_the_papers_noise(floor):
    second = leakage_table(floor, FOUR_FLOORS, 3.3, 2).iloc[1]
    assert second.inr_worst_db < -20
    assert second.rate_lost_worst_percent < 0.5


def test_more_bands_keep_floors_further_apart(floor):
    assert leakage_table(floor, FOUR_FLOORS, 3.3, 3).same_band.tolist() == [False, False, True]


def test_bad_buildings_are_refused_in_words(floor, simulator):
    alone = replace(OFFICE, federation=replace(OFFICE.federation, num_cells=1))
    with pytest.raises(ConfigError, match=r"federation\.num_cells: 1 is not allowed: leakage takes at least 2 floors"):
        leakage_table(floor, alone, 3.3, 2)
    with pytest.raises(ConfigError, match="bands: 1 is not allowed"):
        leakage_table(floor, FOUR_FLOORS, 3.3, 1)
    for slab_m in (-0.1, math.inf, math.nan):
        with pytest.raises(ConfigError, match="slab_m"):
            storey_height_m(simulator.world.office(0), slab_m)
