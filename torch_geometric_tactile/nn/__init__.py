r"""Layers and models."""

from torch_geometric_tactile.nn import conv, models, pool

__all__ = ["conv", "models", "pool"]
