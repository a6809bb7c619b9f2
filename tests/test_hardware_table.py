import importlib
import sys
from itertools import islice
from pathlib import Path

import pandas as pd

from mjris.config import from_dict

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
hardware_table = importlib.import_module("hardware_table")


def test_a_table_and_a_figure_come_out(monkeypatch, tmp_path, capsys):
    cases = list(islice(hardware_table.cases(), 2))
    monkeypatch.setattr(hardware_table, "cases", lambda: iter(cases))
    out = tmp_path / "new" / "hardware.csv"
    hardware_table.main(hardware_table.HardwareStudy(scenes=2, slots=2, out=out))
    table = pd.read_csv(out)
    assert table["case"].tolist() == ["ideal", "ideal", "1 bit", "1 bit"]
    assert table["over_ideal_percent"].tolist()[:2] == [0, 0]
    _, ideal, _, coarse = table["penalised_mbps"].tolist()  # of the best known
    assert coarse < ideal
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert capsys.readouterr().out.count("|") == 6 * 6


def test_every_case_is_another_that_can_be():
    cases = dict(hardware_table.cases())
    assert len({repr(changes) for changes in cases.values()}) == len(cases) == 19
    assert from_dict({"radio": {"surface": {"phase_bits": 2}}}).radio.surface == cases["2 bits"]["radio"]["surface"]
