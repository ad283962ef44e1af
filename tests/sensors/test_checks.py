import pytest
import torch

from torch_geometric_tactile.sensors._checks import check_edges, check_segment


def test_edges_come_back_as_contiguous_integers():
    edges = check_edges(torch.tensor([[0, 1], [2, 0]], dtype=torch.int32).t(), 3)
    assert edges.dtype == torch.long
    assert edges.is_contiguous()
    assert edges.tolist() == [[0, 2], [1, 0]]
    assert check_edges(torch.empty(2, 0), 3).dtype == torch.long


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([0, 1], r"'edge_index' must have shape \(2, num_edges\) \(got \(2,\)\)"),
        (torch.zeros(7, 2), r"'edge_index' must have shape \(2, num_edges\) \(got \(7, 2\)\)"),
        ([[0.5], [1.0]], r"'edge_index' must hold whole numbers \(got torch.float32\)"),
        ([[True], [False]], r"'edge_index' must hold whole numbers \(got torch.bool\)"),
        ([[0], [3]], r"'edge_index' must join taxels 0 to 2 \(got 0 to 3\)"),
        ([[-1], [0]], r"'edge_index' must join taxels 0 to 2 \(got -1 to 0\)"),
    ],
)
def test_edges_rejects(edges, message):
    with pytest.raises(ValueError, match=message):
        check_edges(edges, 3)


def test_segment_by_hand():
    assert check_segment([1, 0, 1]).tolist() == [1, 0, 1]
    assert check_segment([7, -2], gaps=True).tolist() == [7, -2]


@pytest.mark.parametrize(
    ("segment", "options", "message"),
    [
        ([], {}, r"'segment' must be a whole number for each taxel \(got shape \(0,\)"),
        ([[0, 1]], {}, r"'segment' must be a whole number for each taxel \(got shape \(1, 2\)"),
        ([0.0, 1.0], {}, r"'segment' must be a whole number for each taxel .*float32\)"),
        ([True, False], {"what": "'by'"}, r"'by' must be a whole number .*bool\)"),
        ([0, 1], {"num_taxels": 3}, r"'segment' must have shape \(3,\) \(got \(2,\)\)"),
        ([0, 2], {}, r"'segment' must be numbered from 0 without gaps \(got \[0, 2\]\)"),
    ],
)
def test_segment_rejects(segment, options, message):
    with pytest.raises(ValueError, match=message):
        check_segment(segment, **options)
