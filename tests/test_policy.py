from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from toy import ToyEnv, toy_config

from mjris.assets import assets_dir
from mjris.cli import main
from mjris.config import ConfigError, load, preset
from mjris.learn.policy import ACTOR, export_policy, load_policy
from mjris.learn.provenance import PROVENANCE
from mjris.learn.run import train

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 2)).astype(np.float32)


@pytest.fixture(scope="module", params=["mlp", "paper"])
def run(request, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / request.param
    train(toy_config(agent={"network": request.param}), out, make_env=ToyEnv)
    return out


def test_an_exported_policy_acts_like_the_run(run: Path, tmp_path: Path):
    paths = export_policy(run, tmp_path / "policy", 1, make_env=ToyEnv)
    assert sorted((tmp_path / "policy").iterdir()) == sorted(paths)
    assert [path.name for path in paths] == ["config.json", ACTOR, "provenance.json"]
    assert paths[2].read_text() == (run / "provenance.json").read_text()
    expected = load_policy(run, 1, make_env=ToyEnv).predict(OBSERVATIONS, deterministic=True)[0]
    found = load_policy(tmp_path / "policy", make_env=ToyEnv).predict(OBSERVATIONS, deterministic=True)[0]
    np.testing.assert_array_equal(found, expected)
    assert np.abs(expected).max() > 0.01


def test_an_export_overwrites_nothing(run: Path, tmp_path: Path):
    (tmp_path / "config.json").write_text("mine")
    with pytest.raises(ConfigError, match=r"config\.json exists there already"):
        export_policy(run, tmp_path, make_env=ToyEnv)
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]
    assert (tmp_path / "config.json").read_text() == "mine"


def test_a_damaged_or_foreign_actor_is_one_sentence(run: Path, tmp_path: Path):
    actor = export_policy(run, tmp_path, make_env=ToyEnv)[1]
    biases = {name: values for name, values in load_file(actor).items() if name.endswith("bias")}
    for damage in (lambda: actor.write_bytes(b"no tensors"), lambda: save_file(biases, actor)):
        damage()
        with pytest.raises(ConfigError, match="is damaged or does not fit"):
            load_policy(tmp_path, make_env=ToyEnv)


def test_the_shipped_policy_is_of_the_office_preset():
    folder = assets_dir() / "policies" / "office"
    config, office = load(folder / "config.json"), preset("office")
    federation = replace(office.federation, episodes=config.federation.episodes)
    assert replace(config, seed=None, federation=federation) == replace(office, federation=federation)
    assert (folder / ACTOR).stat().st_size < 1e6
    action = load_policy(folder).predict(np.zeros((1, 73), np.float32), deterministic=True)[0]
    assert 0 < np.abs(action).max() <= 1


def test_the_export_command(tmp_path: Path, capsys):
    shipped = assets_dir() / "policies" / "office"
    main(["export", "--run", str(shipped), "--out", str(tmp_path / "copy")])
    assert capsys.readouterr().out.split() == [
        str(tmp_path / "copy" / name) for name in ("config.json", ACTOR, PROVENANCE)
    ]
    assert (tmp_path / "copy" / ACTOR).read_bytes() == (shipped / ACTOR).read_bytes()
