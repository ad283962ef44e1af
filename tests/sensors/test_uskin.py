import pytest
import torch

from torch_geometric_tactile.live import TaxelMap
from torch_geometric_tactile.sensors import as_layout, uspa44, uspa46

PATCHES = [
    (uspa44, 4, 4, (4.66666, -4.66666), (5.36666, 18.81664, 4.0), "XR1944"),
    (uspa46, 4, 6, (7.24, -7.17), (10.24, 26.505, 5.0), "XR1946"),
]


@pytest.mark.parametrize(("build", "rows", "columns", "step", "first", "model"), PATCHES)
def test_taxels_row_by_row_at_the_places_of_xelas_model(build, rows, columns, step, first, model):
    layout = build()
    expected = [
        (first[0] + column * step[0], first[1] + row * step[1], first[2])
        for row in range(rows)
        for column in range(columns)
    ]
    assert torch.allclose(layout.pos * 1e3, torch.tensor(expected), atol=1e-4)
    assert layout.normal.tolist() == [[0.0, 0.0, 1.0]] * len(layout)
    assert layout.tangent[0].tolist() == [[1, 0, 0], [0, 1, 0]]
    assert layout.image_map[columns].tolist() == [1, 0]
    assert "mcsix/xela_models" in layout.source
    assert model in layout.source
    assert as_layout(build.__name__).matches(layout)


@pytest.mark.parametrize(("build", "num_edges"), [(uspa44, (48, 36)), (uspa46, (76, 60))])
def test_edges_join_neighbours(build, num_edges):
    layout = build()
    for name, distance, number in zip(("original", "slanted"), (1, 2), num_edges, strict=True):
        source, target = layout.edge_index(name)
        step = (layout.image_map[source] - layout.image_map[target]).square().sum(dim=1)
        assert step.eq(distance).all()
        assert len(source) == number
    assert layout.edge_index("dense").size(1) == sum(num_edges)


@pytest.mark.parametrize("model", ["uSPa44", "USPA44", "XR1944", "XR1844"])
def test_sensor_of_4_by_4_has_a_map(model):
    taxel_map = TaxelMap.for_sensor([model], 16, uspa44())
    assert taxel_map.index.tolist() == list(range(16))


@pytest.mark.parametrize("model", ["uSPa46", "XR1946"])
def test_sensor_of_4_by_6_has_a_map(model):
    taxel_map = TaxelMap.for_sensor([model], 24, uspa46())
    assert taxel_map.index.tolist() == list(range(24))


def test_sensor_of_another_model_has_no_map():
    with pytest.raises(ValueError, match=r"the sensor \(USPA35\) sends 16 taxels"):
        TaxelMap.for_sensor(["uSPa35"], 16, uspa44())
