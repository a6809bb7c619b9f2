import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mjris.config import ConfigError, preset
from mjris.eval.planner import best_places
from mjris.eval.policies import parked, planned
from mjris.simulation.outlook import place_values
from mjris.simulation.simulator import Simulator


def load_script(name: str):
    path = Path(__file__).parents[1] / "scripts" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up, and one script imports the other
    spec.loader.exec_module(module)
    return module


reference = load_script("reference_table")
panel = load_script("panel_table")
SCENES = 4


def study(**fields):
    return reference.Study(**{"scenes": SCENES, "slots": 3, "every": 2, "layout": "clinic"} | fields)


@pytest.fixture(scope="module", params=["noma", "oma"])
def cases(request):
    return reference.compare(request.param, study(), lambda: None)


def test_the_cases_are_in_order(cases):
    assert list(cases) == ["no RIS", "parked RIS", "planner", "best placement", "upper bound"]
    for name in ("parked RIS", "planner", "best placement"):
        assert (cases[name].sum_rate_bps <= cases[name].bound_bps).all()
        # A sum rate can only fall where QoS is met that was not met without the RIS.
        gained = cases[name].value_bps / cases[name].sum_rate_bps
        assert (gained <= 1).all()
        assert (gained >= 0.5).all()
        assert cases[name].sum_rate_bps.mean() > cases[name].bare_bps.mean()
        assert cases[name].qos_share.mean() >= cases["no RIS"].qos_share.mean()
    # Three slots are enough to stand elsewhere.
    assert not np.allclose(cases["planner"].sum_rate_bps, cases["parked RIS"].sum_rate_bps, rtol=1e-3)
    assert cases["best placement"].value_bps.mean() > cases["parked RIS"].value_bps.mean()
    np.testing.assert_array_equal(cases["upper bound"].sum_rate_bps, cases["best placement"].bound_bps)


def test_who_stands_still_is_judged_in_the_same_slots(cases):
    for name in ("parked RIS", "best placement"):
        np.testing.assert_array_equal(cases[name].bare_bps, cases["no RIS"].sum_rate_bps)


def test_scenes_are_independent_episodes_of_the_default_office():
    config = reference.Study().config
    assert config == replace(preset("classic"), radio=replace(preset("classic").radio, difference_factor=1.0))
    assert reference.Study().scenes >= 200


@pytest.mark.parametrize(("slots", "every", "judged"), [(1, 5, [0]), (6, 5, [0, 5]), (4, 1, [0, 1, 2, 3])])
def test_one_of_so_many_slots_is_judged(monkeypatch, slots, every, judged):
    made, played = study(slots=slots, every=every), []
    step = Simulator.step
    monkeypatch.setattr(Simulator, "step", lambda self, *controls: played.append(0) or step(self, *controls))
    assert [len(played) for _ in reference.episode(made.config, made, parked)] == judged
    assert made.judged == len(judged)


def test_the_planner_drives_and_the_parked_do_not():
    made = study(slots=6, every=5)
    start, end = (simulator.world.fleet.xy for simulator in reference.episode(made.config, made, planned))
    assert (np.linalg.norm(end - start, axis=-1) > 0.5).any()
    start, end = (simulator.world.fleet.xy for simulator in reference.episode(made.config, made, parked))
    np.testing.assert_array_equal(start, end)


def test_a_look_from_elsewhere_moves_nothing():
    made = study().config
    plain, looking = Simulator(made, SCENES), Simulator(made, SCENES)
    controls = np.zeros((SCENES, 2)), np.zeros((SCENES, made.radio.num_elements)), np.zeros((SCENES, 4))
    for _ in range(3):
        channels = reference.channels_at(looking, best_places(looking)[0])
        np.testing.assert_array_equal(channels.direct, plain.scene.channels.direct)
        assert np.abs(channels.incident - plain.scene.channels.incident).max() > 1e-3
        for simulator in (plain, looking):
            simulator.step(*controls)
        for one, other in zip(plain.scene.channels, looking.scene.channels, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("pan", ["auto", "locked"])
def test_the_channels_at_the_present_place_are_the_present_ones(pan):
    made = study().config
    simulator = Simulator(replace(made, world=replace(made.world, pan=pan)), SCENES)
    channels = reference.channels_at(simulator, simulator.world.fleet.xy)
    for there, here in zip(channels, simulator.scene.channels, strict=True):
        np.testing.assert_allclose(there, here, rtol=1e-9)


def test_the_best_places_are_worth_more_than_the_start():
    simulator = Simulator(study().config, SCENES)
    places, values = best_places(simulator)
    assert (values >= place_values(simulator, simulator.world.fleet.xy[:, None])[:, 0]).all()
    mean = [np.linalg.norm(reference.channels_at(simulator, at).incident) for at in (places, simulator.world.fleet.xy)]
    assert mean[0] > mean[1]


def judged(rate: list[float], bare: list[float]):
    rate_bps, bare_bps = 1e6 * np.array(rate), 1e6 * np.array(bare)
    return reference.Judged(rate_bps, rate_bps / 2, np.array([0.5, 0.0]), 2 * rate_bps, bare_bps)


def test_rows_by_hand():
    table = reference.rows("noma", {"fixed RIS": judged([1.0, 3.0], [0.5, 1.5])}, study(scenes=2))
    row = table.iloc[0]
    assert row["sum_rate_mbps"] == 2.0
    assert (row["sum_rate_mbps_low"], row["sum_rate_mbps_high"]) == (1.0, 3.0)
    assert (row["gain_percent"], row["gain_percent_low"], row["gain_percent_high"]) == (100, 100, 100)
    assert row["penalised_mbps"] == 1.0
    assert row["qos_percent"] == 25.0
    assert row["percent_of_its_bound"] == 50.0
    last = reference.markdown(table).splitlines()[-1]
    assert last == (
        "| NOMA | fixed RIS | 2.000 (1.000 … 3.000) | +100.0 (+100.0 … +100.0) | 1.000 (0.500 … 1.500) | 25.0 | 50.0 |"
    )


def test_what_is_missing_is_a_dash_and_minus_is_a_minus():
    nothing = np.full(2, np.nan)
    less = reference.Judged(np.full(2, 1e6), nothing, nothing, nothing, np.full(2, 2e6))
    cells = reference.markdown(reference.rows("oma", {"no RIS": less}, study(scenes=2))).splitlines()[-1].split(" | ")
    assert cells[3:] == ["−50.0 (−50.0 … −50.0)", "–", "–", "– |"]


@pytest.mark.parametrize(("field", "least"), [("scenes", 2), ("slots", 1), ("every", 1), ("seed", 0)])
def test_bad_counts_are_one_sentence(field, least):
    with pytest.raises(ConfigError) as error:
        study(**{field: least - 1})
    assert str(error.value) == f"{field}: {least - 1} is not allowed: it must be at least {least}"


def test_bad_flags_end_in_one_sentence(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["reference_table.py", "--layout", "attic", "--scenes", "2"])
    with pytest.raises(SystemExit, match=r"^world\.layout: 'attic' is not known"):
        reference.command(reference.Study, None, reference.main)


def test_the_reference_table_is_printed_and_written(tmp_path, capsys):
    out = tmp_path / "new" / "table.csv"
    reference.main(study(scenes=2, slots=1, out=out))
    table = pd.read_csv(out)
    assert table["scheme"].tolist() == ["noma"] * 5 + ["oma"] * 5
    assert len([line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]) == 12


def test_the_panel_table_is_printed_and_written(tmp_path, capsys):
    out = tmp_path / "panel.csv"
    panel.main(study(slots=1, out=out))
    table = pd.read_csv(out)
    assert table["elements"].tolist() == ["isotropic"] * 2 + ["cosine"] * 2
    assert table["pan"].tolist() == ["auto", "locked"] * 2
    # Without RIS the panel does not matter.
    assert len(set(table["bare_qos_percent"])) == 1
    assert len([line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]) == 6


def test_only_a_panel_with_a_back_needs_the_pan_joint(monkeypatch):
    """By the cascades' mean gain at the best placement, instead of rates."""
    gains = []

    def noted(simulator, channels, _):
        gains.append(np.linalg.norm(np.abs(channels.reflected) @ np.abs(channels.incident)))
        return np.zeros((5, simulator.num_cells))

    monkeypatch.setattr(reference, "with_ris", noted)
    for pattern, pan in panel.PANELS:
        panel.play(pattern, pan, study(scenes=40, slots=1), lambda: None)
    isotropic_auto, isotropic_locked, auto, locked = gains[1::2]
    assert isotropic_locked == pytest.approx(isotropic_auto, rel=0.05)
    assert locked < 0.8 * auto
