r"""Puts the package into a folder of its own, which is searched last.

The whole package holds the same modules. Where both are installed, no file belongs to both, the
whole one is imported, and either may be removed; all else is in pyproject.toml.
"""

from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

_FOLDER = "_tactile_live"
_PACKAGES = find_packages(
    include=[
        "torch_geometric_tactile",
        "torch_geometric_tactile.commands",
        "torch_geometric_tactile.data",
        "torch_geometric_tactile.io*",
        "torch_geometric_tactile.live*",
        "torch_geometric_tactile.sensors",
    ]
)
_DATA = (
    *("py.typed", "__init__.pyi", "*/__init__.pyi", "sensors/layouts/*.json"),
    *("sensors/chains/*.json", "live/_viewer/*.html", "live/taxel_maps/*.json"),
)


class BuildWithPath(build_py):
    """Adds the line that appends the folder to the search path of modules."""

    def run(self) -> None:
        """Builds the modules, and writes the file that Python reads when it starts."""
        super().run()
        Path(self.build_lib, f"{_FOLDER}.pth").write_text(f"{_FOLDER}\n", encoding="utf-8")


setup(
    packages=[f"{_FOLDER}.{name}" for name in _PACKAGES],
    package_dir={f"{_FOLDER}.torch_geometric_tactile": "torch_geometric_tactile"},
    package_data={f"{_FOLDER}.torch_geometric_tactile": list(_DATA)},
    cmdclass={"build_py": BuildWithPath},
)
