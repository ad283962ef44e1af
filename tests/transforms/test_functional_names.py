import pytest
from torch.utils.data import IterDataPipe
from torch_geometric.data import Data
from torch_geometric.data.datapipes import DatasetAdapter

from torch_geometric_tactile import transforms

NAMES = {
    "absolute_morphology": "AbsoluteMorphology",
    "calibrate": "Calibrate",
    "common_mode": "CommonMode",
    "contact_crop": "ContactCrop",
    "drop_patches": "DropPatches",
    "drop_taxels": "DropTaxels",
    "select_channels": "SelectChannels",
    "fill_missing": "FillMissing",
    "geometric_edge_attr": "GeometricEdgeAttr",
    "normalize_rms": "NormalizeRMS",
    "normalize_range": "Normalize",
    "resample": "Resample",
    "sector_graph": "SectorGraph",
    "random_contrast": "RandomContrast",
    "random_inversion": "RandomInversion",
    "random_gain": "RandomGain",
    "random_mirror": "RandomMirror",
    "random_noise": "RandomNoise",
    "random_offset": "RandomOffset",
    "random_shift": "RandomShift",
    "random_time_shift": "RandomTimeShift",
    "session_z_score": "SessionZScore",
    "square_root": "SquareRoot",
    "tare": "Tare",
    "taxel_descriptors": "TaxelDescriptors",
    "taxel_force": "TaxelForce",
    "taxel_knn_graph": "KNNGraph",
    "taxel_pose": "TaxelPose",
    "topological_segmentation": "TopologicalSegmentation",
    "z_score": "ZScore",
}


def test_functional_names_are_complete():
    classes = {name for name in transforms.__all__ if name[0].isupper()}
    assert {*NAMES.values()} == classes - {"FittedTransform", "TactileTransform"}
    for functional, name in NAMES.items():
        assert f":obj:`{functional}`" in " ".join(getattr(transforms, name).__doc__.split())
        assert getattr(transforms, name).supports_static


@pytest.mark.parametrize("functional", NAMES)
def test_functional_names_call_the_transform(functional, monkeypatch):
    """Arguments reach the class, and samples its call."""
    kind = getattr(transforms, NAMES[functional])
    monkeypatch.setattr(kind, "__init__", lambda self, *args: setattr(self, "arguments", args))
    monkeypatch.setattr(kind, "__call__", lambda self, data: (type(self), self.arguments, data.y))
    (out,) = getattr(DatasetAdapter([Data(y=3)]), functional)(1, "a")
    assert out == (kind, (1, "a"), 3)


def test_functional_names_leave_pyg_alone():
    assert IterDataPipe.functions["knn_graph"] is not IterDataPipe.functions["taxel_knn_graph"]
