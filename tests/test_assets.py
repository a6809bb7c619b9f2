import shutil

from mjris import assets
from mjris.assets import assets_dir
from mjris.world.layout import load_layout


def test_assets_are_found_beside_the_modules_of_an_installed_package(tmp_path, monkeypatch):
    package = tmp_path / "mjris"
    shutil.copytree(assets_dir(), package / "assets")
    monkeypatch.setattr(assets, "__file__", str(package / "assets.py"))
    assert assets_dir() == package / "assets"
    assert load_layout("office").name == "office"
