import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from mjris.cli import main
from mjris.config import Config, ConfigError, Radio, Task, World, load, preset
from mjris.eval.bound import upper_bound
from mjris.eval.evaluate import compare
from mjris.eval.optimum import best_known
from mjris.eval.playing import play
from mjris.eval.policies import agent_policies, no_ris, planned, planner, reference_controls
from mjris.eval.tables import print_comparison
from mjris.radio.powers import best_powers
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import Purpose, generator
from mjris.simulation.task import Task as Agents

SCENES, SLOTS, SEED = 4, 3, 5
POLICIES = [
    *("learned", "fixed RIS", "fixed RIS, panel turns", "random phases", "no RIS"),
    *("reference controls", "closed forms, fixed RIS", "best-placed fixed RIS"),
    *("reference controls, OMA", "OMA, users selected"),
    *("no RIS, best powers", "planner", "upper bound"),
]


def config(**radio) -> Config:
    office = preset("classic")
    return replace(
        office,
        world=replace(office.world, layout="clinic"),
        radio=replace(office.radio, **radio),
        task=replace(office.task, slots=SLOTS),
    )


def random_actions(made: Config):
    rng, size = np.random.default_rng(0), Agents(made).action_size
    return lambda observation: rng.uniform(-1, 1, (len(observation), size))


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return compare(config(), random_actions(config()), SCENES, SEED, lambda _: None)


def test_a_row_for_every_policy_and_the_bound(table):
    assert table["policy"].tolist() == POLICIES
    assert (table["scenes"] == SCENES).all()


def test_shares_are_those_of_the_planner_and_of_the_bound(table):
    rate = table.set_index("policy")["sum_rate_mbps"]
    np.testing.assert_allclose(table["percent_of_planner"], 100 * rate / rate["planner"])
    np.testing.assert_allclose(table["percent_of_bound"], 100 * rate / rate["upper bound"])
    assert rate["planner"] < rate["upper bound"]


def test_the_bound_has_only_rates(table):
    bound = table.iloc[-1]
    assert bound[["penalised_mbps", "qos_share", "collisions", "clearance_m", "violated_power"]].isna().all()
    places = ["x_m", "y_m", "heading_deg"]
    assert table.iloc[:-1].drop(columns=places).notna().all(axis=None)
    assert table[places].notna().all(axis=1).tolist() == [name == "best-placed fixed RIS" for name in POLICIES]


def test_oma_has_a_band_for_every_user(table):
    rows = table.set_index("policy")
    assert rows.loc["reference controls, OMA", "superposing_share"] == 0
    assert rows.loc["reference controls, OMA", "jain"] > rows.loc["reference controls", "jain"]


def test_oma_is_no_rival_of_itself():
    made = config(scheme="oma")
    table = compare(made, random_actions(made), 2, SEED, lambda _: None, with_planner=False)
    assert "reference controls, OMA" not in set(table["policy"])


def test_the_best_powers_without_ris_are_what_gains_are_judged_against(table):
    row = table.set_index("policy").loc["no RIS, best powers"]
    np.testing.assert_allclose(row[["gain_percent", "gain_low", "gain_high"]].to_numpy(float), 0, atol=1e-9)


@pytest.mark.parametrize("scheme", ["noma", "oma"])
def test_the_planner_is_its_drive_with_the_best_phases_and_powers(scheme):
    """Against a loop over the simulator."""
    made = config(scheme=scheme)
    result = play(made, planner(SEED), SCENES, SEED, bounded=True)
    radio = replace(made.radio, difference_factor=1.0)
    simulator, rng = Simulator(replace(made, radio=radio), SCENES), generator(SEED, Purpose.SEARCH)
    simulator.seed(SEED)
    simulator.reset()
    rates, bounds, bare, jain, superposing = [], [], [], [], []
    for _ in range(SLOTS):
        channels, clusters = simulator.scene.channels, simulator.clusters
        best = best_known(channels, clusters, radio, made.task.qos_bps, rng)
        powers = best_powers(simulator.system, channels.direct)
        bare.append(simulator.rates(channels.direct, powers).sum(-1))
        bounds.append(upper_bound(channels, clusters, radio))
        rates.append(best.rates_bps)
        jain.append([sum(rate) ** 2 / (4 * sum(rate**2)) for rate in best.rates_bps])
        superposing.append(
            [[scheme == "noma" and (power[pair] > 0).all() for pair in clusters] for power in best.powers_w]
        )
        simulator.step(planned(simulator), best.phases_rad, best.powers_w)
    met = (np.array(rates) >= made.task.qos_bps).all(-1)
    total = np.sum(rates, -1)
    np.testing.assert_allclose(result.sum_rate_bps, total.mean(0), rtol=1e-9)
    np.testing.assert_allclose(result.value_bps, np.where(met, total, total / 2).mean(0), rtol=1e-9)
    np.testing.assert_allclose(result.qos_share, met.mean(0))
    everyone = np.moveaxis(np.stack(rates), 1, 0).reshape(SCENES, -1)
    np.testing.assert_allclose(result.user_qos_share, (everyone >= made.task.qos_bps).mean(1))
    np.testing.assert_allclose(result.user_rate_p5_bps, np.percentile(everyone, 5, axis=1), rtol=1e-9)
    np.testing.assert_allclose(result.jain, np.mean(jain, 0), rtol=1e-9)
    np.testing.assert_allclose(result.superposing_share, np.mean(superposing, (0, 2)))
    np.testing.assert_allclose(result.bound_bps, np.mean(bounds, 0), rtol=1e-9)
    np.testing.assert_allclose(result.bare_bps, np.mean(bare, 0), rtol=1e-9)
    assert (result.bound_bps > result.sum_rate_bps).all()


def test_action_zero_beats_random_actions_and_no_ris():
    made = config()
    made = replace(made, task=replace(made.task, slots=20))
    policies = reference_controls(), agent_policies(random_actions(made))[0], no_ris()
    closed, random, bare = (play(made, policy, 32, SEED).value_bps.mean() for policy in policies)
    assert closed > random
    assert closed > bare


def test_action_zero_of_the_paper_stands_still_without_phases():
    made = replace(preset("paper"), world=replace(config().world), task=Task(slots=2))
    agents = Agents(made, SCENES)
    move, phases, powers, *_ = reference_controls().controls(agents)
    assert not move.any()
    assert not phases.any()
    np.testing.assert_allclose(powers, made.radio.tx_power_w / made.world.num_users)


def test_scenes_have_fading_of_their_own_whatever_the_config_says():
    shared, own = (play(config(difference_factor=factor), no_ris(), SCENES, SEED) for factor in (0.0, 1.0))
    np.testing.assert_array_equal(shared.sum_rate_bps, own.sum_rate_bps)


def test_scenes_are_the_same_for_all_who_stand_still():
    made = config()
    rivals = [
        play(made, replace(reference_controls(), changes={"task": {"ris": ris}}), SCENES, SEED)
        for ris in ("fixed", "none")
    ]
    np.testing.assert_array_equal(rivals[0].bare_bps, rivals[1].bare_bps)
    np.testing.assert_array_equal(rivals[0].bare_bps, play(made, no_ris(), SCENES, SEED).bare_bps)


@pytest.mark.parametrize(
    ("scenes", "seed", "sentence"),
    [
        (1, 0, "scenes: 1 is not allowed: an interval needs at least 2"),
        (2, -1, "scene_seed: -1 is not allowed: it must be at least 0"),
    ],
)
def test_bad_input_is_one_sentence(scenes, seed, sentence):
    with pytest.raises(ConfigError) as error:
        compare(config(), lambda observation: observation, scenes, seed, lambda _: None)
    assert str(error.value) == sentence


def test_the_printed_table_has_a_line_a_policy_in_120_columns(table):
    console = Console(record=True, width=120)
    print_comparison(console, table)
    lines = [line.strip() for line in console.export_text().splitlines()]
    rows = table.to_dict("records")
    for row in rows:
        line, *fairness = [line for line in lines if re.match(rf"{re.escape(row['policy'])} +\d", line)]
        assert f"{row['gain_percent']:+.1f} ({row['gain_low']:+.1f}…{row['gain_high']:+.1f})" in line
        assert f"{row['percent_of_planner']:.1f}" in line
        assert len(fairness) == (row["policy"] != "upper bound")
        for who_gets in fairness:
            assert f"{row['jain']:.3f}" in who_gets
            assert f"{row['superposing_share']:.1%}" in who_gets
    spot = table.set_index("policy").loc["best-placed fixed RIS"]
    where = f"at {spot['x_m']:.2f} {spot['y_m']:.2f} m, facing {spot['heading_deg']:.0f}°, found in other scenes"
    assert f"best-placed fixed RIS: {where}" in lines


def test_the_evaluation_counts_the_slots_that_break_a_constraint():
    slots, scenes = 6, 8
    task = Task(slots=slots)
    static = Config(world=World(drive="kinematic"), radio=Radio(decoding_order="static"), task=task)
    size = Agents(static).action_size

    def still(observation: np.ndarray) -> np.ndarray:
        return np.zeros((len(observation), size))

    table = compare(static, still, scenes, 5, lambda _: None, with_planner=False)
    for name in ("in_room", "power", "collision_free"):
        assert table[f"violated_{name}"].tolist() == [0] * len(table)
    # Closed forms know the order: who is superposed is decoded in it, and others have no power.
    assert table.loc[table["policy"].str.contains("closed|best"), "violated_decoding_order"].eq(0).all()
    noma: Any = table[table["policy"].isin(["learned", "fixed RIS", "random phases", "no RIS", "reference controls"])]
    assert noma["violated_decoding_order"].between(1, slots * scenes - 1).all()
    np.testing.assert_allclose(table["violated_qos"].astype(int), slots * scenes * (1 - table["qos_share"]))
    console = Console(record=True, width=80)
    print_comparison(console, table)
    for policy, count in zip(noma["policy"], noma["violated_decoding_order"], strict=True):
        assert f"{policy}: slots that broke a constraint: decoding_order {count}" in console.export_text(clear=False)
    dynamic = compare(replace(static, radio=Radio()), still, scenes, 5, lambda _: None, with_planner=False)
    assert dynamic["violated_decoding_order"].tolist() == [0] * len(table)


FIGURES = ("learning_curve.png", "motion_field.png", "phases.png")


def train(out, *flags: str) -> str:
    small = ["--world.layout", "clinic", "--task.slots", "3", "--agent.warmup-slots", "0"]
    main(["train", "--out", str(out), *small, "--federation.num-cells", "1", "--federation.episodes", "1", *flags])
    return str(out)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> str:
    return train(tmp_path_factory.mktemp("runs") / "first", "--seed", "0")


@pytest.fixture(scope="module")
def evaluation(run, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("out") / "new" / "table.csv"
    main(["evaluate", "--run", run, "--scenes", "2", "--no-planner", "--out", str(path)])
    return path


def test_the_command_writes_the_table_and_figures_of_a_trained_run(evaluation):
    table = pd.read_csv(evaluation)
    assert table["policy"].tolist() == POLICIES[:-2]
    assert not [name for name in table.columns if name.startswith("percent_of")]
    assert sorted(each.name for each in evaluation.parent.iterdir()) == sorted([*FIGURES, "table.csv"])


def test_more_runs_change_the_learning_curve_alone(run, evaluation, tmp_path, capsys):
    second = train(tmp_path / "second", "--seed", "2")
    main(["evaluate", "--run", run, second, "--scenes", "2", "--no-planner"])
    assert "2 held-out scenes" in capsys.readouterr().out
    pd.testing.assert_frame_equal(pd.read_csv(evaluation), pd.read_csv(Path(run) / "evaluation.csv"))
    same = [(evaluation.parent / name).read_bytes() == (Path(run) / name).read_bytes() for name in FIGURES]
    assert same == [False, True, True]


def test_runs_that_differ_in_more_than_seeds_are_one_sentence(run, tmp_path, capsys):
    other = tmp_path / "other"
    other.mkdir()
    made = load(Path(run) / "config.json")
    for config, sentence in (
        (replace(made, seed=2, agent=replace(made.agent, discount=0.5)), "its agent.discount is 0.5 and not "),
        (made, "run: seeds [0, 0] are not allowed: every run must have a seed of its own"),
    ):
        (other / "config.json").write_text(config.to_json())
        with pytest.raises(SystemExit) as end:
            main(["evaluate", "--run", run, str(other)])
        assert end.value.code == 2
        error = capsys.readouterr().err
        assert sentence in error
        assert error.count("\n") == 1


def test_the_command_needs_a_run(capsys):
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "--run"])
    assert end.value.code == 2
    assert capsys.readouterr().err == "mjris: run: no folder is given\n"


def test_without_a_run_the_shipped_policy_is_played(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["evaluate", "--scenes", "2", "--no-planner", "--task.slots", "5"])
    made = tmp_path / "runs" / "shipped"
    assert {path.name for path in made.iterdir()} == {"evaluation.csv", "motion_field.png", "phases.png"}
    table = pd.read_csv(made / "evaluation.csv")
    learned, bare = (
        table.loc[table.policy == name, "penalised_mbps"].item() for name in ("learned", "no RIS, best powers")
    )
    assert learned > bare
