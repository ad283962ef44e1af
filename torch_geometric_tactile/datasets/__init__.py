r"""Published data sets, generated data sets, and data sets of your own recordings."""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.datasets.allegro_uskin import AllegroUSkin
from torch_geometric_tactile.datasets.bigs import BiGS
from torch_geometric_tactile.datasets.biotac_slide import BioTacSlide
from torch_geometric_tactile.datasets.biotac_sp import BioTacSP
from torch_geometric_tactile.datasets.biotac_sp_dos import BioTacSPDoS
from torch_geometric_tactile.datasets.braille_letters import BrailleLetters
from torch_geometric_tactile.datasets.digit_images import DigitImages
from torch_geometric_tactile.datasets.eflesh_slip import EFleshSlip
from torch_geometric_tactile.datasets.fake import FakeTactileDataset
from torch_geometric_tactile.datasets.icub_grasp import ICubGrasp
from torch_geometric_tactile.datasets.letter_shape import LetterShape, letter_augmentation
from torch_geometric_tactile.datasets.pressure_mat import PressureMat
from torch_geometric_tactile.datasets.recording_frames import RecordingFrames
from torch_geometric_tactile.datasets.samples_file import SamplesFile
from torch_geometric_tactile.datasets.sparsh_skin import SparshSkin
from torch_geometric_tactile.datasets.tactile_glove import TactileGlove
from torch_geometric_tactile.datasets.uskin_pick import USkinPick

__all__ = [
    "AllegroUSkin",
    "BiGS",
    "BioTacSP",
    "BioTacSPDoS",
    "BioTacSlide",
    "BrailleLetters",
    "DigitImages",
    "EFleshSlip",
    "FakeTactileDataset",
    "ICubGrasp",
    "LetterShape",
    "PressureMat",
    "RecordingFrames",
    "SamplesFile",
    "SparshSkin",
    "TactileGlove",
    "USkinPick",
    "letter_augmentation",
]

__getattr__ = removed_names(__name__)
