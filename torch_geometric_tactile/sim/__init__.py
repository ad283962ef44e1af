r"""Simulators that generate recordings of grasps, squeezes and presses."""

from torch_geometric_tactile.sim.bigs_physics import BIGS_PHASES, BigsPhysics, BigsSimulator
from torch_geometric_tactile.sim.bigs_plan import BigsGrasp, draw_grasp
from torch_geometric_tactile.sim.bigs_slip import slip_onset
from torch_geometric_tactile.sim.biotac_grasp import SimulatedGrasps, simulate_grasps
from torch_geometric_tactile.sim.biotac_model import BioTacModel
from torch_geometric_tactile.sim.biotac_vibration import vibration
from torch_geometric_tactile.sim.drawn_objects import SHAPES, drawn_objects
from torch_geometric_tactile.sim.grasp import (
    PHASES,
    GraspPlan,
    GraspResult,
    GraspSimulator,
    plan_grasp,
)
from torch_geometric_tactile.sim.hand_model import ContactParameters, grasp_mjcf, stock_bodies
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes
from torch_geometric_tactile.sim.letter_press import LetterPress, LetterPresses
from torch_geometric_tactile.sim.object_sets import OBJECT_SETS, object_set
from torch_geometric_tactile.sim.objects import PROPERTIES, GraspObject, control8, paper8, twenty
from torch_geometric_tactile.sim.simulate import (
    HANDS,
    MOTIONS,
    PRESETS,
    Preset,
    TrialReport,
    grasp_recordings,
    simulate,
)
from torch_geometric_tactile.sim.simulate_bigs import BIGS_GRASPS, BigsReport, simulate_bigs
from torch_geometric_tactile.sim.simulate_letters import (
    LETTER_PRESSES,
    LetterReport,
    num_letter_files,
    simulate_letters,
)
from torch_geometric_tactile.sim.skin import SkinModel
from torch_geometric_tactile.sim.spread import SPREADS, GraspSpread
from torch_geometric_tactile.sim.squeeze import SQUEEZE_PHASES, SqueezePlan, plan_squeeze

__all__ = [
    "BIGS_GRASPS",
    "BIGS_PHASES",
    "HANDS",
    "LETTERS",
    "LETTER_PRESSES",
    "MOTIONS",
    "OBJECT_SETS",
    "PHASES",
    "PRESETS",
    "PROPERTIES",
    "SHAPES",
    "SPREADS",
    "SQUEEZE_PHASES",
    "BigsGrasp",
    "BigsPhysics",
    "BigsReport",
    "BigsSimulator",
    "BioTacModel",
    "ContactParameters",
    "GraspObject",
    "GraspPlan",
    "GraspResult",
    "GraspSimulator",
    "GraspSpread",
    "LetterPress",
    "LetterPresses",
    "LetterReport",
    "Preset",
    "SimulatedGrasps",
    "SkinModel",
    "SqueezePlan",
    "TrialReport",
    "control8",
    "draw_grasp",
    "drawn_objects",
    "grasp_mjcf",
    "grasp_recordings",
    "letter_strokes",
    "num_letter_files",
    "object_set",
    "paper8",
    "plan_grasp",
    "plan_squeeze",
    "simulate",
    "simulate_bigs",
    "simulate_grasps",
    "simulate_letters",
    "slip_onset",
    "stock_bodies",
    "twenty",
    "vibration",
]
