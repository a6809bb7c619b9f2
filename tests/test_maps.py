# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import os

os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo reads it when it is imported

from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest
from matplotlib import colormaps
from matplotlib.image import imread

from mjris.cli import main
from mjris.config import ConfigError, preset
from mjris.eval.floormap import floor_map
from mjris.show.maps import FIELDS, draw_field, draw_office, write_maps
from mjris.simulation.simulator import Simulator

CONFIG = preset("classic")
COARSE = ["--resolution-m", "1", "--place-resolution-m", "1"]


@pytest.fixture(scope="module")
def simulator():
    return Simulator(CONFIG)


@pytest.fixture(scope="module")
def office(simulator):
    return simulator.world.office(0)


@pytest.fixture(scope="module")
def floor(simulator):
    return floor_map(simulator, resolution_m=0.25, place_resolution_m=0.5)


@pytest.fixture(scope="module")
def north_west(floor):
    """The same floor, but with a high SNR in the north-west quarter and a low one elsewhere."""
    x, y = np.meshgrid(floor.x_m, floor.y_m)
    snr = np.where((x < 7.5) & (y > 10), 20.0, -20.0)
    return replace(floor, snr_db=snr, ris_snr_db=snr)


def share_of(picture, colour, rows, columns):
    """Share of pixels of a colour in a part of a picture that is given in shares of its height and width."""
    height, width = picture.shape[:2]
    part = picture[int(rows[0] * height) : int(rows[1] * height), int(columns[0] * width) : int(columns[1] * width)]
    return (np.abs(part[..., :3] - colormaps["viridis"](colour)[:3]).max(-1) < 0.02).mean()


@pytest.fixture
def no_figures(monkeypatch):
    """Drawing takes most of the time."""
    monkeypatch.setattr("mjris.show.maps.draw_field", lambda *_: None)


@pytest.mark.parametrize("name", ["sight", "place_gain"])
def test_a_field_is_a_figure_of_half_a_page(office, floor, tmp_path, name):
    draw_field(CONFIG, office, floor, name, tmp_path / "figure.png")
    picture = imread(tmp_path / "figure.png")
    assert picture.shape[1] == 1050  # 3.5 inches at 300 dpi
    assert 1.0 < picture.shape[0] / picture.shape[1] < 1.5
    assert picture[..., :3].min() < 0.2
    assert picture[..., :3].std() > 0.2


def test_a_figure_has_north_above_and_west_on_the_left(office, north_west, tmp_path):
    draw_field(CONFIG, office, north_west, "snr", tmp_path / "figure.png")
    picture = imread(tmp_path / "figure.png")
    assert share_of(picture, 1.0, (0.05, 0.35), (0.15, 0.4)) > 0.5
    assert share_of(picture, 0.0, (0.05, 0.35), (0.5, 0.7)) > 0.5
    assert share_of(picture, 0.0, (0.5, 0.75), (0.15, 0.4)) > 0.5


def test_the_map_lies_on_the_floor_of_the_office_in_its_own_colours(office, north_west, tmp_path):
    before = office.model.geom_rgba.copy()
    draw_office(CONFIG, office, north_west, "snr", tmp_path / "office.png")
    picture = imread(tmp_path / "office.png")
    assert share_of(picture, 1.0, (0.2, 0.45), (0.3, 0.48)) > 0.3
    assert share_of(picture, 0.0, (0.2, 0.45), (0.52, 0.7)) > 0.3
    assert share_of(picture, 0.0, (0.5, 0.75), (0.3, 0.48)) > 0.3
    assert share_of(picture, 1.0, (0.5, 0.75), (0.1, 0.9)) < 0.01
    np.testing.assert_array_equal(office.model.geom_rgba, before)


def test_figures_with_and_without_ris_share_one_scale(office, floor, tmp_path):
    # Where the RIS adds nothing the two are the same picture but for the title.
    same = replace(floor, ris_snr_db=floor.snr_db)
    pictures = []
    for name in ("snr", "snr_ris"):
        draw_field(CONFIG, office, same, name, tmp_path / f"{name}.png")
        pictures.append(imread(tmp_path / f"{name}.png")[150:])
    np.testing.assert_array_equal(*pictures)
    brighter = replace(floor, ris_snr_db=floor.snr_db + 10)
    draw_field(CONFIG, office, brighter, "snr", tmp_path / "darker.png")
    assert imread(tmp_path / "darker.png")[150:, :700, 1].mean() < pictures[0][:, :700, 1].mean() - 0.02


def test_nothing_is_written_where_something_fails(office, floor, no_figures, monkeypatch, tmp_path):
    def refuse(model, height, width):
        raise RuntimeError("Cannot initialize a EGL device display")

    with pytest.raises(ConfigError, match="on_floor: 'heat' is not known: it is one of sight, snr"):
        write_maps(CONFIG, office, floor, None, "heat", tmp_path / "new")
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="file cannot be written: File exists"):
        write_maps(CONFIG, office, floor, None, "none", tmp_path / "file")
    monkeypatch.setattr(mujoco, "Renderer", refuse)
    with pytest.raises(ConfigError, match=r"libegl1 and libgl1-mesa-dri .* --on-floor none"):
        write_maps(CONFIG, office, floor, None, "snr", tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_command_writes_and_names_all_files(tmp_path, capsys):
    out = tmp_path / "new" / "map"
    main(["map", "--out", str(out), "--leakage", "--rover", "7.5", "16", "--heading-deg", "90", *COARSE])
    printed = capsys.readouterr().out
    names = {"map.npz", "leakage.csv", "office.png", *(f"{name}.png" for name in FIELDS)}
    assert {path.name for path in out.iterdir()} == names
    assert all(str(out / name) in printed for name in names)
    assert "interference [dBm]" in printed
    with np.load(out / "map.npz") as saved:
        np.testing.assert_array_equal(saved["ris_xy_m"], [7.5, 16])
        assert saved["ris_heading_rad"] == pytest.approx(np.pi / 2)
        assert saved["snr_db"].shape == (20, 15)
    assert pd.read_csv(out / "leakage.csv").floors_apart.tolist() == [1, 2]


def test_the_command_takes_the_config_of_a_run(no_figures, tmp_path):
    run, out = tmp_path / "run", tmp_path / "map"
    run.mkdir()
    config = replace(CONFIG, world=replace(CONFIG.world, num_users=6), radio=replace(CONFIG.radio, num_antennas=3))
    (run / "config.json").write_text(config.to_json())
    main(["map", "--run", str(run), "--out", str(out), "--on-floor", "none", *COARSE])
    assert not (out / "office.png").exists()
    assert not (out / "leakage.csv").exists()
    with np.load(out / "map.npz") as saved:
        assert saved["users_xy_m"].shape == (6, 2)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--rover", "99", "1"], "rover: 99 1 is not allowed"),
        (["--leakage", "--bands", "1"], "bands: 1 is not allowed"),
        (["--scene-seed", "-1"], "scene_seed: -1 is not allowed"),
        (["--resolution-m", "0"], "resolution_m: 0.0 is not allowed"),
        (["--world.layout", "nowhere"], "nowhere"),
    ],
)
def test_bad_flags_end_in_one_sentence_and_no_files(tmp_path, capsys, flags, words):
    out = tmp_path / "map"
    with pytest.raises(SystemExit) as stop:
        main(["map", "--out", str(out), *flags])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("mjris: ")
    assert words in error
    assert error.count("\n") == 1
    assert not out.exists()
