"""Images that are views of readings."""

import copy
import pickle

import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._image_data import ImageData, StaticImages, image_of
from torch_geometric_tactile.sensors import letter_array

LAYOUT = letter_array()


def images(count=3, channels=1):
    x = torch.arange(float(count * 1024 * channels)).view(count, 1024, channels)
    return StaticImages(x=x, edge_index=LAYOUT.edge_index("original"), y=torch.arange(count))


def test_image_by_hand():
    data = images(2, channels=2)
    assert data.image.shape == (2, 2, 32, 32)
    for taxel in (0, 1, 33, 1023):
        row, column = LAYOUT.image_map[taxel].tolist()
        assert data.image[1, :, row, column].equal(data.x[1, taxel])


@pytest.mark.parametrize("count", [0, 1, 3])
def test_all_forms_have_the_same_image(count):
    data = images(count)
    expected = data.x.view(count, 1, 32, 32)
    assert data.image.equal(expected)
    assert data.to_batch().image.equal(expected)
    if count:
        assert torch.cat([sample.image for sample in data.to_data_list()]).equal(expected)
        joined = Batch.from_data_list(data.to_data_list())
        assert joined.image.equal(expected)
        assert type(joined) is type(data.to_batch())
        assert all(type(sample) is ImageData for sample in joined.to_data_list())


def test_image_is_no_copy_and_no_attribute():
    data = images()
    assert data.image.data_ptr() == data.x.data_ptr()
    assert data[1].image.data_ptr() == data.x[1].data_ptr()
    assert "image" not in data.to_dict()
    data.x = data.x + 1
    assert float(data.image[0, 0, 0, 0]) == 1


def test_copies_selections_and_pickles_are_of_the_same_class():
    data = images()
    for other in (data[1:], data[[2, 1]], data.clone(), copy.copy(data), data.to("cpu")):
        assert type(other) is StaticImages
    sample = pickle.loads(pickle.dumps(data[1]))
    assert sample.image.equal(data.image[1:2])
    halved = apply_transform(lambda sample: ImageData(x=sample.x / 2), data)
    assert halved.image.equal(data.image / 2)


def test_plain_data_stay_plain():
    data = StaticData(x=torch.zeros(2, 1024, 1))
    assert type(data[0]) is Data
    assert type(data.to_batch()) is type(Batch.from_data_list(data.to_data_list()))
    assert not hasattr(data, "image")


@pytest.mark.parametrize("shape", [(2, 1023, 1), (1023, 1), (1024,), (2, 2048, 1), (1, 2, 1024, 1)])
def test_other_sizes(shape):
    with pytest.raises(ValueError, match="'x' must have 1024 taxels in each sample"):
        image_of(torch.zeros(shape))
