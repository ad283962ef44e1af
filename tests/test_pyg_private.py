"""The private parts of PyG that the package uses are there, in its oldest and newest release."""

import ast
from pathlib import Path

import torch
from torch_geometric.data import Batch, Data, Dataset, InMemoryDataset
from torch_geometric.nn import GCNConv, MessagePassing

import torch_geometric_tactile

# All are in PyG 2.6.0 to 2.8.1. Those of storages are what samples are cut by without a check of
# each attribute, those of batches what `Batch.from_data_list` leaves, those of data sets what
# processes again when settings change, and that of GCNConv is its cache.
USED = {
    "Data": {"_store"},
    "GlobalStorage": {"_mapping", "_parent"},
    "Batch": {"_inc_dict", "_num_graphs", "_slice_dict"},
    "Dataset": {"_download", "_indices", "_infer_num_classes", "_process"},
    "InMemoryDataset": {"_data"},
    "MessagePassing": {"_jinja_propagate", "_orig_propagate", "_set_jittable_templates"},
    "GCNConv": {"_cached_edge_index"},
}
# Names in classes of ours that do not inherit from these.
NAMESAKES = {"GlobalStorage": {"_select"}}


class Numbers(Dataset):
    def len(self):
        return 1

    def get(self, idx):
        return Data()


def private(thing):
    names = {*dir(thing), *vars(thing)}
    return {name for name in names if name.startswith("_") and not name.endswith("__")}


class Passing(MessagePassing):
    """A class of its own: a bare one would be compiled into PyG's, for all tests that follow."""


def of_pyg():
    """Returns the private names of the objects that the package inherits from or reads."""
    data = Data(x=torch.ones(1, 1), edge_index=torch.zeros(2, 1, dtype=torch.long))
    batch = Batch.from_data_list([data])
    conv = GCNConv(1, 1)
    conv(data.x, data.edge_index)
    found = {
        "Data": private(data),
        "GlobalStorage": private(data._store),
        "Batch": private(batch) | private(batch._store),
        "Dataset": private(Numbers()),
        "InMemoryDataset": private(InMemoryDataset()),
        "MessagePassing": private(Passing()),
        "GCNConv": private(conv),
    }
    of_torch = private(torch.nn.Module()) | private(torch.utils.data.Dataset())
    for name, parent in (
        ("GCNConv", "MessagePassing"),
        ("InMemoryDataset", "Dataset"),
        ("Batch", "GlobalStorage"),
        ("Batch", "Data"),
    ):
        found[name] -= found[parent]
    return {name: names - of_torch for name, names in found.items()}


def names_in(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_private_names_shared_with_pyg_are_listed():
    # Those that it has and the package uses, be it on purpose or by accident.
    ours = set()
    for path in Path(torch_geometric_tactile.__file__).parent.rglob("*.py"):
        ours.update(names_in(ast.parse(path.read_text(encoding="utf-8"))))
    found = {name: names & ours for name, names in of_pyg().items()}
    found = {name: names - NAMESAKES.get(name, set()) for name, names in found.items()}
    assert {name: names for name, names in found.items() if names} == USED
