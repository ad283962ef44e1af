import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import AbsoluteMorphology, TaxelPose


def random_poses(num_samples=3, num_taxels=5, dtype=torch.float):
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(num_samples, num_taxels, 2, generator=generator, dtype=dtype)
    pos = torch.randn(num_samples, num_taxels, 3, generator=generator, dtype=dtype)
    return StaticData(x=x, pos=pos)


def test_absolute_morphology_by_hand():
    data = Data(x=torch.tensor([[9.0]]), pos=torch.tensor([[1.0, 2.0, 5.0]]))
    out = AbsoluteMorphology(origin=(1.0, -2.0, 2.0))(data)
    assert out.absolute.tolist() == [[5, 0, 4, 3]]
    assert out.x.tolist() == [[9]]
    out = AbsoluteMorphology(origin=(1.0, -2.0, 2.0), cat=True)(data)
    assert out.x.tolist() == [[9, 5, 0, 4, 3]]
    assert "absolute" not in out


def test_absolute_morphology_turns_about_the_origin():
    data = random_poses(dtype=torch.double)
    origin = torch.tensor([0.3, -0.2, 0.1], dtype=torch.double)
    transform = AbsoluteMorphology(origin.tolist())
    before = transform(data).absolute
    generator = torch.Generator().manual_seed(0)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.double, generator=generator))
    data.pos = (data.pos - origin) @ turn.t() + origin
    after = transform(data).absolute
    assert after.dtype == torch.double
    assert torch.allclose(after[..., 0], before[..., 0], atol=1e-12)
    assert torch.allclose(after[..., 1:], before[..., 1:] @ turn.t(), atol=1e-12)
    shifted = random_poses(dtype=torch.double)
    shifted.pos = shifted.pos + 1
    moved = AbsoluteMorphology((origin + 1).tolist())(shifted).absolute
    assert torch.allclose(moved, before, atol=1e-12)
    assert not torch.allclose(transform(shifted).absolute, before)


def test_absolute_morphology_of_a_hand():
    data = TaxelPose(allegro_uskin(), HandKinematics.allegro())(Data(joint=torch.zeros(1, 16)))
    absolute = AbsoluteMorphology()(data).absolute
    assert absolute.shape == (384, 4)
    assert torch.allclose(absolute[:, 0], data.pos.norm(dim=1))
    assert torch.equal(absolute[:, 1:], data.pos)


def test_absolute_morphology_type_of_the_readings():
    data = Data(x=torch.ones(1, 1), pos=torch.ones(1, 3, dtype=torch.double))
    assert AbsoluteMorphology(cat=True)(data).x.dtype == torch.float
    data.x = torch.ones(1, 1, dtype=torch.long)  # raw counts
    assert AbsoluteMorphology(cat=True)(data).x.is_floating_point()


def test_absolute_morphology_bad_input():
    with pytest.raises(ValueError, match=r"'pos' must have shape .* \(got \(3, 2\)\)"):
        AbsoluteMorphology()(Data(pos=torch.zeros(3, 2)))
    for wrong in ((0.0, 0.0), (0.0, 0.0, float("nan"))):
        with pytest.raises(ValueError, match="'origin' must be three finite numbers"):
            AbsoluteMorphology(wrong)
