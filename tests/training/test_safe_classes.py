r"""What a checkpoint, or a configuration beside one, may name."""

import contextlib
import inspect
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
from hostile_settings import LINEAR

from torch_geometric_tactile.training import safe_classes
from torch_geometric_tactile.training.safe_classes import DENIED, PACKAGES, safe_section


class OwnNet(torch.nn.Module):
    def __init__(self, width: int = 3):
        super().__init__()
        self.width = width


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("os.system", r"names 'os\.system'"),
        ("torch.fx.GraphModule", r"names 'torch\.fx\.GraphModule'"),
        ("torch.nn.functional.relu", "must name a class, not a function"),
        ("torch.nn.modules.module.torch", r"names 'torch\.nn\.modules\.module\.torch'"),
        ("torch_geometric_tactile.files.os", r"names 'torch_geometric_tactile\.files\.os'"),
        ("torch_geometric_tactile.files.os.system", "must be a class"),
        ("torch_geometric_tactile.files.zipfile.ZipFile", "must be a class"),
        ("torch_geometric_tactile.files.Path", r"names 'pathlib(\._local)?\.Path'"),
        ("torch_geometric_tactile.__main__.main", "must be an import path"),
        ("torch_geometric_tactile..files.os", "must be an import path"),
        ("torch_geometric.nn.Sequential", r"names 'torch_geometric\.nn\.sequential\.Sequential'"),
        ("torch.nn.quantized.Linear", r"names 'torch\.ao\."),
        ("torch.nn.parallel.DataParallel", r"names 'torch\.nn\.parallel\.DataParallel'"),
        ("torch.optim.Adam", r"must be a Module \(got 'torch\.optim\.Adam'\)"),
        ("torch_geometric_tactile.sensors.TaxelLayout", "must be a Module"),
        ("lightning.pytorch.cli.ReduceLROnPlateau", "must be a Module"),
        ("Nothing", "names 'Nothing'"),
        (3, r"'model\.model\.class_path' must be a text \(got int\)"),
    ],
)
def test_classes_that_a_file_may_not_name(path, message):
    before = set(sys.modules)
    with pytest.raises(ValueError, match=f"'a.ckpt' cannot be used: .*{message}"):
        safe_section("model", {"model": {"class_path": path}}, "a.ckpt")
    with pytest.raises(ValueError, match=r"'a\.ckpt' cannot be used"):
        safe_section("model", {"model": path}, "a.ckpt")
    new = {name for name in set(sys.modules) - before if not name.startswith((*PACKAGES, "torch."))}
    assert not new


def test_nothing_is_imported_to_check_a_name(tmp_path, monkeypatch):
    (tmp_path / "own_effects.py").write_text("from pathlib import Path; Path('mark').touch()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for value in ("own_effects.Net", [{"class_path": "own_effects.Net"}], {"a": "own_effects.b"}):
        settings = {"model": {**LINEAR, "init_args": {"bias": value}}}
        with pytest.raises(ValueError, match=r"names 'own_effects\.\w+'.* --allow own_effects"):
            safe_section("model", settings, "a.ckpt")
    assert not (tmp_path / "mark").exists()
    assert "own_effects" not in sys.modules


def test_names_get_their_full_paths():
    settings = {
        "model": {
            "class_path": "TactileGCN",
            "init_args": {"act": {"class_path": "ReLU"}, "b": None},
        },
        "optimizer": {"class_path": "torch.optim.SGD", "init_args": {"lr": 0.1}},
        "lr_scheduler": "StepLR",
        "num_classes": 3,
    }
    found = safe_section("model", settings, "a.ckpt")
    gcn = "torch_geometric_tactile.nn.models.tactile_gcn.TactileGCN"
    relu = "torch.nn.modules.activation.ReLU"
    assert found == {
        "model": {"class_path": gcn, "init_args": {"act": {"class_path": relu}, "b": None}},
        "optimizer": {"class_path": "torch.optim.sgd.SGD", "init_args": {"lr": 0.1}},
        "lr_scheduler": {"class_path": "torch.optim.lr_scheduler.StepLR"},
        "num_classes": 3,
    }
    assert safe_section("model", found, "a.ckpt") == found


def test_texts_that_mean_nothing_else_are_kept(tmp_path):
    (tmp_path / "pad.json").write_text("{}")
    texts = ["relu", "mean", "biotac_sp", "a b: c", "torch.float64", "v1.2", "torch.nn.ReLU", ""]
    values = {"a": texts, "b": (1, 2.5, True), "layout": str(tmp_path / "pad.json")}
    found = safe_section("model", {"model": {**LINEAR, "init_args": values}}, "a.ckpt")
    assert found["model"]["init_args"] == {**values, "b": [1, 2.5, True]}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("http://127.0.0.1/a.yaml", "must be no file or address"),
        ("zip::a.yaml", "must be no file or address"),
        (__file__, "must be no file or address"),
        ("/dev/null", "must be no file or address"),
        ("os.system", r"names 'os\.system'"),
        ("subprocess.run", r"names 'subprocess\.run'"),
        ("torch.load", r"names 'torch\.load'"),
        ("torch.nn.functional.relu", "must name a class, not a function"),
        ("OwnNet", r"names '[\w.]*OwnNet'"),
        ({1: {"class_path": "os.system"}}, r"names 'os\.system'"),
        ({"class_path": ["os.system"]}, "must be a text"),
        ({"class_path": "torch.nn.ReLU", "init_args": [1]}, "must be a mapping"),
        ({"class_path": "torch.nn.ReLU", "call": 1}, "must have the keys"),
        ({(1, 2): 3}, "must have names as keys"),
        ({1}, r"must be plain data \(got set\)"),
    ],
)
def test_values_that_a_file_may_not_hold(value, message):
    settings = {"model": {"class_path": "torch.nn.Linear", "init_args": {"a": value}}}
    with pytest.raises(
        ValueError, match=rf"'a\.ckpt' cannot be used: 'model\.model\.a.*' {message}"
    ):
        safe_section("model", settings, "a.ckpt")


def test_settings_without_end_are_refused():
    endless = []
    endless.append(endless)
    many = [0] * 400
    for _ in range(3):
        many = [many] * 400
    for value in (endless, many):
        with pytest.raises(ValueError, match=r"must hold at most 100000 values, nested 50 deep"):
            safe_section("model", {"model": LINEAR, "class_weights": value}, "a.ckpt")
    for settings in (3, [LINEAR], None):
        with pytest.raises(ValueError, match=r"'model' must be a mapping"):
            safe_section("model", settings, "a.ckpt")
    with pytest.raises(ValueError, match=r"'model\.model' must have a 'class_path'"):
        safe_section("model", {"model": {"in_features": 1}}, "a.ckpt")


def test_limits_of_settings(monkeypatch):
    monkeypatch.setattr(safe_classes, "_MAX_VALUES", 7)
    safe_section("model", {"task": "multiclass", "other": [1, 2, [3, 4]]}, "a.ckpt")  # seven
    with pytest.raises(ValueError, match=r"'model.other\[3\]' must hold at most 7 values"):
        safe_section("model", {"task": "multiclass", "other": [1, 2, [3, 4], 5]}, "a.ckpt")
    monkeypatch.setattr(safe_classes, "_MAX_DEPTH", 2)
    safe_section("model", {"other": [[1]]}, "a.ckpt")
    with pytest.raises(ValueError, match=r"must hold at most 7 values, nested 2 deep"):
        safe_section("model", {"other": [[[1]]]}, "a.ckpt")


def own_function():
    pass


def test_own_classes_are_allowed_by_name(tmp_path):
    settings = {"model": {"class_path": f"{__name__}.OwnNet"}}
    for allow in ([__name__], [f"{__name__}.OwnNet"]):
        found = safe_section("model", settings, "a.ckpt", allow)
        assert found == settings
    for allow in (["os"], [__name__[:-1]]):
        with pytest.raises(ValueError, match=rf"allow=\['{__name__}\.OwnNet'\] in Python"):
            safe_section("model", settings, "a.ckpt", allow)
    with pytest.raises(ValueError, match="must name a class, not a function"):
        safe_section("model", {"model": f"{__name__}.own_function"}, "a.ckpt", [__name__])
    # What she allows is not what her module has from elsewhere.
    with pytest.raises(ValueError, match=r"names 'pathlib"):
        safe_section("model", {"model": f"{__name__}.Path"}, "a.ckpt", [__name__])
    with pytest.raises(ValueError, match="'allow' must be a list of packages"):
        safe_section("model", settings, "a.ckpt", __name__)


SUSPICIOUS = re.compile(
    r"\beval_type\(|(?<![.\w])(?<!def )(eval|exec|open)\(|import_module\(|__import__\(|"
    r"torch\.load\(|\bsubprocess\b|os\.system|pickle\.load|\bhub\.load"
)

# Looked at by hand: none does so in a constructor, or by a text that it is given.
REVIEWED = {
    "torch.nn.functional",
    "torch.optim.optimizer",
    "torch_geometric.nn.conv.utils.cheatsheet",
    "torch_geometric.nn.models.dimenet",
    "torch_geometric.nn.models.gpse",
    "torch_geometric.nn.models.schnet",
}


@pytest.mark.parametrize("package", [p for p in PACKAGES if p != "torch_geometric_tactile"])
def test_allowed_packages_evaluate_no_text(package):
    (folder,) = find_spec(package).submodule_search_locations
    found = set()
    for path in Path(folder).rglob("*.py"):
        relative = path.relative_to(folder).with_suffix("").parts
        name = ".".join([package, *(part for part in relative if part != "__init__")])
        denied = any(name == entry or name.startswith(f"{entry}.") for entry in DENIED)
        if not denied and SUSPICIOUS.search(path.read_text(encoding="utf-8")):
            found.add(name)
    assert found <= REVIEWED


def test_sequential_of_pyg_would_evaluate_a_text(tmp_path):
    from torch_geometric.nn import Sequential

    code = f"x: __import__('pathlib').Path({str(tmp_path / 'mark')!r}).touch()"
    if "eval_type" in inspect.getsource(sys.modules[Sequential.__module__]):
        with contextlib.suppress(Exception):
            Sequential(code, [(torch.nn.ReLU(), "x -> x")])
        assert (tmp_path / "mark").exists()
