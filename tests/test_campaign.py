import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mjris.config import ConfigError
from mjris.world.layout import AccessPoint, Brick, Layout, Obstacle, Room


def load_campaign():
    path = Path(__file__).parents[1] / "scripts" / "campaign.py"
    spec = importlib.util.spec_from_file_location("campaign", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["campaign"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


campaign = load_campaign()


def leg(drive: str, layout: str, jitter_m: float, slots: int, cells: int):
    return campaign.Leg(drive, layout, jitter_m, 12, cells=cells, slots=slots, seed=7)


def needed_m(world) -> float:
    """The least bumper that is allowed at the speed, tick and mast of `world`."""
    try:
        replace(world, bumper_m=0.02)
    except ConfigError as refused:
        return float(str(refused).split(" needs ")[1].split()[0])
    return 0.02


@pytest.mark.parametrize(
    ("drive", "layout", "jitter_m", "slots", "cells"),
    [
        ("kinematic", "office", 0.0, 40, 20),
        ("kinematic", "clinic", 0.0, 40, 20),
        ("kinematic", "open", 0.3, 40, 5),
        ("wheels", "office", 0.0, 12, 10),
        ("wheels", "clinic", 0.0, 12, 10),
        ("wheels", "open", 0.0, 12, 10),
    ],
)
def test_a_short_campaign_keeps_every_promise(drive, layout, jitter_m, slots, cells):
    ticks = []
    log = campaign.play(leg(drive, layout, jitter_m, slots, cells), lambda: ticks.append(None))
    assert len(ticks) == slots
    assert log.penetrations.shape == (slots, cells)
    assert not log.broken.any()
    # The drivers are hostile enough to reach the bumper's distance, and fast enough to try the limit.
    assert log.clearance_m.min() < 0.15
    assert log.speed_mps.max() > 0.4


@pytest.mark.parametrize("drive", ["kinematic", "wheels"])
@pytest.mark.parametrize("corner", campaign.CORNERS)
def test_a_short_campaign_keeps_every_promise_at_the_corners(corner, drive):
    slots = 2 if "slot" in corner else 10
    played = campaign.Leg(drive, "office", 0.0, 12, cells=10, slots=slots, seed=7, corner=corner)
    world = played.config.world
    if corner not in ("widest panel", "fast walkers"):
        assert world.bumper_m - needed_m(world) < 0.01  # else it were no corner
    log = campaign.play(played, lambda: None)
    assert not log.broken.any()
    assert log.clearance_m.min() < world.bumper_m + 0.05
    assert log.speed_mps.max() > 0.6 * world.max_speed_mps


def test_each_broken_promise_shows():
    kept = {"penetrations": 0, "clearance_m": 0.1, "speed_mps": 0.5, "inside": True}

    def broken(**change) -> bool:
        parts = {name: np.array([[part]]) for name, part in (kept | change).items()}
        return campaign.Log(**parts, speed_limit_mps=0.5).broken.item()

    assert not broken()
    assert broken(penetrations=1)
    assert broken(clearance_m=-1e-6)
    assert broken(speed_mps=0.51)
    assert broken(inside=False)


def test_the_plan_has_the_slots_that_were_asked_for():
    legs = campaign.plan(campaign.Campaign(kinematic_slots=5000, wheels_slots=700, corner_slots=60, cells=7))
    within = [leg for leg in legs if leg.corner == "within"]
    for drive, wanted in [("kinematic", 5000), ("wheels", 700)]:
        slots = sum(leg.slots * leg.cells for leg in within if leg.drive == drive)
        assert wanted <= slots <= wanted + 9 * 7
        assert [leg.slots * leg.cells for leg in legs if leg.drive == drive][9:] == [63] * len(campaign.CORNERS)
    assert {leg.layout for leg in within} == {"office", "open", "clinic"}
    assert {leg.num_users for leg in within} == {4, 12}
    assert campaign.plan(campaign.Campaign(corner_slots=0))[-1].corner == "within"


def test_a_broken_promise_ends_in_status_one(monkeypatch, capsys):
    def broken(leg, on_slot):
        on_slot()
        penetrations = np.zeros((leg.slots, leg.cells), int)
        penetrations[0, 3] = leg.drive == "wheels"
        fine = np.full((leg.slots, leg.cells), 0.2)
        return campaign.Log(penetrations, fine, fine, fine > 0, 0.5)

    short = campaign.Campaign(kinematic_slots=90, wheels_slots=90, cells=5)
    monkeypatch.setattr(campaign, "play", broken)
    assert campaign.main(short) == 1
    assert "cell 3, slot 0" in " ".join(capsys.readouterr().out.split())
    monkeypatch.setattr(campaign, "plan", lambda _: [leg("kinematic", "open", 0.0, slots=2, cells=5)])
    assert campaign.main(short) == 0


def test_distances_to_bricks_and_walls_by_hand():
    low = Brick(at=(1.0, 0.0, 0.25), size=(0.4, 0.2, 0.5), material="wood")
    high = Brick(at=(0.0, 0.0, 2.9), size=(5.0, 5.0, 0.1), material="wood")  # over the hull
    layout = Layout(
        name="one",
        room=Room(size=(10, 8, 3)),
        ap=AccessPoint(position=(5, 7.9, 2.6), facing_deg=270.0),
        start=(8, 4),
        obstacles=(Obstacle(name="low", position=(5.0, 4.0), yaw=np.pi / 2, bricks=(low, high)),),
    )
    solid = campaign.Solid([layout], 1.7)
    np.testing.assert_allclose(solid.centre, [[[5.0, 5.0]]])
    points = np.array([[[5.0, 4.0], [5.0, 5.1], [5.4, 5.6], [1.0, 4.0], [9.8, 1.0]]])
    # Turned by a right angle, the brick spans 4.9 to 5.1 and 4.8 to 5.2.
    np.testing.assert_allclose(solid.distance(points)[0], [0.8, 0, 0.5, 1.0, 0.2], atol=1e-12)
