import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mjris.config import load, preset
from mjris.eval.playing import play
from mjris.eval.policies import reference_controls

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
judging = importlib.import_module("judging")
reproduce = importlib.import_module("reproduce")
claims = importlib.import_module("reproduction.claims")
curves = importlib.import_module("reproduction.curves")
results = importlib.import_module("reproduction.results")
remark = importlib.import_module("reproduction.remark")
sensitivity = importlib.import_module("reproduction.sensitivity")

# Long enough for some updates after the warm-up of 200 slots.
TINY = replace(
    curves.SCALES["quick"],
    scenes=2,
    slots=55,
    every=50,
    episodes={"classic": 4, "paper": 4},
    judged=4,
    elements=(4, 16),
)


@pytest.mark.slow
def test_a_figure_goes_the_whole_way_once(tmp_path: Path, capsys, monkeypatch):
    runs, out = tmp_path / "runs", tmp_path / "out"
    out.mkdir()
    reproduce.reproduce(("elements",), TINY, runs, out)
    table = pd.read_csv(out / "elements.csv")
    agents: Any = table[table.seeds == 2]
    assert len(agents) == 2 * 2 * 2  # presets, schemes, panels
    assert set(table.preset) == {"classic", "paper"}
    assert (agents.collisions == 0).all()
    assert (agents.sum_rate_mbps_low < agents.sum_rate_mbps).all()
    assert (agents.sum_rate_mbps < agents.sum_rate_mbps_high).all()
    for row in agents.to_dict("records"):
        seeds = [float(mean) for mean in row["sum_rate_mbps_by_seed"].split()]
        assert seeds[0] != seeds[1]
        assert np.mean(seeds) == pytest.approx(row["sum_rate_mbps"], abs=1e-4)
    assert (table.judged == judging.commit()).all()
    lines: Any = table[table.seeds == 0].pivot_table("sum_rate_mbps", ["preset", "scheme", "x"], "curve")
    assert (lines["planner"] < lines["upper bound"]).all()
    assert (out / "elements.png").stat().st_size > 20_000
    trained = [load(path) for path in runs.glob("*/config.json")]
    assert len(trained) == 16
    assert {config.radio.num_elements for config in trained} == {4, 16}
    rates = agents.set_index(["preset", "scheme", "x"]).sum_rate_mbps
    said = pd.read_csv(out / "claims.csv").set_index("preset")
    for name in ("classic", "paper"):
        ratio = 100 * (rates[name, "oma", 16] / rates[name, "noma", 4] - 1)
        assert said.measured[name] == pytest.approx(ratio, rel=1e-3)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("everything was finished")

    monkeypatch.setattr("reproduction.results.driving", never)
    monkeypatch.setattr("judging.play", never)
    reproduce.reproduce(("elements",), TINY, runs, out)
    pd.testing.assert_frame_equal(pd.read_csv(out / "elements.csv"), table)
    assert "The figures are in" in capsys.readouterr().out


def a_table(figure: str, scenes: int = 4, **rates: list[list[float]]) -> pd.DataFrame:
    """Curves over x = 10, 20, …, with a list of seeds' values for each x, the same in all scenes."""
    return pd.DataFrame(
        {"figure": figure, "curve": curve.replace("_", " "), "scheme": "noma", "x": 10.0 * (i + 1), "seed": seed}
        | {"sum_rate_mbps": np.full(scenes, value), "preset": "paper"}
        for curve, points in rates.items()
        for i, values in enumerate(points)
        for seed, value in enumerate(values)
    )


def test_episodes_for_equal_performance_are_on_lines_between_what_is_judged():
    table = a_table(
        "federation", federation=[[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]], one_cell=[[0.5, 1.0], [1.5, 1.5], [2.5, 1.4]]
    )
    (row,) = claims.compare(table).to_dict("records")
    # The mean of one cell is best after 30 episodes with 1.95, which the federation has after 19.5.
    assert row["measured"] == pytest.approx(19.5 / 30)
    assert row["in_its_form"] == "20 / 30 episodes"
    assert row["printed"] == "150 / 250 episodes"
    assert "| 150 / 250 episodes | 20 / 30 episodes: 0.65 times (" in claims.markdown(pd.DataFrame([row]))
    never = a_table("federation", federation=[[1.0, 1.0]], one_cell=[[0.5, 2.0]])
    (row,) = claims.compare(never).to_dict("records")
    assert row["in_its_form"] == "never / at most 10 episodes"
    assert np.isinf(row["measured"])
    assert row["agrees"] == "no"


def test_a_level_is_reached_on_the_way_at_the_first_point_or_nowhere():
    curves = np.array([[1.0, 5.0, 1.0], [2.0, 6.0, 1.5], [4.0, 7.0, 2.0]])
    reached = claims.first_reached(np.array([10.0, 20.0, 40.0]), curves, np.array([3.0, 4.0, 3.0]))
    np.testing.assert_array_equal(reached, [30, 10, np.inf])


def test_claims_are_of_means_over_seeds_and_scenes_and_their_intervals_of_both():
    rng = np.random.default_rng(0)
    scenes = rng.uniform(1.0, 4.0, 32)
    seeds = 1 + 0.01 * rng.standard_normal(5)
    rows = [
        {"figure": "difference_factor", "preset": "classic", "scheme": "noma", "x": 60.0}
        | {"curve": curve, "seed": seed, "sum_rate_mbps": gain * luck * scenes}
        for curve, gain in (("DF = 0", 1.1), ("DF = 1", 1.0), ("one cell", 1.0))
        for seed, luck in enumerate(seeds if curve == "DF = 0" else np.ones(5))
    ]
    alike, unlike = claims.compare(pd.DataFrame(rows)).to_dict("records")
    assert alike["measured"] == pytest.approx(100 * (1.1 * seeds.mean() - 1))
    # The scenes' luck is the same for both, so that seeds alone are left.
    half = stats.t.ppf(0.975, 4) * 110 * seeds.std(ddof=1) / np.sqrt(5)
    assert (alike["high"] - alike["low"]) / 2 == pytest.approx(half, rel=0.2)
    assert alike["agrees"] == "yes"
    assert unlike["measured"] == unlike["low"] == unlike["high"] == 0
    assert unlike["agrees"] == "yes"


@pytest.mark.parametrize(
    ("value", "neutral", "low", "high", "said"),
    [
        (15.1, 0.0, 14.0, 16.0, "yes"),
        (15.1, 0.0, -1.0, 16.0, "not decided"),
        (15.1, 0.0, 5.0, 8.0, "in sign, less"),
        (15.1, 0.0, 25.0, 28.0, "in sign, more"),
        (15.1, 0.0, -1.0, 3.0, "no"),
        (-7.0, 0.0, -3.0, -1.0, "in sign, less"),
        (-7.0, 0.0, 1.0, 2.0, "no"),
        (0.0, 0.0, -1.0, 2.0, "yes"),
        (0.0, 0.0, 1.0, 2.0, "no"),
        (0.6, 1.0, 0.7, 0.9, "in sign, less"),
        (0.6, 1.0, 0.9, 1.1, "no"),
        (0.6, 1.0, 0.3, np.inf, "not decided"),
        (0.6, 1.0, np.inf, np.inf, "no"),
        (3.0, 1.0, 2.0, 4.0, "yes"),
        (None, 0.0, 0.1, 2.0, "yes"),
        (None, 0.0, -0.1, 2.0, "not decided"),
        (None, 0.0, -2.0, -1.0, "no"),
    ],
)
def test_verdicts(value: float | None, neutral: float, low: float, high: float, said: str):
    claim = replace(claims.CLAIMS[0], value=value, neutral=neutral)
    assert claims.verdict(claim, low, high) == said


def test_a_claim_names_what_stands_behind_it_and_its_printed_value():
    assert len({claim.what for claim in claims.CLAIMS}) == len(claims.CLAIMS)
    for claim in claims.CLAIMS:
        assert claim.behind
        if claim.value is not None and claim.printed.endswith("%"):
            assert float(claim.printed.removesuffix(" %").replace("−", "-")) == claim.value
    office, paper = (claims.setting(name) for name in ("classic", "paper"))
    assert "16 cosine elements, pan auto" in office
    assert "16 isotropic elements" in paper
    assert "−30 dBm/MHz of noise" in office


def test_beside_every_sum_rate_stands_who_gets_it():
    point = {"preset": "classic", "curve": "mobile RIS", "scheme": "noma", "user_qos_percent": 60.0, "jain": 0.5}
    spread = {f"{score}{end}": 2.0 for score in ("sum_rate_mbps", "qos_percent") for end in ("", "_low", "_high")}
    point |= {**spread, "user_rate_p5_kbps": 0.0, "superposing_percent": 22.0}
    points = [{**point, "x": 40.0}, {**point, "x": 20.0, "jain": 0.1}, {**point, "curve": "planner", "jain": np.nan}]
    *_, last = results.shares(pd.DataFrame(points)).splitlines()
    assert last == (
        "| `classic` | mobile RIS, NOMA | 2.00 (2.00 … 2.00) | 2.0 (2.0 … 2.0) | 60.0 | 0.0 | 0.50 | 22.0 |"
    )


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
    assert as_it_is.config == curves.base("classic", TINY)
    changed = set()
    for variant in others:
        differing = {
            field
            for section, fields in variant.config.to_dict().items()
            if section != "seed"
            for field, value in fields.items()
            if value != as_it_is.config.to_dict()[section][field]
        }
        assert differing
        # Thermal noise comes with a QoS that it allows, a panel without a back without its pan joint.
        together = [{"panel_rows", "panel_cols"}, {"noise_dbm_per_mhz", "qos_bps"}, {"element_pattern", "pan"}]
        assert len(differing) == 1 or differing in together
        changed |= differing
    assert {"noise_dbm_per_mhz", "tx_power_dbm", "qos_bps"} <= changed


def test_headline_gains_are_of_closed_forms_in_the_same_scenes(tmp_path: Path):
    config = replace(sensitivity.variants(TINY, tmp_path)[0].config, task=replace(preset("classic").task, slots=5))
    scores = sensitivity.headline(config, TINY.scenes, tmp_path)
    assert set(scores) == {*sensitivity.CASES, "judged"}
    closed = play(config, reference_controls(), TINY.scenes, sensitivity.SCENE_SEED)
    np.testing.assert_allclose(scores["mobile"], closed.sum_rate_bps / 1e6)
    assert (scores["mobile"] > scores["OMA"]).all()
    # Where everybody can have QoS there is nobody to leave out.
    assert (scores["selecting OMA"] >= scores["OMA"]).all()
    assert scores["selecting OMA"].sum() > scores["OMA"].sum()
    again = sensitivity.headline(config, TINY.scenes, tmp_path)
    np.testing.assert_array_equal(again["none"], scores["none"])


def test_the_page_has_the_claims_that_were_measured():
    docs = Path(__file__).parents[1] / "docs"
    table = pd.read_csv(docs / "reproduction" / "claims.csv").fillna({"in_its_form": "", "agrees": "–"})
    assert claims.markdown(table) in (docs / "reproduction.md").read_text()
    assert set(table["claim"]) == {claim.what for claim in claims.CLAIMS}
