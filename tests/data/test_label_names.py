import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.data._label_names import label_numbers, number_labels
from torch_geometric_tactile.sensors import grid


@pytest.mark.parametrize(
    ("labels", "names", "codes"),
    [
        (["slip", "slip ", "Slip", "hold"], ["hold", "slip"], [1, 1, 1, 0]),
        ([" Slip ", "slip"], ["Slip"], [0, 0]),  # as first written
        (["TRUE", "True", "false"], ["TRUE", "false"], [0, 0, 1]),
        ([True, False, "TRUE"], ["False", "True"], [1, 0, 1]),
        ([0, 0.0, 1.0, 1], ["0", "1"], [0, 0, 1, 1]),
        (["0.0", "0", "1.0"], ["0", "1"], [0, 0, 1]),
        ([1, "1", "1.50", 1.5], ["1", "1.50"], [0, 0, 1, 1]),
        ([10, 9, "b", "B2"], ["9", "10", "B2", "b"], [1, 0, 3, 2]),
        (["10", "9"], ["10", "9"], [0, 1]),  # texts alone are sorted as texts
        (["007", "7", "1_0", "10", "nan", "1e1"], ["007", "10", "1_0", "1e1", "7", "nan"], None),
        (["a", "A", "a "], ["A", "a"], [1, 0, 1]),  # two letters
        (["a 1", "a  1"], ["a  1", "a 1"], [1, 0]),
        ([np.str_("x"), np.int64(3), np.float32(3.0)], ["3", "x"], [1, 0, 0]),
        ([2**60, 2**60 + 1], [str(2**60), str(2**60 + 1)], [0, 1]),
        ([], [], []),
    ],
)
def test_spellings_of_one_class(labels, names, codes):
    found = number_labels(labels)
    assert found[0] == names
    if codes is not None:
        assert found[1].tolist() == codes


def test_joined_texts_and_letters_are_told(caplog):
    number_labels(["slip", "Slip ", 1, "1"])
    assert caplog.messages == [
        "labels that differ only in case and blanks are one class: 'slip' and 'Slip '"
    ]
    caplog.clear()
    number_labels(["a", "A", "b"])
    assert "different classes: 'a' and 'A'; use one spelling" in caplog.text
    caplog.clear()
    number_labels(["slip", "hold", 0, 0.0, "a", "B"])
    assert caplog.messages == []


def test_names_that_are_given_are_found_in_any_spelling():
    layout, x = grid(1, 2, pitch=0.01), torch.zeros(3, 2, 1)
    y = ["Slip", "hold ", "slip"]
    data = StaticDataset.from_arrays(x, y, layout=layout, class_names=["slip", "hold"])
    assert (data.y.tolist(), data.class_names) == ([0, 1, 0], ["slip", "hold"])
    with pytest.raises(ValueError, match=r"must name every 'y' .* without \['push'\]"):
        StaticDataset.from_arrays(x, ["push", *y[:2]], layout=layout, class_names=["slip", "hold"])
    assert label_numbers(["a", "A"], ["A", "a"]) == [1, 0]
