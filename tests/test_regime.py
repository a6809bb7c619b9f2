"""The sweep of regimes: a row each, resumed, and rivals that differ in what they know."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mjris.config import ConfigError, preset
from mjris.simulation.outlook import best_goals
from mjris.simulation.simulator import Simulator

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
regime = importlib.import_module("regime")


def test_a_row_a_regime_that_is_not_played_twice(monkeypatch, tmp_path, capsys):
    out = tmp_path / "regime.csv"
    monkeypatch.setattr(regime.parking, "best_spot", lambda *_: regime.parking.Spot(7.0, 9.0, 90.0))
    sweep = regime.Sweep(regimes=("classic",), scenes=3, slots=2, seeds=(1, 2), out=out)
    regime.main(sweep)
    first = out.read_text()
    table = pd.read_csv(out)
    assert table["seed"].tolist() == [1, 2]
    assert table["map_collisions"].tolist() == table["fixed_collisions"].tolist() == [0, 0]
    expected = 100 * (table["map_mbps"] / table["fixed_mbps"] - 1)
    np.testing.assert_allclose(table["over_fixed_percent"], expected, atol=1e-3)
    assert capsys.readouterr().out.count("\n| classic |") == 2
    monkeypatch.setattr(regime, "judged", None)
    regime.main(sweep)
    assert out.read_text() == first


def test_every_regime_can_be():
    for name, changes in regime.REGIMES.items():
        assert (regime.changed(preset("office"), changes) == preset("office")) == (name == "office")
    for name in regime.PRESETS:
        assert preset(name) != preset("office")
    with pytest.raises(ConfigError, match="regimes: 'moon' is not known"):
        regime.main(regime.Sweep(regimes=("moon",)))


def test_who_believes_in_sight_drives_elsewhere_where_there_are_walls_and_nowhere_else(tmp_path):
    empty = tmp_path / "empty.toml"
    ap = "ap.position = [7.5, 19.8, 2.6]\nap.facing_deg = 270.0\n"
    empty.write_text(f"room.size = [15.0, 20.0, 3.0]\n{ap}rover.start = [7.5, 10.0]\n")
    for layout, differ in (("practice", True), (str(empty), False)):
        config = preset("classic")
        simulator = Simulator(replace(config, world=replace(config.world, layout=layout), seed=3), 6)
        knows, believes = best_goals(simulator)[0], best_goals(simulator, walls=False)[0]
        assert (np.abs(knows - believes).max(1) > 1e-9).any() == differ
