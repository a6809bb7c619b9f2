"""The pages that say where an equation or a decision stands, and which test holds it: what they name is there."""

import ast
import pkgutil
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mjris.config import preset
from mjris.simulation.simulator import Simulator

ROOT = Path(__file__).parents[1]
PAGES = ("docs/model.md", "docs/change-an-equation.md", "docs/learning.md", "docs/reference.md", "README.md")
PACKAGES = "config|jit|world|radio|planning|simulation|envs|learn|eval|show"


@pytest.mark.parametrize("page", PAGES)
def test_tests_that_a_page_names_are_there(page):
    text = (ROOT / page).read_text()
    for file, names in re.findall(r"`(test_\w+\.py)`((?::?,?\s*`test_\w+`)*)", text):
        tree = ast.parse((ROOT / "tests" / file).read_text())
        defined = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert not set(re.findall(r"`(test_\w+)`", names)) - defined, file


@pytest.mark.parametrize("page", PAGES)
def test_functions_and_files_that_a_page_names_are_there(page):
    text = (ROOT / page).read_text()
    files = re.findall(rf"`((?:{PACKAGES})/\w+\.py)`", text)
    names = re.findall(rf"`(?:mjris\.)?((?:{PACKAGES})(?:\.\w+){{2,}})`", text)
    assert not [file for file in files if not (ROOT / "mjris" / file).is_file()]
    assert not [name for name in names if not resolves(name)]


def test_the_readmes_office_can_be_trained_in(tmp_path):
    path = tmp_path / "studio.toml"
    path.write_text(re.findall(r"```toml\n(# studio.toml\n.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0])
    config = preset("demo")
    simulator = Simulator(replace(config, world=replace(config.world, layout=str(path))))
    assert simulator.num_elements == config.radio.num_elements + 64


def resolves(name: str) -> bool:
    """Whether a dotted name of the package leads to something."""
    try:
        pkgutil.resolve_name(f"mjris.{name}")
    except AttributeError:
        # Fields of dataclasses that have no default are annotations alone.
        owner, _, field = name.rpartition(".")
        return field in getattr(pkgutil.resolve_name(f"mjris.{owner}"), "__annotations__", {})
    return True
