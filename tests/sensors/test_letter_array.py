import torch

from torch_geometric_tactile.sensors import grid, letter_array


def test_letter_array_is_a_grid_of_64_pixels_on_a_square_centimetre() -> None:
    layout = letter_array()
    assert layout.name == "letter_array"
    assert layout.matches(grid(32, 32, pitch=0.00125))
    assert torch.equal(layout.image_map, torch.cartesian_prod(torch.arange(32), torch.arange(32)))
    inside = (layout.pos[:, :2] < 0.01 - 1e-6).all(dim=1)
    assert int(inside.sum()) == 64


def test_letter_array_has_four_or_eight_neighbours() -> None:
    layout = letter_array()
    degree = {name: layout.edge_index(name)[0].bincount() for name in ("original", "dense")}
    inner = 5 * 32 + 5
    assert (int(degree["original"][inner]), int(degree["original"][0])) == (4, 2)
    assert (int(degree["dense"][inner]), int(degree["dense"][0])) == (8, 3)
