"""Descriptors as the features of estimators are those of the transform."""

import sys

import numpy as np
import pytest
import torch

from torch_geometric_tactile.baselines import DescriptorFeatures
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import grid, taxel_descriptors
from torch_geometric_tactile.transforms import TaxelDescriptors

PAD = grid(2, 3, pitch=0.01)
X = torch.randn(7, 6, 4, generator=torch.Generator().manual_seed(0))


def test_rows_are_the_descriptors_in_pieces_of_any_size(monkeypatch):
    expected = taxel_descriptors(X, PAD).numpy()
    module = sys.modules[DescriptorFeatures.__module__]
    for at_once in (1, 48, 1 << 18):
        monkeypatch.setattr(module, "_BLOCK_READINGS", at_once)
        found = DescriptorFeatures(PAD).fit_transform(X.numpy())
        np.testing.assert_allclose(found, expected, atol=1e-5)
    assert DescriptorFeatures(PAD).transform(X[:0].numpy()).shape == (0, expected.shape[1])


def test_readings_follow_with_missing_ones_as_zero():
    x = X.numpy().copy()
    x[0, 1, 2] = np.nan
    found = DescriptorFeatures(PAD, with_readings=True).transform(x)
    assert np.isfinite(found).all()
    assert np.array_equal(found[:, -24:], np.nan_to_num(x).reshape(7, 24))


def test_windows_and_posed_taxels_are_known_from_the_samples():
    windows = StaticData(x=X, num_frames=2)
    expected = TaxelDescriptors(PAD)(windows).descriptors.numpy()
    np.testing.assert_allclose(DescriptorFeatures(PAD).transform(windows), expected, atol=1e-5)
    pos = PAD.pos + 0.01 * torch.rand(7, 6, 3, generator=torch.Generator().manual_seed(1))
    posed = StaticData(x=X, pos=pos)
    expected = TaxelDescriptors(PAD, posed=True)(posed).descriptors.numpy()
    found = DescriptorFeatures(PAD).transform(posed)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert not np.allclose(found, DescriptorFeatures(PAD).transform(X.numpy()))


def test_other_taxels_are_refused():
    with pytest.raises(ValueError, match=r"a sample must have 6 taxels, .*grid_2x3.* \(got 5\)"):
        DescriptorFeatures(PAD).transform(np.zeros((2, 5, 1)))


def test_descriptors_of_large_layouts_are_repeated_for_a_forest():
    pad = grid(40, 20, pitch=0.01)
    x = np.random.default_rng(0).random((2, 800, 1))
    plain = DescriptorFeatures(pad).transform(x)
    found = DescriptorFeatures(pad, with_readings=True, balanced=True).transform(x)
    times = round(800 / plain.shape[1])
    assert times > 1
    assert np.array_equal(found[:, :-800], np.tile(plain, times))
