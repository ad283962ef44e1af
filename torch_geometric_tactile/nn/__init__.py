r"""Layers and models."""

from torch_geometric_tactile.nn import conv, models

__all__ = ["conv", "models"]
