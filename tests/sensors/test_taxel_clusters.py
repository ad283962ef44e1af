import pytest
import torch

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
    layout_sectors,
)
from torch_geometric_tactile.sensors._taxel_clusters import taxel_clusters


def test_taxel_clusters_voxels_of_a_grid():
    found = taxel_clusters(grid(3, 5, pitch=0.002), 0.004)
    assert found.cluster.tolist() == [0, 0, 1, 1, 2, 0, 0, 1, 1, 2, 3, 3, 4, 4, 5]
    pos = 1e-3 * torch.tensor([[1, 1, 0], [5, 1, 0], [8, 1, 0], [1, 4, 0], [5, 4, 0], [8, 4, 0]])
    assert torch.allclose(found.layout.pos, pos.float(), atol=1e-8)
    assert torch.equal(found.layout.axes(), torch.eye(3).expand(6, 3, 3))
    assert found.layout.name == "grid_3x5_6"


def test_taxel_clusters_voxels_with_two_lengths():
    found = taxel_clusters(grid(2, 4, pitch=0.002), (0.008, 0.002))
    assert found.cluster.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


def test_taxel_clusters_voxels_turn_with_the_patch():
    turn, _ = torch.linalg.qr(
        torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double()
    )
    turn = (turn * turn.det()).float()
    flat = grid(5, 6, pitch=0.003)
    layout = TaxelLayout(
        "turned",
        flat.pos @ turn.t() + 0.2,
        flat.normal @ turn.t(),
        tangent=flat.axes()[:, :2] @ turn.t(),
    )
    found, expected = taxel_clusters(layout, 0.006), taxel_clusters(flat, 0.006)
    assert torch.equal(found.cluster, expected.cluster)
    assert torch.allclose(found.layout.pos, expected.layout.pos @ turn.t() + 0.2, atol=1e-6)
    assert torch.allclose(found.layout.axes(), expected.layout.axes() @ turn.t(), atol=1e-6)


def test_taxel_clusters_convolutions_go_on():
    coarse = taxel_clusters(grid(6, 8, pitch=0.002), 0.004).layout
    found, expected = layout_sectors(coarse), layout_sectors(grid(3, 4, pitch=0.004))
    assert torch.equal(found.edge_index, expected.edge_index)
    assert torch.equal(found.sector, expected.sector)


@pytest.mark.parametrize("by", ["patch", "digit"])
def test_taxel_clusters_segments(by):
    layout = allegro_uskin()
    found = taxel_clusters(layout, by)
    segment = layout.segments(by)
    for number in found.cluster.unique():
        (same,) = segment[found.cluster == number].unique().tolist()
        assert getattr(found.layout, by)[number] == same
    assert found.layout.num_taxels == len(segment.unique())
    assert found.layout.digit_names == layout.digit_names


def test_taxel_clusters_stay_within_patches():
    layout = allegro_uskin()
    found = taxel_clusters(layout, 0.01)
    assert torch.equal(found.layout.patch[found.cluster], layout.patch)
    assert torch.equal(found.layout.link[found.cluster], layout.link)
    mean = torch.stack([layout.pos[found.cluster == i].mean(0) for i in range(len(found.layout))])
    assert torch.allclose(found.layout.pos, mean, atol=1e-7)


def test_taxel_clusters_cover_every_taxel():
    for layout in (biotac_sp(), allegro_uskin(), grid(1, 1, 0.001)):
        for size in (1e-4, 0.005, 1.0):
            found = taxel_clusters(layout, size)
            assert found.cluster.unique().tolist() == list(range(found.layout.num_taxels))
            assert found.layout.num_taxels <= layout.num_taxels
    assert taxel_clusters(biotac_sp(), 1.0).layout.num_taxels == 1


def test_taxel_clusters_opposite_normals():
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    layout = TaxelLayout("ball", 1e-3 * normal, normal)
    coarse = taxel_clusters(layout, "patch").layout
    assert coarse.normal.tolist() == [[0.0, 0.0, 1.0]]  # of the first
    assert torch.allclose(coarse.axes() @ coarse.axes().transpose(1, 2), torch.eye(3), atol=1e-6)


@pytest.mark.parametrize(("axis", "expected"), [(0, [0, 0, 1, 1]), (1, [0, 0, 0, 0])])
def test_taxel_clusters_of_opposite_normals_lie_along_the_axes_of_the_link(axis, expected):
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]).repeat(2, 1)
    layout = TaxelLayout("row", 1e-3 * torch.arange(4.0)[:, None] * torch.eye(3)[axis], normal)
    assert taxel_clusters(layout, (0.002, 0.004)).cluster.tolist() == expected


@pytest.mark.parametrize("by", [0.0, -1.0, float("inf"), (0.1,), (0.1, 0.1, 0.1), (0.1, 0.0)])
def test_taxel_clusters_bad_length(by):
    with pytest.raises(ValueError, match=r"'by' must be one positive length in metres, or two"):
        taxel_clusters(biotac_sp(), by)


def test_taxel_clusters_bad_name():
    with pytest.raises(ValueError, match=r"'by' must be 'patch', 'digit' or lengths .*'link'"):
        taxel_clusters(biotac_sp(), "link")
