"""The bench's bookkeeping; speed itself is no matter for tests."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from mjris.config import preset

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
bench, measures = (importlib.import_module(name) for name in ("bench", "measures"))


@pytest.fixture
def part(monkeypatch, tmp_path):
    """A part with one rate and one ratio, and a reference of its own; returns the ratio's values and the file."""
    values = [2.0, 3.0, 4.0]
    monkeypatch.setattr(bench, "REFERENCE", tmp_path / "bench.json")
    monkeypatch.setitem(
        bench._PARTS,
        "sight",
        lambda _: [bench.Row("links [1/s]", [1e6], ",.0f", "1"), bench.Row("ours / theirs", values, ".2f", ratio=True)],
    )
    return values, tmp_path / "bench.json"


def test_only_a_loss_of_more_than_a_quarter_fails(part, capsys):
    values, reference = part
    check = bench.Options(parts=("sight",), check=True)
    assert bench.main(check) == 0  # nothing is committed yet
    assert bench.main(bench.Options(parts=("sight",), save=True)) == 0
    assert json.loads(reference.read_text()) == {"ours / theirs": 3.0}
    values[:] = [2.3]
    assert bench.main(check) == 0
    capsys.readouterr()
    values[:] = [2.2]
    assert bench.main(check) == 1
    assert "ours / theirs: 2.2, where 3 is committed" in capsys.readouterr().out
    assert bench.main(bench.Options(parts=("sight",))) == 0


def test_saving_keeps_what_was_not_measured(part):
    _, reference = part
    reference.write_text(json.dumps({"other / one": 7.0}))
    bench.main(bench.Options(parts=("sight",), save=True))
    assert json.loads(reference.read_text()) == {"other / one": 7.0, "ours / theirs": 3.0}


def test_rates_and_turns():
    order = []
    times = measures.in_turn([lambda: order.append("a"), lambda: order.append("b")], 3)
    assert order == ["a", "b"] * 3
    assert np.shape(times) == (2, 3)
    assert measures.rates(6, [2.0, 3.0]) == [3.0, 2.0]
    assert bench.ratios([6.0, 8.0], [2.0, 4.0]) == [3.0, 2.0]


def test_the_simulator_and_its_rivals_run():
    for measured in (
        measures.kinematic(preset("paper"), 1, 1),
        measures.sight(1, 1),
        measures.wheels(preset("paper"), 1, 1),
    ):
        assert all(rate > 0 for rates in measured for rate in rates)
