import pytest
import torch

from torch_geometric_tactile.analysis import embed_nodes, node_matrix, segment_clustering

pytestmark = pytest.mark.slow

SEGMENT = torch.arange(24) // 8
FEATURES = torch.randn(5, 24, 4, generator=torch.Generator().manual_seed(0))
# Three segments far from each other.
APART = FEATURES + 20 * torch.eye(4)[SEGMENT]


def test_rows_join_frames_and_scale_channels():
    features = torch.tensor([[[1.0, 0.0], [3.0, 0.0]], [[1.0, 40.0], [3.0, 0.0]]])
    # Channel 0 is 1, 3, 1, 3; channel 1 is 0, 0, 40, 0 with mean 10 and deviation sqrt(300).
    low, high = -10 / 300**0.5, 30 / 300**0.5
    expected = torch.tensor([[-1.0, low, -1.0, high], [1.0, low, 1.0, low]])
    torch.testing.assert_close(node_matrix(features), expected)
    torch.testing.assert_close(
        node_matrix(features, "mean"), torch.tensor([[-1.0, 1.0], [1.0, -1.0]])
    )


def test_rows_of_one_frame_and_constant_channel():
    rows = node_matrix(torch.tensor([[0.1, 5.0], [0.1, 7.0], [0.1, 6.0]]))
    assert rows[:, 0].tolist() == [0, 0, 0]
    assert rows[:, 1].mean() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("method", ["tsne", pytest.param("umap", marks=pytest.mark.full)])
@pytest.mark.parametrize("num_components", [2, 3])
def test_embedding_follows_its_seed(method, num_components):
    first = embed_nodes(APART, method, num_components, seed=1)
    assert first.shape == (24, num_components)
    assert first.isfinite().all()
    assert first.equal(embed_nodes(APART, method, num_components, seed=1))


@pytest.mark.full
def test_umap_changes_with_its_seed():
    assert not embed_nodes(APART, "umap", seed=1).equal(embed_nodes(APART, "umap", seed=2))


@pytest.mark.parametrize("method", ["tsne", pytest.param("umap", marks=pytest.mark.full)])
def test_embedding_keeps_segments_together(method):
    places = embed_nodes(APART, method, num_neighbors=5)
    assert segment_clustering(places, SEGMENT, num_neighbors=3).neighbor_share > 0.95


def test_embedding_ignores_the_unit():
    assert embed_nodes(APART).equal(embed_nodes(APART * 1024))


def test_clustering_tells_clusters_from_none():
    apart = segment_clustering(APART, SEGMENT, num_neighbors=7)
    none = segment_clustering(FEATURES, SEGMENT, num_neighbors=7)
    assert apart.silhouette > 0.5
    assert apart.neighbor_share == 1.0
    assert abs(none.silhouette) < 0.1
    assert none.neighbor_share == pytest.approx(none.chance_share, abs=0.15)
    assert apart.chance_share == pytest.approx(7 / 23)
    assert apart.by_segment.mean() == pytest.approx(apart.silhouette, abs=1e-5)


def test_no_node_is_its_own_neighbour():
    features = torch.tensor([[0.0], [1.0], [10.0], [11.0]])
    found = segment_clustering(features, torch.tensor([0, 1, 0, 1]), num_neighbors=1)
    assert found.neighbor_share == 0
    assert found.silhouette < 0


def test_clustering_knows_which_segment():
    mixed = APART.clone()
    mixed[:, 16:20], mixed[:, 8:12] = APART[:, 8:12], APART[:, 16:20]
    found = segment_clustering(mixed, SEGMENT)
    assert found.by_segment[0] > 0.5 > found.by_segment[1:].max()
    gap = segment_clustering(APART, SEGMENT + 1).by_segment
    assert gap[0].isnan()


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="'method' must be 'tsne' or 'umap'"):
        embed_nodes(APART, "pca")
    with pytest.raises(ValueError, match=r"'num_components' must be 2 or 3 \(got 1\)"):
        embed_nodes(APART, num_components=1)
    with pytest.raises(ValueError, match=r"'num_neighbors' must be at least 2 \(got 1\)"):
        embed_nodes(APART, num_neighbors=1)
    with pytest.raises(ValueError, match=r"at least 8 nodes \(got 7\)"):
        embed_nodes(APART[:, :7])
    with pytest.raises(ValueError, match=r"'features' must have shape .*got \(0, 24, 4\)"):
        embed_nodes(APART[:0])
    with pytest.raises(ValueError, match="'features' must hold finite"):
        node_matrix(torch.full((4, 2), float("nan")))
    with pytest.raises(ValueError, match="'frames' must be 'joined' or 'mean'"):
        node_matrix(APART, "sum")
    with pytest.raises(ValueError, match=r"'segment' must hold 24 numbers .*got shape \(23,\)"):
        segment_clustering(APART, SEGMENT[1:])
    with pytest.raises(ValueError, match=r"between 2 and 23 segments \(got 1\)"):
        segment_clustering(APART, SEGMENT * 0)
    with pytest.raises(ValueError, match=r"'num_neighbors' must be between 1 and 23 \(got 24\)"):
        segment_clustering(APART, SEGMENT, num_neighbors=24)


@pytest.mark.full
def test_umap_leaves_the_threads_of_torch_alone():
    pytest.importorskip("umap", reason="needs the extra 'viz'")
    before = torch.get_num_threads()
    torch.set_num_threads(before + 5)
    try:
        embed_nodes(APART, "umap")
        assert torch.get_num_threads() == before + 5
    finally:
        torch.set_num_threads(before)
