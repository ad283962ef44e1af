import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from small_models import assert_close, gradients, loop, samples
from torch.nn import functional as F

from torch_geometric_tactile.nn import BMFCNN
from torch_geometric_tactile.nn.models.bmf_cnn import _FUSIONS
from torch_geometric_tactile.sensors import TaxelLayout, grid

GRID = grid(20, 22, pitch=0.01)
EDGES = GRID.edge_index("original")
FUSED = {  # of 32 x 32 pixels
    "C3": 1024,
    "bilinear(C1)+C3": 12_544 + 1024,
    "C1+C3": 12_544 + 1024,
    "bilinear(C2)+C3": 32 * 12 * 12 + 1024,
    "C2+C3": 32 * 12 * 12 + 1024,
}


def small(layout=GRID, **more):
    torch.manual_seed(0)
    return BMFCNN(layout, 3, **{"in_channels": 2, "hidden_channels": 5, **more})


def blurred_images(num_images, size=(32, 32)):
    draw = np.random.default_rng(0)
    return torch.from_numpy(
        np.stack(
            [
                gaussian_filter(draw.random(size) > 0.9, 1.5, output=np.float32)
                for _ in range(num_images)
            ]
        )
    ).unsqueeze(1)


def test_repr():
    assert str(BMFCNN()) == (
        "BMFCNN(1024, 26, in_channels=1, fusion='bilinear(C1)+C3', size=(32, 32))"
    )
    assert str(small(fusion="C3")) == "BMFCNN(440, 3, in_channels=2, fusion='C3', size=(20, 22))"


def test_all_fusions_of_the_paper_are_there():
    assert set(_FUSIONS) == set(FUSED)


@pytest.mark.parametrize("fusion", _FUSIONS)
def test_sizes_of_the_paper(fusion):
    model = BMFCNN(fusion=fusion)
    found = {
        name: tuple(value.shape[1:])
        for name, value in model.features(torch.zeros(2, 1, 32, 32)).items()
    }
    assert found == {
        "C1": (16, 28, 28),
        "bilinear(C1)": (16, 28, 28),
        "C2": (32, 12, 12),
        "bilinear(C2)": (32, 12, 12),
        "C3": (64, 4, 4),
        "F-C1": (120,),
    }
    assert model.fc1.in_features == FUSED[fusion]
    convolutions = 25 * 16 + 2 * 16 + (9 * 16 * 32 + 32) + (9 * 32 * 64 + 64)
    head = FUSED[fusion] * 120 + 120 + 120 * 26 + 26
    assert sum(weight.numel() for weight in model.parameters()) == convolutions + head


def of_the_formulas(model, image):
    """The features and logits of one image, written out."""
    x = F.conv2d(image[None], model.conv1.weight)
    scale, shift, mean, var = (
        value.view(1, -1, 1, 1)
        for value in (
            model.norm1.weight,
            model.norm1.bias,
            model.norm1.running_mean,
            model.norm1.running_var,
        )
    )
    maps = {"C1": ((x - mean) / (var + 1e-5).sqrt() * scale + shift).clamp(min=0)}
    for before, name, conv in (("C1", "C2", model.conv2), ("C2", "C3", model.conv3)):
        maps[name] = F.conv2d(F.max_pool2d(maps[before], 2), conv.weight, conv.bias).clamp(min=0)
    for name in ("C1", "C2"):
        parts = []
        for f in maps[name][0]:
            phi = sum(torch.outer(row, row) for row in f) / len(f) + 1e-5 * torch.eye(f.size(1))
            root = torch.sign(phi) * torch.sqrt(phi.abs() + 1e-8)
            parts.append(root / root.square().sum().sqrt())
        maps[f"bilinear({name})"] = torch.stack(parts)[None]
    parts = [maps[name].flatten() for name in model.fusion.split("+")]
    if len(parts) == 2:
        parts = [part / part.square().sum().sqrt() for part in parts]
    maps["F-C1"] = (model.fc1.weight @ torch.cat(parts) + model.fc1.bias).clamp(min=0)[None]
    return maps, model.fc2.weight @ maps["F-C1"][0] + model.fc2.bias


@pytest.mark.parametrize("fusion", _FUSIONS)
def test_values_are_those_of_the_formulas(fusion):
    model = small(fusion=fusion).double()
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(0.1 * samples(*weight.shape, dtype=torch.double))
        images = samples(4, 2, 20, 22, dtype=torch.double)
        model(images)  # the batch normalisation has seen some
        model.eval()
        features, logits = model.features(images), model(images)
        for i, image in enumerate(images):
            expected, expected_logits = of_the_formulas(model, image)
            assert features.keys() == expected.keys()
            for name, value in expected.items():
                assert torch.allclose(features[name][i : i + 1], value), name
            assert torch.allclose(logits[i], expected_logits)


def test_traditional_cnn_is_the_fusion_of_c3_alone():
    models = [small(bilinear=False), small(fusion="C3"), small(fusion="C3", bilinear=False)]
    x = samples(3, 440, 2)
    first, *others = models
    for other in others:
        assert str(other) == str(first)
        assert torch.equal(other(x), first(x))
    assert BMFCNN(bilinear=False).fc1.in_features == 1024
    # It is not divided by its norm.
    x = 1e3 * first.eval().features(x)["C3"].flatten(1)
    hidden = (x @ first.fc1.weight.T).relu()
    assert hidden.max() > 100


@pytest.mark.parametrize("fusion", _FUSIONS)
def test_images_are_readings(fusion):
    model, x = small(fusion=fusion).eval(), samples(3, 440, 2)
    images = x.view(3, 20, 22, 2).permute(0, 3, 1, 2)
    assert torch.allclose(model(images), model(x), atol=1e-6)
    assert torch.allclose(model(images.contiguous()), model(x), atol=1e-6)
    assert model(images[:0]).shape == (0, 3)


def test_readings_of_the_size_of_an_image_are_readings():
    cells = torch.arange(20).view(-1, 1).repeat(1, 2)
    cells[-1, 1] = 20  # twenty taxels with 21 channels, on 20 x 21 cells
    layout = TaxelLayout("diagonal", torch.rand(20, 3), image_map=cells)
    model, x = small(layout, in_channels=21).eval(), samples(3, 20, 21)
    images = torch.zeros(3, 21, 20, 21)
    images[..., cells[:, 0], cells[:, 1]] = x.transpose(1, 2)
    assert torch.allclose(model(x), model(images), atol=1e-6)


def test_training_is_the_same_in_all_forms():
    model = small().double()
    given = {"x": samples(4, 440, 2, dtype=torch.double), "edge_index": EDGES}
    expected = gradients(model, given)

    def as_images(leaves):
        return {"x": leaves["x"].transpose(1, 2).unflatten(2, (20, 22))}

    def as_batch(leaves):
        return {"x": leaves["x"].flatten(0, 1)}

    for forms in (as_images, as_batch):
        assert_close(gradients(model, given, forms), expected)
    model.eval()
    assert_close(gradients(model, given, loop_of), gradients(model, given))


def loop_of(leaves):
    return loop({"x": leaves["x"], "edge_index": leaves["edge_index"]})


def test_taxels_are_where_the_map_has_them():
    order = torch.randperm(440, generator=torch.Generator().manual_seed(0))
    turned = TaxelLayout("turned", GRID.pos[order], image_map=GRID.image_map[order])
    x = samples(3, 440, 2)
    assert torch.allclose(small(turned).eval()(x[:, order]), small().eval()(x), atol=1e-6)


def test_cells_without_a_taxel_are_zero():
    kept = torch.arange(440) % 7 != 3
    kept[-1] = True
    thinned = TaxelLayout("thinned", GRID.pos[kept], image_map=GRID.image_map[kept])
    x = samples(3, 440, 2) * kept.view(-1, 1)
    assert torch.allclose(small(thinned).eval()(x[:, kept]), small().eval()(x), atol=1e-6)


def test_full_maps_are_not_copied():
    model, x = BMFCNN(), samples(3, 1024, 1)
    assert model.image(x).data_ptr() == x.data_ptr()
    assert model.image(x).shape == (3, 1, 32, 32)


def test_weights_are_drawn_as_xavier_does():
    model = BMFCNN()
    for layer, ins, outs in (
        (model.conv1, 25, 25 * 16),
        (model.conv2, 9 * 16, 9 * 32),
        (model.conv3, 9 * 32, 9 * 64),
        (model.fc1, 13_568, 120),
        (model.fc2, 120, 26),
    ):
        bound = (6 / (ins + outs)) ** 0.5
        assert 0.97 * bound < layer.weight.abs().max() <= bound
        assert layer.bias is None or not layer.bias.any()


@pytest.mark.parametrize("bilinear", [True, False])
def test_training_as_the_paper_does_stays_finite(bilinear):
    images, y = blurred_images(100), torch.arange(100) % 26
    images[:2] = 0.0
    torch.manual_seed(0)
    model = BMFCNN(bilinear=bilinear)
    optimizer = torch.optim.Adam(model.parameters(), 0.001)
    losses = []
    for step in range(12):
        batch = torch.arange(50) + 50 * (step % 2)
        optimizer.zero_grad()
        loss = F.cross_entropy(model(images[batch]), y[batch])
        loss.backward()
        assert all(bool(weight.grad.isfinite().all()) for weight in model.parameters())
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]


@pytest.mark.full
def test_exports_images_of_any_batch():
    model, given = small().eval(), {"x": samples(3, 2, 20, 22)}
    shapes = {"x": {0: torch.export.Dim("batch")}}
    exported = torch.export.export(model, (), given, dynamic_shapes=shapes).module()
    x = samples(20, 2, 20, 22)
    with torch.no_grad():
        assert torch.allclose(exported(x=x), model(x), atol=1e-5)


def test_bmf_cnn_state_has_no_cells():
    assert "image.cell" not in BMFCNN(bilinear=False).state_dict()


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (
            lambda: BMFCNN(grid(19, 32, 0.01)),
            r"at least 20 x 20 cells \(got 19 x 32 in 'grid_19x32",
        ),
        (
            lambda: BMFCNN(grid(32, 19, 0.01)),
            r"at least 20 x 20 cells \(got 32 x 19 in 'grid_32x19",
        ),
        (lambda: BMFCNN(fusion="C1"), r"'fusion' must be one of \('C3', .* \(got 'C1'\)"),
        (
            lambda: BMFCNN(fusion="C1+C3", bilinear=False),
            r"'fusion' must be 'C3' if 'bilinear' is False \(got 'C1\+C3'\)",
        ),
        (
            lambda: BMFCNN()(torch.zeros(2, 1, 28, 28)),
            r"\(batch_size, 1, 32, 32\) for images \(got \(2, 1, 28, 28\)\)",
        ),
        (lambda: BMFCNN()(torch.zeros(2, 3, 32, 32)), r"got \(2, 3, 32, 32\)"),
        (lambda: BMFCNN().features(torch.zeros(2, 3, 32, 32)), r"\(batch_size, 1, 32, 32\) for"),
        (
            lambda: BMFCNN()(torch.zeros(2, 32, 32)),
            r"1, 32, 32\) for images \(got \(2, 32, 32",
        ),
        (lambda: BMFCNN()(torch.zeros(32, 32)), r"1, 32, 32\) for images \(got \(32, 32"),
        (lambda: BMFCNN()(torch.zeros(2, 1024, 2)), r"'x' must have 1 channels"),
        (lambda: BMFCNN()(torch.zeros(1024)), r"got shape \(1024,\)"),
    ],
)
def test_bad_input_is_refused(make, match):
    with pytest.raises(ValueError, match=match):
        make()
