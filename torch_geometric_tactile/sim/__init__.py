r"""Generators of recordings."""

from torch_geometric_tactile.sim.biotac_grasp import SimulatedGrasps, simulate_grasps

__all__ = ["SimulatedGrasps", "simulate_grasps"]
