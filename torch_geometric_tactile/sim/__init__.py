r"""Simulators that generate recordings of grasps, squeezes and presses."""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.sim.biotac_model import BioTacModel
from torch_geometric_tactile.sim.biotac_vibration import vibration
from torch_geometric_tactile.sim.drawn_objects import SHAPES, drawn_objects
from torch_geometric_tactile.sim.hand_model import ContactParameters, grasp_mjcf
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes
from torch_geometric_tactile.sim.letter_press import LetterPress, LetterPresses
from torch_geometric_tactile.sim.objects import PROPERTIES, GraspObject, control8, paper8, twenty
from torch_geometric_tactile.sim.simulate import (
    HANDS,
    MOTIONS,
    PRESETS,
    Preset,
    TrialReport,
    simulate,
)
from torch_geometric_tactile.sim.simulate_bigs import BigsReport, simulate_bigs
from torch_geometric_tactile.sim.simulate_letters import LetterReport, simulate_letters
from torch_geometric_tactile.sim.skin import SkinModel
from torch_geometric_tactile.sim.spread import SPREADS, GraspSpread

__all__ = [
    "HANDS",
    "LETTERS",
    "MOTIONS",
    "PRESETS",
    "PROPERTIES",
    "SHAPES",
    "SPREADS",
    "BigsReport",
    "BioTacModel",
    "ContactParameters",
    "GraspObject",
    "GraspSpread",
    "LetterPress",
    "LetterPresses",
    "LetterReport",
    "Preset",
    "SkinModel",
    "TrialReport",
    "control8",
    "drawn_objects",
    "grasp_mjcf",
    "letter_strokes",
    "paper8",
    "simulate",
    "simulate_bigs",
    "simulate_letters",
    "twenty",
    "vibration",
]

__getattr__ = removed_names(__name__)
