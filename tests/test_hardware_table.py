import importlib
import sys
from itertools import islice
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
hardware_table = importlib.import_module("hardware_table")


def test_a_table_and_a_figure_come_out(monkeypatch, tmp_path, capsys):
    kinds = list(islice(hardware_table.surfaces(), 2))
    monkeypatch.setattr(hardware_table, "surfaces", lambda: iter(kinds))
    out = tmp_path / "new" / "hardware.csv"
    hardware_table.main(hardware_table.HardwareStudy(scenes=2, slots=2, out=out))
    table = pd.read_csv(out)
    assert table["elements"].tolist() == ["ideal", "ideal", "1 bit", "1 bit"]
    assert table["over_ideal_percent"].tolist()[:2] == [0, 0]
    _, ideal, _, coarse = table["penalised_mbps"].tolist()  # of the best known
    assert coarse < ideal
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert capsys.readouterr().out.count("|") == 6 * 6


def test_every_kind_of_elements_is_another():
    kinds = dict(hardware_table.surfaces())
    assert len(set(kinds.values())) == len(kinds) == 9
    assert hardware_table.config(hardware_table.HardwareStudy(), kinds["2 bits"]).radio.surface.phase_bits == 2
