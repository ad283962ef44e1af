r"""Studies of the features of single layers."""

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

_BATCH_SIZE = 256


def _layer_features(model: Any, x: Tensor, names: list[str] | None = None) -> dict[str, Tensor]:
    r"""Returns the features of each layer of a network, with one row per sample.

    Args:
        model (torch.nn.Module): A network with a method :obj:`features`.
        x (torch.Tensor): Readings :math:`(S, N, F)`.
        names (list of str, optional): Names of the layers. Defaults to all layers.

    Shapes:
        - **output:** :math:`(S, D)` for each layer
    """
    batches: dict[str, list[Tensor]] = {}
    with torch.inference_mode():
        for batch in x.split(_BATCH_SIZE):
            for name, features in model.features(batch).items():
                if names is None or name in names:
                    batches.setdefault(name, []).append(features.flatten(1))
    return {name: torch.cat(parts) for name, parts in batches.items()}


class LayerProbes(Study):
    r"""Classifies samples based on the frozen features of single layers, as in Table 3 of the "A
    Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape
    Recognition" paper (Sensors 2020, 20, 5822).

    The paper does not describe its probes. The probes in this study are multinomial logistic
    regressions on the features of a layer. The features of each sample are divided by their L2
    norm. The probes are fitted on samples from the training part and scored on the test part.

    Args:
        num_samples (int): Maximum number of samples for the fit, drawn from the training part.
        strength (float): Inverse of the regularisation strength (:obj:`C` in scikit-learn).
        max_iter (int): Maximum number of iterations.
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
        fit_index = torch.from_numpy(np.sort(order[: self.num_samples]))
        fit_features = _layer_features(trained.model, trained.train.x[fit_index])
        test_features = _layer_features(trained.model, trained.test.x)
        y, y_test = trained.train.y[fit_index].numpy(), trained.test.y.numpy()
        accuracy = {}
        for name, rows in fit_features.items():
            probe = LogisticRegression(C=self.strength, max_iter=self.max_iter)
            with warnings.catch_warnings():
                # The number of iterations is limited on purpose.
                warnings.simplefilter("ignore", ConvergenceWarning)
                probe.fit(F.normalize(rows).numpy(), y)
            accuracy[name] = float(probe.score(F.normalize(test_features[name]).numpy(), y_test))
        return {"accuracy": accuracy, "num_samples": len(fit_index)}


class FeatureEmbedding(Study):
    r"""Embeds samples of the test part in two dimensions with t-SNE, as in figure 8 of the "A Novel
    Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape
    Recognition" paper (Sensors 2020, 20, 5822). The inputs are the features of one layer of a
    network, or the output of an estimator's :obj:`transform`, such as a histogram of visual words.

    Args:
        layer (str): Name of the layer.
        num_classes (int): Number of classes, which are drawn at random.
        per_class (int): Maximum number of samples per class.
        seed (int): Seed for drawing classes and samples, and for t-SNE.
    """

    def __init__(
        self, layer: str = "F-C1", num_classes: int = 5, per_class: int = 40, seed: int = 0
    ) -> None:
        self.layer = layer
        self.num_classes = num_classes
        self.per_class = per_class
        self.seed = seed

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns the coordinates of the samples (:obj:`place`), their class names
        (:obj:`label`), and the name of the features.
        """
        index = self._draw_samples(trained.test.y.numpy())
        features = self._features(trained, trained.test.index_select(torch.from_numpy(index)))
        if features is None or len(index) < 3:
            return None
        # The number of samples must exceed three times the perplexity of t-SNE.
        perplexity = min(30.0, (len(index) - 1) / 3)
        reducer = TSNE(2, perplexity=perplexity, init="pca", random_state=self.seed)
        points = reducer.fit_transform(np.ascontiguousarray(features, dtype=np.float32))
        labels = [trained.class_names[i] for i in trained.test.y[index].tolist()]
        feature_name = self.layer if trained.is_network else "histogram of visual words"
        return {"place": np.round(points, 3).tolist(), "label": labels, "what": feature_name}

    def _draw_samples(self, y: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        classes = np.sort(rng.permutation(np.unique(y))[: self.num_classes])
        class_samples = [
            rng.permutation(np.flatnonzero(y == label))[: self.per_class] for label in classes
        ]
        return np.sort(np.concatenate(class_samples))

    def _features(self, trained: Trained, samples: StaticData) -> np.ndarray | None:
        model = trained.model
        if hasattr(model, "features"):
            features = _layer_features(model, samples.x, [self.layer])
            return features[self.layer].numpy() if self.layer in features else None
        if not trained.is_network and hasattr(model, "transform"):
            return np.asarray(model.transform(estimator_input(model, samples)))
        return None


class FeatureMaps(Study):
    r"""Records the feature maps with the largest activations for one sample from the test part, as
    in figure 7 of the "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural Network
    for Tactile Shape Recognition" paper (Sensors 2020, 20, 5822). Also records the bilinear feature
    of each map.

    Args:
        class_name (str): Name of a class. The first sample of this class in the test part is used.
        layer (str): Name of the layer.
        num_maps (int): Number of maps.
    """

    def __init__(self, class_name: str = "Y", layer: str = "C1", num_maps: int = 9) -> None:
        self.class_name = class_name
        self.layer = layer
        self.num_maps = num_maps

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns :obj:`image`, :obj:`maps` and, if the model has bilinear features,
        :obj:`bilinear`.
        """
        if not hasattr(trained.model, "features") or self.class_name not in trained.class_names:
            return None
        label = list(trained.class_names).index(self.class_name)
        index = (trained.test.y == label).nonzero().view(-1)
        if len(index) == 0:
            return None
        x = trained.test.x[index[:1]]
        with torch.inference_mode():
            layers = {name: features[0] for name, features in trained.model.features(x).items()}
            image = trained.model.image(x)[0, 0]
        if self.layer not in layers:
            return None
        largest = layers[self.layer].flatten(1).amax(dim=1).argsort(descending=True)
        largest = largest[: self.num_maps]
        result = {
            "image": _to_scaled_list(image),
            "maps": _to_scaled_list(layers[self.layer][largest]),
        }
        bilinear = layers.get(f"bilinear({self.layer})")
        return (
            result
            if bilinear is None
            else {**result, "bilinear": _to_scaled_list(bilinear[largest])}
        )


def _to_scaled_list(values: Tensor) -> list[Any]:
    scale = float(values.abs().amax().clamp(min=1e-12))
    # Three decimals are enough for a picture and keep the file of a run small.
    return np.round((values / scale).double().numpy(), 3).tolist()
