from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from mjris.config import ConfigError, preset
from mjris.eval.checkpoints import Judged
from mjris.show.curves import (
    plot_learning,
    plot_phases,
    read_metric,
    running_mean,
    student_interval,
    track_phases,
    training_gain,
)
from mjris.simulation.task import Task

TABLE = pd.DataFrame(
    {
        "policy": ["learned", "fixed RIS", "no RIS, best powers", "planner", "upper bound"],
        "gain_percent": [14.0, 3.0, 0.0, 21.0, 49.0],
    }
)
SLOTS, SEED = 2, 5


def write_run(folder, rates, config):
    """A run folder with the sum rates of its cells in every episode [T, U]; without RIS they are 1, 2, 3, … in turn."""
    folder.mkdir()
    (folder / "config.json").write_text(config.to_json())
    rows = [
        {"episode": episode, "cell": cell, "sum_rate_mbps": rate, "bare_rate_mbps": episode}
        for episode, cells in enumerate(rates, 1)
        for cell, rate in enumerate(cells)
    ]
    pd.DataFrame(rows, columns=["episode", "cell", "sum_rate_mbps", "bare_rate_mbps"]).to_csv(folder / "metrics.csv")
    return folder


@pytest.fixture
def runs(tmp_path):
    config = preset("classic")
    return [
        write_run(tmp_path / "a", [(1, 3), (2, 6)], config),
        write_run(tmp_path / "b", [(5, 5), (0, 2), (9, 9)], config),
    ]


@pytest.fixture
def judged():
    """Two checkpoints of two runs on three scenes."""
    bare = np.broadcast_to([1e6, 2e6, 3e6], (2, 2, 3))
    return Judged(np.array([1, 2]), np.array([1.1, 1.4])[:, None, None] * bare, bare)


@pytest.fixture
def figures(monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_: drawn.append(figure))
    return drawn


def test_a_metric_is_the_mean_over_cells_of_the_episodes_that_all_runs_have(runs):
    episodes, values = read_metric(runs, "sum_rate_mbps")
    assert episodes.tolist() == [1, 2]
    np.testing.assert_allclose(values, [[2, 4], [5, 1]])


def test_runs_without_episodes_are_one_sentence(runs, tmp_path):
    empty = write_run(tmp_path / "c", [], preset("classic"))
    with pytest.raises(ConfigError, match=r"c/metrics\.csv: has no episodes: train for a round at least$"):
        read_metric([*runs, empty], "sum_rate_mbps")
    (empty / "metrics.csv").unlink()
    with pytest.raises(ConfigError, match=r"c/metrics\.csv: cannot be read: No such file or directory$"):
        read_metric([*runs, empty], "sum_rate_mbps")


def test_runs_of_older_versions_are_one_sentence(runs):
    file = runs[1] / "metrics.csv"
    pd.read_csv(file).drop(columns="bare_rate_mbps").to_csv(file)
    with pytest.raises(ConfigError) as error:
        training_gain(runs)
    assert str(error.value) == (
        f"{file}: has no column bare_rate_mbps: the run is an older version's, and has to be trained anew"
    )


def test_the_gain_in_training_is_that_of_sums_over_the_window(runs):
    episodes, gain = training_gain(runs)
    assert episodes.tolist() == [1, 2]
    # Rates are 2, 4 and 5, 1 in the mean over cells, and 1, 2 without RIS.
    np.testing.assert_allclose(gain, [[100, 100], [400, 100]])


@pytest.mark.parametrize(("count", "quantile"), [(2, 12.7062), (3, 4.30265), (5, 2.77645), (31, 2.04227)])
def test_intervals_have_the_quantiles_of_the_tables(count, quantile):
    samples = np.random.default_rng(1).normal(size=(count, 3))
    low, high = student_interval(samples)
    np.testing.assert_allclose((low + high) / 2, samples.mean(0), atol=1e-12)
    np.testing.assert_allclose(high - low, 2 * quantile * samples.std(0, ddof=1) / count**0.5, rtol=1e-4)


def test_the_running_mean_is_that_of_the_last_ones():
    values = np.random.default_rng(2).normal(size=(2, 9))
    for window in (1, 4, 20):
        slow = [values[:, max(0, t + 1 - window) : t + 1].mean(1) for t in range(9)]
        np.testing.assert_allclose(running_mean(values, window), np.stack(slow, 1), atol=1e-12)


def test_rivals_are_drawn_beside_the_checkpoints_that_saw_their_scenes(runs, judged, figures, tmp_path):
    plot_learning(runs, judged, TABLE, tmp_path / "two.png")
    training, held_out = figures[0].axes
    (curve,) = training.lines
    np.testing.assert_allclose(curve.get_ydata(), [250, 100])
    *rivals, marks = [line for line in held_out.lines if len(set(line.get_xdata())) > 1 and line.get_marker() != "_"]
    assert sorted(line.get_ydata()[0] for line in rivals) == [0, 3, 21]
    np.testing.assert_allclose(marks.get_ydata(), [10, 40])


def test_a_band_is_drawn_over_several_seeds_only(runs, judged, figures, tmp_path):
    plot_learning(runs, judged, TABLE, tmp_path / "two.png")
    plot_learning(runs[:1], judged, TABLE, tmp_path / "one.png")
    assert [len(figure.axes[0].collections) for figure in figures] == [1, 0]


def config(**task):
    office = preset("classic")
    return replace(office, world=replace(office.world, layout="clinic"), task=replace(office.task, slots=SLOTS, **task))


def test_action_zero_of_weights_is_aligned():
    made = config()
    size = Task(made).action_size
    track = track_phases(made, lambda observation: np.zeros((len(observation), size)), SEED)
    np.testing.assert_allclose(track.difference_rad, 0, atol=1e-9)
    np.testing.assert_allclose(track.gain_db, 0, atol=1e-9)
    assert track.random_gain_db.shape == track.gain_db.shape == track.difference_rad.shape[:2]
    assert np.median(track.random_gain_db) < 0


def test_phases_are_compared_with_the_aligned_ones_of_every_slot():
    """Against a loop over the task."""
    made = config(phase_control="elements")
    size, elements, users = Task(made).action_size, made.radio.num_elements, made.world.num_users

    def act(observation):
        return np.tile(np.linspace(-0.9, 0.9, size), (len(observation), 1))

    track = track_phases(made, act, SEED)
    radio = replace(made.radio, difference_factor=1.0)
    task = Task(replace(made, radio=radio), cells=track.gain_db.shape[1])
    task.reset(SEED)
    phases = np.pi * np.linspace(-0.9, 0.9, size)[2 : 2 + elements]
    for t in range(SLOTS):
        aligned, channels = task.simulator.reference_phases(), task.simulator.scene.channels
        for e in (0, 7):
            difference = np.angle(np.exp(1j * (phases - aligned[e])))
            np.testing.assert_allclose(np.angle(np.exp(1j * (track.difference_rad[t, e] - difference))), 0, atol=1e-9)
            gains = []
            for applied in (phases, aligned[e]):
                paths = channels.reflected[e] * np.exp(1j * applied) @ channels.incident[e]
                gains.append(sum(np.linalg.norm(channels.direct[e, k] + paths[k]) ** 2 for k in range(users)))
            np.testing.assert_allclose(track.gain_db[t, e], 10 * np.log10(gains[0] / gains[1]), atol=1e-9)
        task.step(act(np.zeros((task.simulator.num_cells, 1))))
    assert np.abs(track.difference_rad).max() <= np.pi


def test_figures_are_files(runs, judged, tmp_path):
    made = config()
    size = Task(made).action_size
    track = track_phases(made, lambda observation: np.zeros((len(observation), size)), SEED)
    plot_phases(track, tmp_path / "phases.png")
    plot_learning(runs, judged, TABLE, tmp_path / "learning_curve.pdf")
    assert (tmp_path / "phases.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "learning_curve.pdf").read_bytes().startswith(b"%PDF")
