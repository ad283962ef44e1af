"""Forces in the frame of the hand. The handedness of readings is tested here and, against the
weight of simulated objects, in tests/sim/test_grasp.py."""

import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import TaxelForce, TaxelPose

LAYOUT, HAND = allegro_uskin(), HandKinematics.allegro()


def recording(num_samples=3):
    draw = torch.Generator().manual_seed(0)
    return StaticData(
        x=torch.randn(num_samples, 384, 3, generator=draw),
        joint=0.5 * torch.rand(num_samples, 16, generator=draw),
    )


def posed(out="x"):
    return Compose([TaxelPose(LAYOUT, HAND, tangent=True), TaxelForce(out)])


def test_handedness_by_hand():
    """Pressure goes into the skin: against the normal, which is x times y."""
    tangent = torch.tensor([[[1.0, 0, 0], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]]])
    normal = torch.tensor([[0.0, 0, 1], [1, 0, 0]])
    assert torch.linalg.cross(tangent[:, 0], tangent[:, 1]).equal(normal)
    x = torch.tensor([[2.0, 3.0, 5.0], [2.0, 3.0, 5.0]])
    found = TaxelForce()(Data(x=x, tangent=tangent, normal=normal)).x
    assert found.tolist() == [[2, 3, -5], [-5, 2, 3]]


def test_pressure_on_the_palm_points_into_it():
    x = torch.zeros(1, 384, 3)
    x[..., 2] = 1.0
    data = StaticData(x=x, joint=torch.zeros(1, 16))
    force = posed("force")(data).force[0]
    palm = LAYOUT.digit == LAYOUT.digit_names.index("palm")
    expected = torch.tensor([-1.0, 0.0, 0.0]).expand(112, 3)
    torch.testing.assert_close(force[palm], expected, atol=1e-6, rtol=0)
    assert data.x.equal(x)


def test_lengths_are_kept():
    data = recording()
    found = posed()(recording()).x
    torch.testing.assert_close(found.norm(dim=-1), data.x.norm(dim=-1), atol=1e-5, rtol=1e-5)


def test_axes_that_all_samples_share():
    data = StaticData(x=recording().x, tangent=LAYOUT.tangent, normal=LAYOUT.normal)
    found = TaxelForce()(data).x
    axes = LAYOUT.axes() * torch.tensor([1.0, 1.0, -1.0])[:, None]
    expected = torch.einsum("sna,naj->snj", recording().x, axes)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


def test_own_attribute_and_missing_readings():
    data = recording()
    data.x[0, 7, 1] = torch.nan
    assert posed()(data).x[0].isnan().all(dim=1).nonzero().view(-1).tolist() == [7]
    pushed = posed("push")(recording())
    assert pushed.push.shape == (3, 384, 3)
    assert pushed.level("push") == "node"
    assert pushed.x.equal(recording().x)


def test_gradients_reach_the_angles():
    data = recording(1).sample(0)
    data.joint = data.joint.requires_grad_()
    posed()(data).x.sum().backward()
    assert float(data.joint.grad.abs().sum()) > 0


def test_bad_samples_are_named():
    axes = {"tangent": LAYOUT.tangent, "normal": LAYOUT.normal}
    with pytest.raises(ValueError, match=r"needs 'tangent' \(got none\): put TaxelPose\(tangent=T"):
        TaxelForce()(Data(x=torch.zeros(384, 3)))
    with pytest.raises(ValueError, match=r"'x' must have 3 channels, .* \(got 1\)"):
        TaxelForce()(Data(x=torch.zeros(384, 1), **axes))
    with pytest.raises(ValueError, match=r"'tangent' must have shape \(24, 2, 3\).*\(got \(384, 2"):
        TaxelForce()(Data(x=torch.zeros(24, 3), **axes))
    axes["normal"] = torch.zeros(1, 3)
    with pytest.raises(ValueError, match=r"'normal' must have shape \(384, 3\).*\(got \(1, 3\)\)"):
        TaxelForce()(Data(x=torch.zeros(384, 3), **axes))
