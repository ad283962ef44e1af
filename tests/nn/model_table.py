"""Small models of all classes, of the hand's inputs and of readings, and their inputs."""

import plain_models
import small_models
import torch
from torch import Tensor, nn

EDGES = torch.tensor([[0, 1], [1, 0]])
READING_MODELS = plain_models.MODELS
MODELS = [*small_models.MODELS, *READING_MODELS]
GRAPH_MODELS = [*small_models.GRAPH_MODELS, *(n for n in READING_MODELS if n.startswith("gcn_"))]


def make_model(name: str, dtype: torch.dtype = torch.float) -> nn.Module:
    """A model; one of readings in evaluation mode, after some steps."""
    if name in small_models.MODELS:
        return small_models.small_model(name, dtype)
    return plain_models.trained(READING_MODELS[name]()).to(dtype)


def model_inputs(
    model: nn.Module, batch_size: int, dtype: torch.dtype = torch.float, shared: bool = False
) -> dict[str, Tensor]:
    """The inputs by their names; with edge features of all samples if shared."""
    if hasattr(model, "inputs") or type(model).__name__ == "MSCNN":
        return small_models.inputs(model, batch_size, dtype, shared)
    # Edges are an input of all models, whether they need them or not.
    data = {"edge_index": EDGES, **plain_models.given(model, batch_size)}
    return {key: v if key == "edge_index" else v.to(dtype) for key, v in data.items()}
