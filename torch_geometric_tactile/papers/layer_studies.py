r"""What the layers of a network have learnt, and words that stand in for them."""

import warnings
from typing import Any

import numpy as np
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.manifold import TSNE
from torch import Tensor
from torch.nn import functional as F

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments._estimators import estimator_input
from torch_geometric_tactile.experiments.studies import Study, Trained

_BATCH = 256


def _layer_features(model: Any, x: Tensor, names: list[str] | None = None) -> dict[str, Tensor]:
    r"""Returns the features of a network layer by layer, those of each sample in a row.

    Args:
        model (torch.nn.Module): A network with a method :obj:`features`.
        x (torch.Tensor): Readings :math:`(S, N, F)`.
        names (list of str, optional): Only these layers.

    Shapes:
        - **output:** :math:`(S, D)` of each layer
    """
    found: dict[str, list[Tensor]] = {}
    with torch.inference_mode():
        for rows in x.split(_BATCH):
            for name, value in model.features(rows).items():
                if names is None or name in names:
                    found.setdefault(name, []).append(value.flatten(1))
    return {name: torch.cat(values) for name, values in found.items()}


class LayerProbes(Study):
    r"""Tells classes from the frozen features of single layers, as Table 3 of the "A Novel Bilinear
    Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper
    (Sensors 2020, 20, 5822).

    The paper does not say what its probes are. Ours are multinomial logistic regressions on the
    features of a layer, each sample divided by its L2 norm, fitted on samples of the training part
    and scored on the test part.

    Args:
        num_samples (int): Number of samples to fit on at most, drawn from the training part.
        strength (float): What the errors weigh against the squared weights: :obj:`C` of
            scikit-learn.
        max_iter (int): Number of steps at most.
    """

    def __init__(
        self, num_samples: int = 3000, strength: float = 100.0, max_iter: int = 200
    ) -> None:
        self.num_samples = num_samples
        self.strength = strength
        self.max_iter = max_iter

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns the accuracy of each layer."""
        if not hasattr(trained.model, "features"):
            return None
        order = np.random.default_rng(trained.seed).permutation(trained.train.num_samples)
        chosen = torch.from_numpy(np.sort(order[: self.num_samples]))
        seen = _layer_features(trained.model, trained.train.x[chosen])
        held = _layer_features(trained.model, trained.test.x)
        y, y_test = trained.train.y[chosen].numpy(), trained.test.y.numpy()
        accuracy = {}
        for name, rows in seen.items():
            probe = LogisticRegression(C=self.strength, max_iter=self.max_iter)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)  # the number of steps is given
                probe.fit(F.normalize(rows).numpy(), y)
            accuracy[name] = float(probe.score(F.normalize(held[name]).numpy(), y_test))
        return {"accuracy": accuracy, "num_samples": len(chosen)}


class FeatureEmbedding(Study):
    r"""Lays samples of the test part out by t-SNE of what a model makes of them, as figure 8 of the
    "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape
    Recognition" paper (Sensors 2020, 20, 5822): the features of a layer of a network, or what the
    method :obj:`transform` of an estimator returns, such as a histogram of visual words.

    Args:
        layer (str): The layer.
        num_classes (int): How many classes, drawn at random.
        per_class (int): Samples of each at most.
        seed (int): Decides the classes and samples, and is the seed of t-SNE.
    """

    def __init__(
        self, layer: str = "F-C1", num_classes: int = 5, per_class: int = 40, seed: int = 0
    ) -> None:
        self.layer = layer
        self.num_classes = num_classes
        self.per_class = per_class
        self.seed = seed

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns :obj:`place` (two numbers a sample), :obj:`label` and what is laid out."""
        rows = self._draw(trained.test.y.numpy())
        features = self._features(trained, trained.test.index_select(torch.from_numpy(rows)))
        if features is None or len(rows) < 3:
            return None
        perplexity = min(30.0, (len(rows) - 1) / 3)
        reducer = TSNE(2, perplexity=perplexity, init="pca", random_state=self.seed)
        place = reducer.fit_transform(np.ascontiguousarray(features, dtype=np.float32))
        label = [trained.class_names[i] for i in trained.test.y[rows].tolist()]
        what = self.layer if trained.is_network else "histogram of visual words"
        return {"place": np.round(place, 3).tolist(), "label": label, "what": what}

    def _draw(self, y: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        classes = np.sort(rng.permutation(np.unique(y))[: self.num_classes])
        chosen = [rng.permutation(np.flatnonzero(y == i))[: self.per_class] for i in classes]
        return np.sort(np.concatenate(chosen))

    def _features(self, trained: Trained, samples: StaticData) -> np.ndarray | None:
        model = trained.model
        if hasattr(model, "features"):
            found = _layer_features(model, samples.x, [self.layer])
            return found[self.layer].numpy() if self.layer in found else None
        if not trained.is_network and hasattr(model, "transform"):
            return np.asarray(model.transform(estimator_input(model, samples)))
        return None


class FeatureMaps(Study):
    r"""Keeps the feature maps with the largest activations of one sample of the test part, as
    figure 7 of the "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for
    Tactile Shape Recognition" paper (Sensors 2020, 20, 5822), and the bilinear feature of each.

    Args:
        class_name (str): Class of the sample, the first of the test part.
        layer (str): The layer.
        num_maps (int): How many maps.
    """

    def __init__(self, class_name: str = "Y", layer: str = "C1", num_maps: int = 9) -> None:
        self.class_name = class_name
        self.layer = layer
        self.num_maps = num_maps

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns the :obj:`image`, and :obj:`maps` and :obj:`bilinear` maps, rows of numbers."""
        if not hasattr(trained.model, "features") or self.class_name not in trained.class_names:
            return None
        label = list(trained.class_names).index(self.class_name)
        found = (trained.test.y == label).nonzero().view(-1)
        if len(found) == 0:
            return None
        x = trained.test.x[found[:1]]
        with torch.inference_mode():
            layers = {name: value[0] for name, value in trained.model.features(x).items()}
            image = trained.model.image(x)[0, 0]
        if self.layer not in layers:
            return None
        order = layers[self.layer].flatten(1).amax(dim=1).argsort(descending=True)
        order = order[: self.num_maps]
        result = {"image": _numbers(image), "maps": _numbers(layers[self.layer][order])}
        bilinear = layers.get(f"bilinear({self.layer})")
        return result if bilinear is None else {**result, "bilinear": _numbers(bilinear[order])}


def _numbers(values: Tensor) -> list[Any]:
    scale = float(values.abs().amax().clamp(min=1e-12))
    return np.round((values / scale).double().numpy(), 3).tolist()  # a thousandth of the largest
