import csv
import os
import shutil
import sys
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
import torch
from pairs import select_pairs

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.sensors import grid

pytest_plugins = ["experiment_fixtures", "training_fixtures"]
collect_ignore = ["lerobot_exports/read_exports.py"]  # runs where LeRobot is installed

BTS3_PALMS = ("down", "side", "45")
BTS3_NAMES = [f"bts3v2_palm_{palm}{part}.csv" for part in ("", "_test") for palm in BTS3_PALMS]
BTS3_HEADER = [
    "object",
    "slipped",
    *(f"{finger}_biotac_{i}" for finger in ("ff", "mf", "th") for i in range(1, 25)),
]

# Fixtures of a session or module that take seconds: the tests that share one run in one process.
SHARED_FIXTURES = ("paper8_grasps", "control8_grasps", "undisturbed", "report", "launch_chromium")
# Files that wait for the same compilation, likewise.
SHARED_COMPILATION = {"analysis/test_embedding.py": "umap", "reports/test_analysis.py": "umap"}


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items):
    """Groups tests that share work, and runs slow ones first, to keep all processes busy."""
    items[:] = select_pairs(items)
    for item in items:
        path = item.path.as_posix()
        names = [name for name in SHARED_FIXTURES if name in getattr(item, "fixturenames", ())]
        names += [name for end, name in SHARED_COMPILATION.items() if path.endswith(end)]
        if names:
            item.add_marker(pytest.mark.xdist_group(names[0]))
        if item.get_closest_marker("full"):
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(scope="session")
def cache_folders(tmp_path_factory):
    """A folder for the caches of all tests."""
    return tmp_path_factory.mktemp("tactile_data")


@pytest.fixture(autouse=True)
def private_cache(monkeypatch, cache_folders):
    """No test reads or fills the user's cache."""
    folder = cache_folders / uuid4().hex  # pytest's numbered folders look through all others
    folder.mkdir()
    monkeypatch.setenv("TACTILE_DATA", str(folder))


@pytest.fixture(autouse=True)
def same_draws():
    """A test draws the same numbers whichever tests ran before it."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def bts3_recordings():
    """The folder with the six published files."""
    shared = Path(__file__).resolve().parents[2] / "shared" / "data" / "biotacsp"
    folder = Path(os.environ.get("TACTILE_TEST_DATA") or shared)
    missing = [name for name in BTS3_NAMES if not (folder / name).is_file()]
    if missing:
        pytest.skip(
            f"'{missing[0]}' of the BioTac SP stability set is not in '{folder}'; "
            "set TACTILE_TEST_DATA to the folder that has it"
        )
    return folder


@pytest.fixture(scope="session")
def bts3_root(bts3_recordings, tmp_path_factory):
    """A root of BioTacSP with the six published files in it."""
    root = tmp_path_factory.mktemp("bts3")
    (root / "raw").mkdir()
    for name in BTS3_NAMES:
        shutil.copyfile(bts3_recordings / name, root / "raw" / name)
    return root


@pytest.fixture(scope="session")
def eflesh_probe():
    """The folder with the published runs of eFlesh's probe."""
    shared = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_TEST_DATA") or shared) / "eflesh_probe"
    if not (folder / "normal_force").is_dir():
        pytest.skip(
            f"the runs of eFlesh's probe are not in '{folder}'; "
            "set TACTILE_TEST_DATA to the folder that has them"
        )
    return folder


@pytest.fixture(scope="session")
def icub_root(tmp_path_factory):
    """A root of ICubGrasp with the 230 published files in it."""
    shared = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_TEST_DATA") or shared)
    inner = (
        "icub_grasp/iCubGraspDataset",
        "iCubGraspDataset",
        ".",
        "../icub_grasp/iCubGraspDataset",
    )
    found = [folder / name for name in inner if (folder / name / "blue_bear_1.txt").is_file()]
    if not found:
        pytest.skip(
            f"the iCub Grasp data set is not in '{folder}/iCubGraspDataset'; "
            "set TACTILE_TEST_DATA to the folder that has it"
        )
    root = tmp_path_factory.mktemp("icub")
    (root / "raw").mkdir()
    for path in found[0].glob("*_*.txt"):
        shutil.copyfile(path, root / "raw" / path.name)
    return root


@pytest.fixture(scope="session")
def published_root(tmp_path_factory):
    """A root with copies of published files: ``published_root("eflesh_slip")``."""
    shared = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_TEST_DATA") or shared)

    def root(name):
        found = [path for path in (folder / name, folder.parent / name) if path.is_dir()]
        if not found:
            pytest.skip(
                f"there is no '{name}' in '{folder}'; set TACTILE_TEST_DATA to the folder that "
                "has it"
            )
        return shutil.copytree(found[0], tmp_path_factory.mktemp("published") / name)

    return root


@pytest.fixture(scope="session")
def write_bts3():
    """Writes six small files with the upstream names: ``write_bts3(folder)``."""

    def write(folder, rows=8, train_objects=4, test_objects=2, seed=0):
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        draw = np.random.default_rng(seed)
        for name in BTS3_NAMES:
            part, objects = ("test", test_objects) if "_test" in name else ("train", train_objects)
            with (folder / name).open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(BTS3_HEADER)
                for i in range(rows):
                    reading = draw.integers(1000, 4000, 72).tolist()
                    writer.writerow([f"{part}_{i % objects}", i % 2, *reading])
        return folder

    return write


class ToyDataset(StaticDataset):
    """Six samples of two channels on a square of four taxels, in three trials with two objects."""

    reads = 0

    def __init__(self, root=None, **kwargs):
        self.layout = grid(2, 2, pitch=0.01)
        super().__init__(root, **kwargs)

    @property
    def processed_file_names(self):
        return "toy.pt"

    def read(self):
        type(self).reads += 1
        data = StaticData(
            x=torch.arange(48.0).view(6, 4, 2),
            edge_index=self.layout.edge_index("original"),
            y=torch.tensor([0, 1, 0, 1, 0, 1]),
            pos=self.layout.pos,
            trial=torch.tensor([0, 0, 1, 1, 2, 2]),
            group=torch.tensor([0, 0, 0, 0, 1, 1]),
        )
        return data, {"class": ["stable", "slip"], "group": ["cup", "box"]}


@pytest.fixture
def toy():
    """The class of a small data set, with a fresh count of its reads."""
    ToyDataset.reads = 0
    return ToyDataset


@pytest.fixture(autouse=True)
def forget_modules_of_the_test(tmp_path_factory):
    """A module that a test writes and imports is not that of the next test."""
    known, path = set(sys.modules), list(sys.path)
    yield
    sys.path[:] = path
    folder = str(tmp_path_factory.getbasetemp())
    for name in sys.modules.keys() - known:
        file = getattr(sys.modules[name], "__file__", None)
        if isinstance(file, str) and file.startswith(folder):
            del sys.modules[name]
