import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mjris.config import load

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
reproduce = importlib.import_module("reproduce")
claims = importlib.import_module("reproduction.claims")
curves = importlib.import_module("reproduction.curves")
remark = importlib.import_module("reproduction.remark")
sensitivity = importlib.import_module("reproduction.sensitivity")

# Long enough for some updates after the warm-up of 200 slots.
TINY = replace(
    curves.SCALES["quick"],
    scenes=2,
    slots=55,
    every=50,
    episodes={"office": 4, "paper": 4},
    judged=4,
    elements=(4, 16),
)


@pytest.mark.slow
def test_a_figure_goes_the_whole_way_once(tmp_path: Path, capsys, monkeypatch):
    runs, out = tmp_path / "runs", tmp_path / "out"
    out.mkdir()
    reproduce.reproduce(("elements",), TINY, runs, out)
    table = pd.read_csv(out / "elements.csv")
    agents = table[table.seed.notna()]
    assert len(agents) == 2 * 2 * 2 * 2  # presets, schemes, panels, seeds
    assert set(table.preset) == {"office", "paper"}
    assert (agents.collisions == 0).all()
    assert agents.groupby(["preset", "scheme", "x"]).sum_rate_mbps.nunique().eq(2).all()
    lines: Any = table[table.seed.isna()].pivot_table("sum_rate_mbps", ["preset", "scheme", "x"], "curve")
    assert (lines["planner"] < lines["upper bound"]).all()
    assert (out / "elements.png").stat().st_size > 20_000
    trained = [load(path) for path in runs.glob("*/config.json")]
    assert len(trained) == 16
    assert {config.radio.num_elements for config in trained} == {4, 16}
    rates = agents.set_index(["preset", "scheme", "x", "seed"]).sum_rate_mbps
    said = pd.read_csv(out / "claims.csv").set_index("preset")
    for preset in ("office", "paper"):
        ratio = 100 * (rates[preset, "oma", 16] / rates[preset, "noma", 4] - 1)
        assert said.measured[preset] == pytest.approx(ratio.mean(), rel=1e-4)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("everything was finished")

    monkeypatch.setattr("reproduction.results.driving", never)
    monkeypatch.setattr("judging.play", never)
    reproduce.reproduce(("elements",), TINY, runs, out)
    pd.testing.assert_frame_equal(pd.read_csv(out / "elements.csv"), table)
    assert "The figures are in" in capsys.readouterr().out


def a_table(**rates: list[list[float]]) -> pd.DataFrame:
    """A figure with curves over x = 10, 20, …, a list of seeds' values for each x."""
    return pd.DataFrame(
        {"figure": "federation", "curve": curve.replace("_", " "), "scheme": "noma", "x": 10.0 * (i + 1), "seed": seed}
        | {"sum_rate_mbps": value, "preset": "paper"}
        for curve, points in rates.items()
        for i, values in enumerate(points)
        for seed, value in enumerate(values)
    )


def test_episodes_for_equal_performance_are_on_lines_between_what_is_judged():
    table = a_table(federation=[[1.0, 1.0], [2.0, 3.0], [3.0, 3.0]], one_cell=[[0.5, 1.0], [1.5, 1.5], [2.5, 1.4]])
    # Seed 0: 2.5 is reached after 25 of 30 episodes; seed 1: 1.5 after 12.5, where the cell alone takes 20.
    np.testing.assert_allclose(claims._episodes(table), [25 / 30, 12.5 / 20])
    (row,) = claims.compare(table).to_dict("records")
    assert row["claim"] == "episodes, federation / one cell"
    assert row["measured"] == pytest.approx((25 / 30 + 12.5 / 20) / 2)
    assert row["agrees"] == "yes"
    never = a_table(federation=[[1.0, 1.0]], one_cell=[[0.5, 2.0]])
    (row,) = claims.compare(never).to_dict("records")
    assert row["agrees"] == "no: not every seed gets there"


@pytest.mark.parametrize(
    ("printed", "unit", "low", "high", "said"),
    [
        (15.1, "%", 14.0, 16.0, "yes"),
        (15.1, "%", 5.0, 8.0, "in sign, less"),
        (15.1, "%", 25.0, 28.0, "in sign, more"),
        (15.1, "%", -1.0, 3.0, "no"),
        (-7.0, "%", -3.0, -1.0, "in sign, less"),
        (-7.0, "%", 1.0, 2.0, "no"),
        (0.0, "%", 1.0, 2.0, "no"),
        (0.6, "", 0.7, 0.9, "in sign, less"),
        (0.6, "", 0.9, 1.1, "no"),
        (None, "%", 0.1, 2.0, "yes"),
        (None, "%", -0.1, 2.0, "not decided"),
        (None, "%", -2.0, -1.0, "no"),
    ],
)
def test_verdicts(printed: float | None, unit: str, low: float, high: float, said: str):
    claim = claims.Claim("a claim", unit, printed, "gain", lambda _: np.zeros(2))
    assert claims.verdict(claim, low, high) == said


def test_every_scale_covers_every_figure_and_keeps_what_figures_share():
    for scale in curves.SCALES.values():
        for name in curves.PRESETS:
            shared = {figure: {curve.config for curve in make(name, scale)} for figure, make in curves.TRAINED.items()}
            as_it_is = curves.base(name, scale)
            for figure in ("learning_rate", "elements", "power", "gain"):
                assert as_it_is in shared[figure]
            assert len(shared["federation"] & shared["difference_factor"]) == 2


@pytest.mark.parametrize("tries", [1, 5, 40])
def test_the_exact_probability_is_what_monte_carlo_finds(tries: int):
    found = remark.explore(tries, np.random.default_rng(1), 40_000)
    assert found.alone == pytest.approx(found.alone_given, abs=0.01)
    assert found.together == pytest.approx(found.together_given, abs=0.01)
    assert found.alone < found.together
    assert found.alone_paper < found.together_paper


def test_different_actions_are_counted():
    rng = np.random.default_rng(2)
    tried = [len(set(rng.integers(0, 50, 30))) for _ in range(4000)]
    assert remark.different(30) == pytest.approx(np.mean(tried), rel=0.01)


def test_a_federation_of_unlike_cells_is_misled():
    rng = np.random.default_rng(3)
    alone, together = remark.best_reward(1.0, rng, 4000)
    assert together > alone + 0.2
    alone, together = remark.best_reward(0.0, rng, 4000)
    assert together < alone - 0.5


def test_the_sensitivity_changes_one_parameter_at_a_time(tmp_path: Path):
    as_it_is, *others = sensitivity.variants(TINY, tmp_path)
    assert as_it_is.config == curves.base("office", TINY)
    for variant in others:
        differing = [
            (section, field)
            for section, fields in variant.config.to_dict().items()
            if section != "seed"
            for field, value in fields.items()
            if value != as_it_is.config.to_dict()[section][field]
        ]
        assert differing
        assert len({section for section, _ in differing}) == 1


def test_headline_gains_are_of_closed_forms_in_the_same_scenes(tmp_path: Path):
    config = sensitivity.variants(TINY, tmp_path)[0].config
    scores = sensitivity.headline(config, TINY.scenes, tmp_path)
    assert scores["mobile over no RIS, low"] <= scores["mobile over no RIS"] <= scores["mobile over no RIS, high"]
    assert scores["NOMA over OMA"] > 0
    assert sensitivity.headline(config, TINY.scenes, tmp_path) == scores


def test_the_page_has_the_claims_that_were_measured():
    docs = Path(__file__).parents[1] / "docs"
    table = pd.read_csv(docs / "reproduction" / "claims.csv").fillna({"unit": ""})
    assert claims.markdown(table) in (docs / "reproduction.md").read_text()
    assert set(table["claim"]) == {claim.what for claim in claims.CLAIMS}
