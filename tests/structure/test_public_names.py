r"""Names show which modules, functions and classes are public."""

import re
from pathlib import Path

import pytest
from structure.package_files import PACKAGE, PackageFiles, names_of_all

PUBLIC_LOOKING = 43  # may only fall
UNEXPORTED = 0
WITHOUT_ALL: set[str] = set()
FILES = {  # a package with each kind of module once
    "__init__.pyi": "from . import layers\n__all__ = ['layers']\n",
    "__init__.py": "",
    "cli.py": "def main(): ...\n",
    "commands/__init__.py": "COMMANDS = ('go',)\n__all__ = ['COMMANDS']\n",
    "commands/go.py": "from package.layers.layer import Layer\ndef run(arguments): ...\n",
    "commands/helper.py": "",
    "layers/__init__.py": "from .layer import Layer, step\nfrom . import whole\n"
    "__all__ = ['Layer']\n__all__ += ['whole']\n",
    "layers/layer.py": "class Layer: ...\ndef step(): ...\ndef _own(): ...\nSIZE: int = 3\n",
    "layers/whole.py": "def first(): ...\n",
    "layers/_hidden.py": "def second(): ...\n",
    "layers/loose.py": "",
}


@pytest.fixture
def package(tmp_path: Path) -> PackageFiles:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return PackageFiles(tmp_path)


def test_exported_names_and_modules(package: PackageFiles) -> None:
    assert package.exports == {
        ("commands.__init__", "COMMANDS"),
        ("layers.layer", "Layer"),
        ("layers.whole", "first"),
    }
    assert package.unexported_modules == ["commands.helper", "layers.loose"]
    assert package.public_looking == ["layers.layer.step", "layers.layer.SIZE"]


def test_every_module_is_exported_or_private_or_a_command() -> None:
    names = PackageFiles(PACKAGE).unexported_modules
    assert len(names) <= UNEXPORTED, names


def test_every_public_looking_name_is_exported() -> None:
    names = PackageFiles(PACKAGE).public_looking
    assert len(names) <= PUBLIC_LOOKING, names


def test_a_name_has_one_meaning(package: PackageFiles) -> None:
    assert package.ambiguous == []
    (package.root / "layers" / "_hidden.py").write_text("class Layer: ...\ndef _own(): ...\n")
    assert PackageFiles(package.root).ambiguous == ["Layer"]
    assert PackageFiles(PACKAGE).ambiguous == []


def test_every_package_lists_its_exports() -> None:
    files = PackageFiles(PACKAGE)
    without = set()
    for name in files.inits:
        module = files.modules[name]
        package = name.rpartition(".")[0]
        holds_code = any(m.startswith(f"{package}.") and m != name for m in files.modules)
        is_lazy = module.path.with_suffix(".pyi").exists()
        if holds_code and not module.is_private and not is_lazy and not names_of_all(module.tree):
            without.add(package)
    # `nn` joins the lists of its subpackages; `io` exports its decoders.
    assert without - {"nn", "io.decoders"} <= WITHOUT_ALL


def test_exported_names_are_of_public_modules() -> None:
    files = PackageFiles(PACKAGE)
    private = {f"{m}.{name}" for m, name in files.exports if files.modules[m].is_private}
    assert not private


def test_pages_and_tutorials_show_public_modules_only() -> None:
    root = PACKAGE.parent
    pages = [*root.glob("*.md"), *root.glob("docs/*.md"), *root.glob("tutorials/*.py")]
    assert len(pages) > 30
    private = re.compile(rf"^ *(?:from|import) {PACKAGE.name}[\w.]*\._", re.MULTILINE)
    assert not [path.name for path in pages if private.search(path.read_text("utf-8"))]
