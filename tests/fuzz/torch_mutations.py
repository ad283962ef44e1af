"""Mutations of PyTorch's files and of configurations: other tensors, members and pickles, and
classes that do harm. Checksums are right.
"""

import copy
import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

import torch
from fuzz.laws import JUDGED, REFUSED, REWRITTEN
from fuzz.tree_mutations import mutated_tree

MARKER = "MARKER"  # a file in the working directory of the worker, made by code of a case


class Hostile:
    """Makes the marker when it is unpickled."""

    def __init__(self, draw: Random) -> None:
        self.calls = draw.choice(
            [
                (os.system, (f"touch {MARKER}",)),
                (open, (MARKER, "w")),
                (os.mkdir, (MARKER,)),
                (eval, (f"open('{MARKER}', 'w')",)),
            ]
        )

    def __reduce__(self) -> Any:
        return self.calls


HARMFUL: tuple[dict[str, Any], ...] = (
    {
        "class_path": "torch.fx.graph_module.reduce_graph_module",
        "init_args": {
            "body": {"_code": "def forward(self, x):\n    return x\n"},
            "import_block": f"open('{MARKER}', 'w')",
        },
    },
    {"class_path": "os.system", "init_args": {"command": f"touch {MARKER}"}},
    {"class_path": "os.mkdir", "init_args": {"path": MARKER}},
    {"class_path": "io.open", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "io.FileIO", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "zipfile.ZipFile", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "logging.FileHandler", "init_args": {"filename": MARKER}},
    {"class_path": "subprocess.Popen", "init_args": {"args": ["touch", MARKER]}},
    {"class_path": "subprocess.check_output", "init_args": {"args": ["touch", MARKER]}},
    {"class_path": "builtins.exec", "init_args": {"source": f"open('{MARKER}', 'w')"}},
    {"class_path": "builtins.eval", "init_args": {"source": f"open('{MARKER}', 'w')"}},
    {"class_path": "torch.save", "init_args": {"obj": 1, "f": MARKER}},
    {"class_path": "torch.utils.tensorboard.SummaryWriter", "init_args": {"log_dir": MARKER}},
    {"class_path": "torch.hub.load", "init_args": {"repo_or_dir": ".", "model": "a"}},
    {"class_path": "torch.package.PackageExporter", "init_args": {"f": MARKER}},
    {"class_path": "lightning.pytorch.loggers.CSVLogger", "init_args": {"save_dir": MARKER}},
    {"class_path": "lightning.Trainer", "init_args": {"default_root_dir": MARKER}},
    {"class_path": "torch_geometric.datasets.FakeDataset", "init_args": {}},
    {"class_path": "torch_geometric.data.InMemoryDataset", "init_args": {"root": MARKER}},
    {
        "class_path": "torch_geometric_tactile.datasets.RecordingFrames",
        "init_args": {"root": MARKER, "layout": "biotac"},
    },
    {
        "class_path": "torch.nn.Sequential",
        "init_args": {"args": [{"class_path": "io.FileIO", "init_args": {"file": MARKER}}]},
    },
    {
        "class_path": "torch_geometric_tactile.nn.models.TactileGCN",
        "init_args": {
            "layout": 4,
            "encoder": {"class_path": "io.FileIO", "init_args": {"file": MARKER, "mode": "w"}},
        },
    },
    {"class_path": "torch_geometric_tactile.io.write_npz", "init_args": {"path": MARKER}},
    {"class_path": "torch_geometric_tactile._files.atomic_path", "init_args": {"path": MARKER}},
    {"class_path": "torch.jit.load", "init_args": {"f": MARKER}},
    {"class_path": "no.such.Class", "init_args": {}},
    {"class_path": "torch.nn", "init_args": {}},
    {"class_path": "Linear", "init_args": {"in_features": 1, "out_features": 1}},
    {"class_path": "", "init_args": {}},
)


def harmful(draw: Random) -> Any:
    """What stands for a class and is none, or none of the right kind."""
    content = dict(draw.choice(HARMFUL))
    if draw.random() < 0.2:
        content.pop("init_args")
    if draw.random() < 0.1:
        return content["class_path"]
    return content


def with_harm(tree: Any, draw: Random) -> Any:
    """A configuration in which one class is another, or holds another."""
    tree = copy.deepcopy(tree)
    spots = list(_class_places(tree))
    container, key = draw.choice(spots)
    if draw.random() < 0.3:
        arguments = container[key].setdefault("init_args", {}) or {}
        container[key]["init_args"] = arguments
        name = draw.choice([*arguments, "encoder", "model", "params"])
        arguments[name] = draw.choice([harmful(draw), [harmful(draw)], {"a": harmful(draw)}])
    else:
        container[key] = harmful(draw)
    return tree


def with_harm_inside(tree: Any, draw: Random) -> Any:
    """A description in which one value, at any depth, is or holds a class, also as a text."""
    tree = copy.deepcopy(tree)
    harm = harmful(draw)
    text = json.dumps(harm)
    forms = [harm, [harm], {"model": harm}, text, [text], f"[{text}]"]
    line_end = draw.choice("\r\n\x85\u2028\u2029")
    forms.append(text.replace('"class_path"', f'? "class_\\{line_end}path" '))
    container, key = draw.choice(list(_values(tree)))
    container[key] = draw.choice(forms)
    return tree


def _values(tree: Any) -> Any:
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _values(value)


def _class_places(tree: Any) -> Any:
    items = list(tree.items() if isinstance(tree, dict) else enumerate(tree))
    for key, value in items:
        if isinstance(value, dict) and "class_path" in value:
            yield tree, key
        if isinstance(value, dict | list):
            yield from _class_places(value)


_TENSORS: tuple[Callable[[torch.Tensor], object], ...] = (
    lambda t: t.double(),
    lambda t: t.to(torch.complex64),
    lambda t: t.long(),
    lambda t: t[:0],
    lambda t: t[None],
    lambda t: t.flatten()[:1],
    lambda t: t.to_sparse(),
    lambda t: t.to_sparse_csr(),
    lambda t: torch.nested.nested_tensor([t, t[:1]]),
    lambda t: torch.nested.nested_tensor([t, t[:1]], layout=torch.jagged),
    lambda t: torch.quantize_per_tensor(t.float(), 0.1, 0, torch.quint8),
    lambda t: t.to("meta"),
    lambda t: torch.full_like(t, float("nan")),
    lambda t: None,
    lambda t: "text",
    lambda t: [1.0],
    lambda t: t.bool(),
    lambda t: t.expand(1000, *t.shape),
    lambda t: torch.zeros(1).expand(10**6, 10**6),
)


def other_tensor(tree: Any, draw: Random) -> Any:
    """A tree of PyTorch's with another tensor in one place."""
    spots = list(_tensor_places(tree))
    container, key = draw.choice(spots)
    value = container[key]
    kind = draw.randrange(4)
    if kind == 0 and isinstance(container, dict):
        del container[key]
    elif kind == 1 and isinstance(container, dict):
        container[draw.choice([f"{key}_", str(key)[:-1], str(key).upper()])] = container.pop(key)
    elif kind == 2:
        other, place = draw.choice(spots)
        container[key], other[place] = other[place], value
    else:
        try:
            container[key] = draw.choice(_TENSORS)(value)
        except (RuntimeError, IndexError, TypeError):
            container[key] = 0
    return tree


def mutated_tensor(data: bytes, draw: Random) -> tuple[bytes, str]:
    """A file of one tensor with another member, pickle or form of tensor in it."""
    kind = draw.randrange(4)
    if kind == 0:
        return _other_members(data, draw), JUDGED
    if kind == 1:
        return _other_pickle(data, draw), REFUSED
    holder = {"x": torch.load(io.BytesIO(data), weights_only=True)}
    tree = other_tensor(holder, draw)
    return saved(tree.get("x", tree)), REWRITTEN


def _tensor_places(tree: Any) -> Any:
    items = list(tree.items() if isinstance(tree, dict) else enumerate(tree))
    for key, value in items:
        if isinstance(value, torch.Tensor):
            yield tree, key
        elif isinstance(value, dict | list):
            yield from _tensor_places(value)


def saved(tree: Any) -> bytes:
    out = io.BytesIO()
    torch.save(tree, out)
    return out.getvalue()


def mutated_torch(data: bytes, draw: Random) -> tuple[bytes, str]:
    """A file of ``torch.save`` with another tree, tensor, pickle or member in it."""
    kind = draw.randrange(6)
    if kind == 0:
        return _other_members(data, draw), JUDGED
    if kind == 1:
        return _other_pickle(data, draw), REFUSED
    tree = torch.load(io.BytesIO(data), weights_only=True)
    if kind == 2:
        return saved(other_tensor(tree, draw)), REWRITTEN
    if kind == 3:
        forms = [None, [], {}, "text", torch.zeros(3), {"a": tree}, [tree], tree and 0]
        return saved(draw.choice(forms)), REFUSED
    if kind == 4 and isinstance(tree, dict) and "module" in tree:
        tree["module"] = with_harm_inside(tree["module"], draw)
        tree["hyper_parameters"] = with_harm({"x": tree["config"]}, draw)["x"]
        tree["hyper_parameters"]["_instantiator"] = draw.choice(
            ["os.system", "builtins.exec", "lightning.pytorch.cli.instantiate_module", 3]
        )
        return saved(tree), REWRITTEN
    return saved(mutated_tree(tree, draw)), REWRITTEN


def _other_members(data: bytes, draw: Random) -> bytes:
    """The members of a zip file in another order, packed, renamed, or one of them gone."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    kind = draw.randrange(6)
    place = draw.randrange(len(members))
    name, content = members[place]
    packing = zipfile.ZIP_STORED
    if kind == 0:
        packing = draw.choice([zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
    elif kind == 1 and "data/" not in name:
        # What PyTorch does not need, such as its serial number, may be gone.
        members[place] = (name + "_", content)
    elif kind == 2:
        draw.shuffle(members)
    elif kind == 3:
        members.append((draw.choice([f"{name.split('/')[0]}/extra", "../x", name + "/x"]), b"text"))
    elif kind == 4 and "data/" in name:
        del members[place]
    elif "data/" in name:
        members[place] = (name, content[:-1] if kind == 5 else content[:0])
    with zipfile.ZipFile(out, "w", packing) as archive:
        for member, text in members:
            archive.writestr(member, text)
    return out.getvalue()


def _other_pickle(data: bytes, draw: Random) -> bytes:
    hostile = pickle.dumps(draw.choice([Hostile(draw), {"state_dict": Hostile(draw)}]), protocol=2)
    if draw.random() < 0.3:
        return hostile
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(out, "w") as other:
        for entry in archive.infolist():
            is_pickle = entry.filename.endswith("data.pkl")
            other.writestr(entry.filename, hostile if is_pickle else archive.read(entry))
    return out.getvalue()
