import json
import platform
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from mjris.learn import provenance
from mjris.learn.provenance import write_provenance


def git(folder: Path, *words: str) -> str:
    names = ("-c", "user.name=a", "-c", "user.email=a@b")
    return subprocess.run(
        ["git", "-C", str(folder), *names, *words], capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with a package and its assets."""
    for name in ("package/__init__.py", "assets/policy"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("x")
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "all")
    monkeypatch.setattr(provenance, "_SOURCES", tmp_path / "package")
    monkeypatch.setattr(provenance, "assets_dir", lambda: tmp_path / "assets")
    return tmp_path


def written(folder: Path) -> dict:
    write_provenance(folder, "1 cell learns")
    return json.loads((folder / "provenance.json").read_text())


def test_a_run_says_what_made_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["mjris", "train", "--out", "a folder"])
    found = written(tmp_path)
    assert found["python"] == platform.python_version()
    assert found["packages"]["numpy"] == np.__version__
    assert found["packages"].keys() == {"numpy", "torch", "mujoco", "numba", "stable-baselines3", "gymnasium"}
    assert (found["backend"], found["command"]) == ("1 cell learns", "mjris train --out 'a folder'")
    assert found["processor"]
    age = datetime.now(UTC) - datetime.fromisoformat(found["started"])
    assert timedelta(seconds=-1) < age < timedelta(minutes=1)


def test_the_commit_and_whether_anything_has_changed_since(checkout: Path, tmp_path: Path):
    head = git(checkout, "rev-parse", "HEAD")
    run = tmp_path / "run"
    run.mkdir()
    assert (written(run)["commit"], written(run)["dirty"]) == (head, False)  # runs beside it are no change
    for name in ("assets/policy", "package/new.py"):
        (checkout / name).write_text("y")
        assert (written(run)["commit"], written(run)["dirty"]) == (head, True)
        git(checkout, "reset", "--hard")


def test_a_package_that_is_installed_inside_another_repository_has_no_commit(checkout: Path, monkeypatch):
    (checkout / ".gitignore").write_text("site")
    (checkout / "site").mkdir()
    (checkout / "site" / "__init__.py").write_text("x")
    monkeypatch.setattr(provenance, "_SOURCES", checkout / "site")
    assert (written(checkout)["commit"], written(checkout)["dirty"]) == (None, None)


def test_without_git_there_is_no_commit(checkout: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", "")
    assert (written(checkout)["commit"], written(checkout)["dirty"]) == (None, None)
