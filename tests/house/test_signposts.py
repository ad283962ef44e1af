r"""Signposts: which module is public, and which name, is seen from its name."""

import re
from pathlib import Path

import pytest
from house.measure import PACKAGE, House, names_of_all
from house.walks import FIT, Walk, walk_of

PUBLIC_LOOKING = 43  # may only fall
# Rooms and returns up to the runs, may only fall. One room more since modules of the working
# directory are found in one place for all commands, `_user_modules`.
WALKS = {"table": (9, 8), "compare": (11, 27)}
UNSIGNED = 0
WITHOUT_ALL: set[str] = set()
FILES = {  # a package with each kind of module once
    "__init__.pyi": "from . import room\n__all__ = ['room']\n",
    "__init__.py": "",
    "cli.py": "def main(): ...\n",
    "commands/__init__.py": "VERBS = ('go',)\n__all__ = ['VERBS']\n",
    "commands/go.py": "from package.room.layer import Layer\ndef run(arguments): ...\n",
    "commands/helper.py": "",
    "room/__init__.py": "from .layer import Layer, step\nfrom . import whole\n"
    "__all__ = ['Layer']\n__all__ += ['whole']\n",
    "room/layer.py": "class Layer: ...\ndef step(): ...\ndef _own(): ...\nSIZE: int = 3\n",
    "room/whole.py": "def first(): ...\n",
    "room/_hidden.py": "def second(): ...\n",
    "room/loose.py": "",
}


@pytest.fixture
def package(tmp_path: Path) -> House:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return House(tmp_path)


def test_what_counts_as_signed(package: House) -> None:
    assert package.exports == {
        ("commands.__init__", "VERBS"),
        ("room.layer", "Layer"),
        ("room.whole", "first"),
    }
    assert package.unsigned_modules == ["commands.helper", "room.loose"]
    assert package.public_looking == ["room.layer.step", "room.layer.SIZE"]


def test_every_module_is_exported_or_private_or_a_verb() -> None:
    found = House(PACKAGE).unsigned_modules
    assert len(found) <= UNSIGNED, found


def test_every_public_looking_name_is_exported() -> None:
    found = House(PACKAGE).public_looking
    assert len(found) <= PUBLIC_LOOKING, found


def test_a_name_has_one_meaning(package: House) -> None:
    assert package.ambiguous == []
    (package.root / "room" / "_hidden.py").write_text("class Layer: ...\ndef _own(): ...\n")
    assert House(package.root).ambiguous == ["Layer"]
    assert House(PACKAGE).ambiguous == []


def test_every_room_says_what_it_exports() -> None:
    house = House(PACKAGE)
    without = set()
    for name in house.inits:
        module = house.modules[name]
        room = name.rpartition(".")[0]
        holds_code = any(m.startswith(f"{room}.") and m != name for m in house.modules)
        is_lazy = module.path.with_suffix(".pyi").exists()
        if holds_code and not module.is_private and not is_lazy and not names_of_all(module.tree):
            without.add(room)
    # `nn` joins the lists of its rooms, in place of names; `io` exports its decoders.
    assert without - {"nn", "io.decoders"} <= WITHOUT_ALL


def test_exported_names_are_of_public_modules() -> None:
    house = House(PACKAGE)
    private = {f"{m}.{name}" for m, name in house.exports if house.modules[m].is_private}
    assert not private


WALKED = {
    "__init__.py": "",
    "commands/__init__.py": "",
    "commands/table.py": "def run(arguments):\n"
    "    from torch_geometric_tactile.rooms.plan import Plan, make\n"
    "    from torch_geometric_tactile.rooms.runs import run_plan\n"
    "    plan = make(arguments.name)\n"
    "    make(3)\n"
    "    for part in plan.pieces(): part.named()\n"
    "    run_plan(plan)\n",
    "rooms/plan.py": "from torch_geometric_tactile.rooms.names import clean\n"
    "class Plan:\n    def pieces(self): return [clean(self)]\n"
    "def make(name): return clean(name)\n",
    "rooms/names.py": "def clean(text): return text.strip()\n",
    "rooms/runs.py": "def run_plan(plan): plan.pieces()\n",
}


def test_walk_counts_stays_by_hand(tmp_path: Path) -> None:
    for name, text in WALKED.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    house = House(tmp_path)
    planned = ["commands.table", *["rooms.plan", "rooms.names"] * 2]
    assert walk_of(house, "table", "run_plan") == planned
    assert walk_of(house, "table", None) == [*planned, "rooms.runs", "rooms.plan"]
    with pytest.raises(ValueError, match="'fit' is not reached from 'tactile table'"):
        walk_of(house, "table", "fit")
    assert Walk(house).stays == []


@pytest.mark.parametrize("verb", WALKS)
def test_arguments_do_not_wander(verb: str) -> None:
    stays = walk_of(House(PACKAGE), verb, FIT)
    rooms, returns = WALKS[verb]
    assert len(set(stays)) <= rooms, stays
    assert len(stays) - len(set(stays)) <= returns, stays


def test_pages_and_tutorials_show_public_modules_only() -> None:
    root = PACKAGE.parent
    pages = [*root.glob("*.md"), *root.glob("docs/*.md"), *root.glob("tutorials/*.py")]
    assert len(pages) > 30
    private = re.compile(rf"^ *(?:from|import) {PACKAGE.name}[\w.]*\._", re.MULTILINE)
    assert not [path.name for path in pages if private.search(path.read_text("utf-8"))]
