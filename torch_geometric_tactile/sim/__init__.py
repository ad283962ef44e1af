r"""Generators of recordings."""

from torch_geometric_tactile.sim.biotac_grasp import SimulatedGrasps, simulate_grasps
from torch_geometric_tactile.sim.grasp import (
    PHASES,
    GraspPlan,
    GraspResult,
    GraspSimulator,
    plan_grasp,
)
from torch_geometric_tactile.sim.hand_model import (
    ContactParameters,
    grasp_mjcf,
    stock_bodies,
)
from torch_geometric_tactile.sim.objects import (
    OBJECT_SETS,
    PROPERTIES,
    GraspObject,
    control8,
    paper8,
    twenty,
)
from torch_geometric_tactile.sim.simulate import HANDS, PRESETS, Preset, TrialReport, simulate
from torch_geometric_tactile.sim.skin import SkinModel

__all__ = [
    "HANDS",
    "OBJECT_SETS",
    "PHASES",
    "PRESETS",
    "PROPERTIES",
    "ContactParameters",
    "GraspObject",
    "GraspPlan",
    "GraspResult",
    "GraspSimulator",
    "Preset",
    "SimulatedGrasps",
    "SkinModel",
    "TrialReport",
    "control8",
    "grasp_mjcf",
    "paper8",
    "plan_grasp",
    "simulate",
    "simulate_grasps",
    "stock_bodies",
    "twenty",
]
