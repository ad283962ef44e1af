r"""Simulators that generate recordings of grasps, squeezes and presses, and a simulated gripper to
control.
"""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.sim.biotac_model import BioTacModel
from torch_geometric_tactile.sim.biotac_vibration import vibration
from torch_geometric_tactile.sim.drawn_objects import SHAPES, drawn_objects
from torch_geometric_tactile.sim.gripper_lift import (
    GripperLift,
    LiftLimits,
    LiftObservation,
    LiftOutcome,
)
from torch_geometric_tactile.sim.hand_model import ContactParameters, grasp_mjcf
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes
from torch_geometric_tactile.sim.letter_press import LetterPress, LetterPresses
from torch_geometric_tactile.sim.lift_inputs import LIFT_INPUTS, lift_inputs
from torch_geometric_tactile.sim.lift_need import needed_squeeze
from torch_geometric_tactile.sim.lift_object import LiftObject, draw_lift_object
from torch_geometric_tactile.sim.lift_policies import (
    constant_squeeze,
    lift_expert,
    lift_observations,
    record_lift,
)
from torch_geometric_tactile.sim.objects import PROPERTIES, GraspObject, control8, paper8, twenty
from torch_geometric_tactile.sim.pad_sensor import PadDevice, PadSensor
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
    "LIFT_INPUTS",
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
    "GripperLift",
    "LetterPress",
    "LetterPresses",
    "LetterReport",
    "LiftLimits",
    "LiftObject",
    "LiftObservation",
    "LiftOutcome",
    "PadDevice",
    "PadSensor",
    "Preset",
    "SkinModel",
    "TrialReport",
    "constant_squeeze",
    "control8",
    "draw_lift_object",
    "drawn_objects",
    "grasp_mjcf",
    "letter_strokes",
    "lift_expert",
    "lift_inputs",
    "lift_observations",
    "needed_squeeze",
    "paper8",
    "record_lift",
    "simulate",
    "simulate_bigs",
    "simulate_letters",
    "twenty",
    "vibration",
]

__getattr__ = removed_names(__name__)
