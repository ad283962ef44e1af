import pytest
from torch_geometric.resolver import resolver

from torch_geometric_tactile import nn

PACKAGES = (nn.conv, nn.pool, nn.models)


def test_all_classes_are_at_the_top():
    names = [name for package in PACKAGES for name in package.__all__]
    assert sorted(nn.__all__) == sorted(names)
    assert len(set(names)) == len(names)
    for package in PACKAGES:
        for name in package.__all__:
            assert getattr(nn, name) is getattr(package, name)


@pytest.mark.parametrize("name", nn.__all__)
def test_classes_are_documented(name):
    cls = getattr(nn, name)
    assert cls.__name__ == name
    assert cls.__module__.startswith("torch_geometric_tactile.nn.")
    assert "Args:" in cls.__doc__


@pytest.mark.parametrize("query", ["GraspGCN", "grasp_gcn", "graspgcn"])
def test_resolver_finds_models(query):
    classes = [getattr(nn, name) for name in nn.__all__]
    model = resolver(classes, {}, query, None, None, 19, out_channels=4)
    assert isinstance(model, nn.GraspGCN)
    assert (model.num_nodes, model.out_channels) == (19, 4)
    assert resolver(classes, {}, nn.GraspGCN(), None, None) is not None
