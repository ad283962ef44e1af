r"""Transforms of tactile data, one per file."""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.transforms.absolute_morphology import AbsoluteMorphology
from torch_geometric_tactile.transforms.base import FittedTransform
from torch_geometric_tactile.transforms.calibrate import Calibrate
from torch_geometric_tactile.transforms.common_mode import CommonMode
from torch_geometric_tactile.transforms.contact_crop import ContactCrop
from torch_geometric_tactile.transforms.drop_patches import DropPatches
from torch_geometric_tactile.transforms.drop_taxels import DropTaxels
from torch_geometric_tactile.transforms.fill_missing import FillMissing
from torch_geometric_tactile.transforms.fitting import fit_parts, fit_transform
from torch_geometric_tactile.transforms.geometric_edge_attr import GeometricEdgeAttr
from torch_geometric_tactile.transforms.knn_graph import KNNGraph
from torch_geometric_tactile.transforms.normalize import Normalize
from torch_geometric_tactile.transforms.normalize_rms import NormalizeRMS
from torch_geometric_tactile.transforms.random_contrast import RandomContrast
from torch_geometric_tactile.transforms.random_gain import RandomGain
from torch_geometric_tactile.transforms.random_inversion import RandomInversion
from torch_geometric_tactile.transforms.random_mirror import RandomMirror
from torch_geometric_tactile.transforms.random_noise import RandomNoise
from torch_geometric_tactile.transforms.random_offset import RandomOffset
from torch_geometric_tactile.transforms.random_shift import RandomShift
from torch_geometric_tactile.transforms.random_time_shift import RandomTimeShift
from torch_geometric_tactile.transforms.resample import Resample
from torch_geometric_tactile.transforms.sector_graph import SectorGraph
from torch_geometric_tactile.transforms.select_channels import SelectChannels
from torch_geometric_tactile.transforms.session_z_score import SessionZScore
from torch_geometric_tactile.transforms.square_root import SquareRoot
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform
from torch_geometric_tactile.transforms.tare import Tare
from torch_geometric_tactile.transforms.taxel_descriptors import TaxelDescriptors
from torch_geometric_tactile.transforms.taxel_force import TaxelForce
from torch_geometric_tactile.transforms.taxel_pose import TaxelPose
from torch_geometric_tactile.transforms.topological_segmentation import TopologicalSegmentation
from torch_geometric_tactile.transforms.z_score import ZScore

__all__ = [
    "AbsoluteMorphology",
    "Calibrate",
    "CommonMode",
    "ContactCrop",
    "DropPatches",
    "DropTaxels",
    "FillMissing",
    "FittedTransform",
    "GeometricEdgeAttr",
    "KNNGraph",
    "Normalize",
    "NormalizeRMS",
    "RandomContrast",
    "RandomGain",
    "RandomInversion",
    "RandomMirror",
    "RandomNoise",
    "RandomOffset",
    "RandomShift",
    "RandomTimeShift",
    "Resample",
    "SectorGraph",
    "SelectChannels",
    "SessionZScore",
    "SquareRoot",
    "TactileTransform",
    "Tare",
    "TaxelDescriptors",
    "TaxelForce",
    "TaxelPose",
    "TopologicalSegmentation",
    "ZScore",
    "fit_parts",
    "fit_transform",
]

__getattr__ = removed_names(__name__)
