"""What PyG's normalisations and pools do with stacked samples (B, N, F), as docs/static_data.md
says."""

import inspect
import re
from pathlib import Path

import pytest
import torch
from torch_geometric import nn
from torch_geometric.nn import aggr

PAGE = Path(__file__).parents[2] / "docs" / "static_data.md"
NUM_TAXELS = 6
MAKES = {
    "BatchNorm": nn.BatchNorm,
    "DiffGroupNorm": lambda width: nn.DiffGroupNorm(width, 2),
    "GraphNorm": nn.GraphNorm,
    "GraphSizeNorm": lambda width: nn.GraphSizeNorm(),
    "InstanceNorm": nn.InstanceNorm,
    "LayerNorm": nn.LayerNorm,
    "LayerNorm(mode='node')": lambda width: nn.LayerNorm(width, mode="node"),
    "MeanSubtractionNorm": lambda width: nn.MeanSubtractionNorm(),
    "PairNorm": lambda width: nn.PairNorm(),
    "global_add_pool": lambda width: nn.global_add_pool,
    "global_max_pool": lambda width: nn.global_max_pool,
    "global_mean_pool": lambda width: nn.global_mean_pool,
    "AttentionalAggregation": lambda width: aggr.AttentionalAggregation(torch.nn.Linear(width, 1)),
    "GRUAggregation": lambda width: aggr.GRUAggregation(width, 3),
    "LSTMAggregation": lambda width: aggr.LSTMAggregation(width, 3),
    "MaxAggregation": lambda width: aggr.MaxAggregation(),
    "MeanAggregation": lambda width: aggr.MeanAggregation(),
    "MedianAggregation": lambda width: aggr.MedianAggregation(),
    "MinAggregation": lambda width: aggr.MinAggregation(),
    "Set2Set": lambda width: aggr.Set2Set(width, 2),
    "SoftmaxAggregation": lambda width: aggr.SoftmaxAggregation(),
    "SortAggregation": lambda width: aggr.SortAggregation(3),
    "StdAggregation": lambda width: aggr.StdAggregation(),
    "SumAggregation": lambda width: aggr.SumAggregation(),
    "VarAggregation": lambda width: aggr.VarAggregation(),
    "MemPooling": lambda width: first_of(nn.MemPooling(width, 3, 2, 2).eval()),
    "SAGPooling": lambda width: pool_of(nn.SAGPooling(width, 0.5)),
    "TopKPooling": lambda width: pool_of(nn.TopKPooling(width, 0.5)),
}


def first_of(pool):
    return lambda x, batch=None: pool(x, batch)[0]


def pool_of(pool):
    edges = torch.tensor([[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]])

    def pooled(x, batch=None):
        if batch is None:
            return pool(x, edges)[0]
        starts = NUM_TAXELS * torch.arange(len(x) // NUM_TAXELS)
        joined = torch.cat([edges + start for start in starts], dim=1)
        return pool(x, joined, batch=batch)[0]

    return pooled


def verdict(name):
    """For fewer, as many and more samples and features than taxels."""
    found = set()
    for num_samples, width in ((1, 4), (4, 4), (6, 4), (9, 4), (4, 6)):
        torch.manual_seed(0)
        layer = MAKES[name](width)
        x = torch.randn(num_samples, NUM_TAXELS, width) + 1
        batch = torch.arange(num_samples).repeat_interleave(NUM_TAXELS)
        own = isinstance(layer, torch.nn.Module)
        parameters = inspect.signature(layer.forward if own else layer).parameters
        takes_batch = len(parameters) > 1
        with torch.no_grad():
            expected = layer(x.flatten(0, 1), *([batch] if takes_batch else []))
            try:
                is_pool = name.startswith("global")
                out = layer(x, None) if is_pool else layer(x)
            except (AssertionError, IndexError, RuntimeError, ValueError):
                found.add("raises")
                continue
        same = out.numel() == expected.numel()
        if same and torch.allclose(out.reshape(expected.shape), expected, atol=1e-5):
            found.add("works")
        else:
            found.add("wrong")
    return next(kind for kind in ("wrong", "raises", "works") if kind in found)


def page_rows():
    text = PAGE.read_text(encoding="utf-8")
    return dict(re.findall(r"^\| `([^`]+)` \| (works|raises|wrong) \| .*\|$", text, re.MULTILINE))


@pytest.mark.parametrize("name", MAKES)
def test_page_says_what_a_layer_does_with_stacked_samples(name):
    assert page_rows()[name] == verdict(name)


def test_page_lists_these_layers_only():
    assert sorted(page_rows()) == sorted(MAKES)
