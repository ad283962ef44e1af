import pytest
import torch
from torch.utils.data import IterDataPipe
from torch_geometric.data import Data
from torch_geometric.data.datapipes import DatasetAdapter

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin, grid

LAYOUT = allegro_uskin()
GRID = grid(16, 24, 0.004)
NAMES = {
    "absolute_morphology": ("AbsoluteMorphology", ()),
    "calibrate": ("Calibrate", (torch.ones(4, 2),)),
    "common_mode": ("CommonMode", ()),
    "contact_crop": ("ContactCrop", (1, 5.0, 5.0)),
    "drop_patches": ("DropPatches", (LAYOUT,)),
    "drop_taxels": ("DropTaxels", ()),
    "select_channels": ("SelectChannels", ([0],)),
    "fill_missing": ("FillMissing", ()),
    "geometric_edge_attr": ("GeometricEdgeAttr", ()),
    "normalize_rms": ("NormalizeRMS", ()),
    "normalize_range": ("Normalize", ()),
    "resample": ("Resample", (7,)),
    "sector_graph": ("SectorGraph", (LAYOUT,)),
    "random_contrast": ("RandomContrast", ()),
    "random_inversion": ("RandomInversion", ()),
    "random_gain": ("RandomGain", (0.5, "digit", LAYOUT)),
    "random_mirror": ("RandomMirror", (GRID,)),
    "random_noise": ("RandomNoise", ()),
    "random_offset": ("RandomOffset", ()),
    "random_shift": ("RandomShift", (GRID,)),
    "random_time_shift": ("RandomTimeShift", ()),
    "session_z_score": ("SessionZScore", ()),
    "square_root": ("SquareRoot", ()),
    "tare": ("Tare", ()),
    "taxel_descriptors": ("TaxelDescriptors", (LAYOUT,)),
    "taxel_force": ("TaxelForce", ()),
    "taxel_knn_graph": ("KNNGraph", (2,)),
    "taxel_pose": ("TaxelPose", (LAYOUT, HandKinematics.allegro())),
    "topological_segmentation": ("TopologicalSegmentation", ("digit", LAYOUT)),
    "z_score": ("ZScore", ()),
}
FITTED = ("normalize_range", "session_z_score", "tare", "z_score")


def sample():
    return Data(
        x=torch.ones(384, 3),
        pos=LAYOUT.pos,
        normal=LAYOUT.normal,
        tangent=LAYOUT.tangent,
        edge_index=LAYOUT.edge_index("sparse"),
        joint=torch.zeros(1, 16),
    )


def window():
    frames = torch.zeros(384, 5, 3)
    frames[:, 2:] = 100.0
    return Data(x=join_frames(frames), num_frames=5)


def test_functional_names_are_complete():
    classes = {name for name in transforms.__all__ if name[0].isupper()}
    classes -= {"FittedTransform", "TactileTransform"}
    assert {name for name, _ in NAMES.values()} == classes
    for functional, (name, _) in NAMES.items():
        assert f":obj:`{functional}`" in " ".join(getattr(transforms, name).__doc__.split())
        assert getattr(transforms, name).supports_static


@pytest.mark.parametrize("functional", sorted(set(NAMES) - set(FITTED)))
def test_functional_names_call_the_transform(functional):
    name, arguments = NAMES[functional]
    data = window() if name in ("ContactCrop", "Resample") else sample()
    torch.manual_seed(0)
    (found,) = getattr(DatasetAdapter([data]), functional)(*arguments)
    torch.manual_seed(0)
    expected = getattr(transforms, name)(*arguments)(data)
    assert found.keys() == expected.keys()
    for key in found.keys():  # noqa: SIM118
        torch.testing.assert_close(found[key], expected[key], rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("functional", FITTED)
def test_functional_names_of_what_must_be_fitted(functional):
    with pytest.raises(RuntimeError, match=f"{NAMES[functional][0]} must be fitted"):
        list(getattr(DatasetAdapter([sample()]), functional)())


def test_functional_names_leave_pyg_alone():
    assert IterDataPipe.functions["knn_graph"] is not IterDataPipe.functions["taxel_knn_graph"]
