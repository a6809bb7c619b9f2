"""Where the files are that come with the package."""

from pathlib import Path


def assets_dir() -> Path:
    """The assets folder: beside the modules in an installed package, beside `mjris` in a checkout."""
    package = Path(__file__).parent
    installed = package / "assets"
    return installed if installed.is_dir() else package.parent / "assets"
