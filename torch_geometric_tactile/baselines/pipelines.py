r"""Functions that return scikit-learn pipelines for comparison with the networks."""

from typing import Any, Literal, Self, get_args

import numpy as np
from sklearn.compose import TransformedTargetRegressor
from sklearn.dummy import DummyClassifier, DummyRegressor
from sklearn.ensemble import (
    ExtraTreesClassifier,
    ExtraTreesRegressor,
    RandomForestClassifier,
    RandomForestRegressor,
)
from sklearn.linear_model import Ridge, RidgeClassifier
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, SVR, LinearSVC, LinearSVR

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._window_features import WindowFeatures
from torch_geometric_tactile.baselines.descriptor_features import DescriptorFeatures
from torch_geometric_tactile.baselines.flat_readings import FlatReadings
from torch_geometric_tactile.baselines.posed_summary import PosedSummary
from torch_geometric_tactile.sensors import TaxelLayout

_Task = Literal["multiclass", "regression"]
_ClassWeight = Literal["balanced"] | None
_TASKS = get_args(_Task)


def flat_forest(
    task: _Task = "multiclass",
    *,
    num_trees: int = 300,
    min_samples_leaf: int = 1,
    class_weight: _ClassWeight = None,
) -> Pipeline:
    r"""Returns a random forest on the flattened readings of all taxels.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): Minimum number of samples in a leaf.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Examples:
        >>> x = np.array([0.0, 1.0, 2.0, 3.0, 20.0, 21.0, 22.0, 23.0]).reshape(8, 1, 1)
        >>> y = [0, 0, 0, 0, 1, 1, 1, 1]
        >>> flat_forest(num_trees=10).fit(x, y).predict(x).tolist()
        [0, 0, 0, 0, 1, 1, 1, 1]
    """
    forest = _random_forest(task, num_trees, min_samples_leaf, class_weight)
    return make_pipeline(FlatReadings(), forest)


def descriptor_forest(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    num_trees: int = 300,
    min_samples_leaf: int = 1,
    balanced: bool = True,
    class_weight: _ClassWeight = None,
) -> Pipeline:
    r"""Returns extremely randomised trees (Geurts et al. 2006) on the features from
    :class:`DescriptorFeatures` and on the readings. Each split considers a tenth of the features
    for classification, and a third for regression.

    Args:
        layout (TaxelLayout or str or PathLike): The layout.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): Minimum number of samples in a leaf.
        balanced (bool): If :obj:`True`, a split considers descriptors as often as readings.
            Otherwise, readings are considered more often on large layouts, since they are more
            numerous.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> forest = descriptor_forest(grid(1, 2, pitch=0.01), num_trees=10).fit(x, [0, 0, 1, 1])
        >>> forest.predict(x).shape
        (4,)
    """
    forest: Any = ExtraTreesRegressor(max_features=1 / 3)
    if _is_classification(task):
        # The usual square root of the number of features is too small, since most features of a
        # large layout are not informative. With 64 of 2,074 features, training took half as long,
        # but the score on simulated letters was 8 points lower.
        forest = ExtraTreesClassifier(max_features=0.1, class_weight=class_weight)
    forest.set_params(n_estimators=num_trees, min_samples_leaf=min_samples_leaf)
    features = DescriptorFeatures(layout, with_readings=True, balanced=balanced)
    return make_pipeline(features, forest)


def descriptor_svm(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    C: float = 10.0,  # noqa: N803 - scikit-learn's name
    width: float = 1.0,
    with_readings: bool = False,
    class_weight: _ClassWeight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on the standardised features from
    :class:`DescriptorFeatures`. With few labels, :func:`descriptor_forest` is better on average.

    Args:
        layout (TaxelLayout or str or PathLike): The layout.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty for errors.
        width (float): Factor for the kernel coefficient, as in :func:`rbf_svm`.
        with_readings (bool): If :obj:`True`, the readings are also used as features.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.
        most_samples (int, optional): Maximum number of training samples, as in :func:`rbf_svm`.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> descriptor_svm(grid(1, 2, pitch=0.01)).fit(x, [0, 0, 1, 1]).predict(x)
        array([0, 0, 1, 1])
    """
    model = _kernel_machine(task, C, width, most_samples, class_weight)
    return make_pipeline(DescriptorFeatures(layout, with_readings), StandardScaler(), model)


def posed_forest(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    num_trees: int = 300,
    min_samples_leaf: int = 1,
    class_weight: _ClassWeight = None,
) -> Pipeline:
    r"""Returns a random forest on the features from :class:`PosedSummary`.

    Args:
        layout (TaxelLayout or str or PathLike): The layout.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): Minimum number of samples in a leaf.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> forest = posed_forest(grid(1, 2, pitch=0.01), num_trees=10).fit(x, [0, 0, 1, 1])
        >>> forest.predict(x).shape
        (4,)
    """
    forest = _random_forest(task, num_trees, min_samples_leaf, class_weight)
    return make_pipeline(PosedSummary(layout), forest)


def posed_ridge(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    alpha: float = 1.0,
    class_weight: _ClassWeight = None,
) -> Pipeline:
    r"""Returns a ridge classifier or a ridge regression on the standardised features from
    :class:`PosedSummary`.

    Args:
        layout (TaxelLayout or str or PathLike): The layout.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        alpha (float): Penalty for large weights.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> posed_ridge(grid(1, 2, pitch=0.01)).fit(x, [0, 0, 1, 1]).predict(x)
        array([0, 0, 1, 1])
    """
    classifier = RidgeClassifier(alpha=alpha, class_weight=class_weight)
    model = classifier if _is_classification(task) else Ridge(alpha=alpha)
    return make_pipeline(PosedSummary(layout), StandardScaler(), model)


def linear_svm(
    task: _Task = "multiclass",
    *,
    C: float = 1.0,  # noqa: N803 - scikit-learn's name
    class_weight: _ClassWeight = None,
) -> Pipeline:
    r"""Returns a linear support vector machine on the flattened readings of all taxels. Scale the
    readings first (see :class:`~torch_geometric_tactile.transforms.ZScore`). Regression targets are
    scaled by the pipeline. The primal problem is solved with the default tolerance of
    :program:`liblinear`, so that training converges even with more readings than samples.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty for errors.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Examples:
        >>> import numpy as np
        >>> x = np.array([-1.0, -2.0, 1.0, 2.0]).reshape(4, 1, 1)  # samples, taxels, channels
        >>> linear_svm().fit(x, [0, 0, 1, 1]).predict(x[3:])
        array([1])
    """
    if _is_classification(task):
        model: Any = LinearSVC(C=C, class_weight=class_weight, dual=False, tol=1e-2)
    else:
        loss = "squared_epsilon_insensitive"
        model = _with_scaled_targets(LinearSVR(C=C, loss=loss, dual=False, tol=1e-3))
    return make_pipeline(FlatReadings(), model)


def rbf_svm(
    task: _Task = "multiclass",
    *,
    C: float = 1.0,  # noqa: N803 - scikit-learn's name
    width: float = 1.0,
    class_weight: _ClassWeight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on the flattened readings of all
    taxels. Scale the readings first. Regression targets are scaled by the pipeline.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty for errors.
        width (float): Factor by which scikit-learn's kernel coefficient :obj:`gamma="scale"` is
            multiplied. This coefficient is :math:`1 / (K \, \mathrm{Var})` for :math:`K` features.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.
        most_samples (int, optional): Maximum number of training samples. If there are more, a
            random subset of this size is used, since the training time grows with the square of the
            number of samples.

    Examples:
        >>> import numpy as np
        >>> x = np.array([-1.0, -2.0, 1.0, 2.0]).reshape(4, 1, 1)  # samples, taxels, channels
        >>> rbf_svm().fit(x, [0, 0, 1, 1]).predict(x[3:])
        array([1])
    """
    model = _kernel_machine(task, C, width, most_samples, class_weight)
    return make_pipeline(FlatReadings(), model)


def signal_svm(
    task: _Task = "multiclass",
    *,
    num_channels: int = 1,
    C: float = 1.0,  # noqa: N803 - scikit-learn's name
    class_weight: _ClassWeight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on the 12 statistical features of each
    signal in windows of frames, as in :class:`~torch_geometric_tactile.baselines.GraspSVM`.
    Regression is also supported. Regression targets are scaled by the pipeline.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_channels (int): Number of channels per taxel. Their frames are concatenated.
        C (float): Penalty for errors.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.
        most_samples (int, optional): Maximum number of training samples, as in :func:`rbf_svm`.

    Examples:
        >>> import numpy as np
        >>> x = np.random.default_rng(0).normal(size=(8, 4, 20))  # windows of 20 frames of 4 taxels
        >>> x[4:] *= 10.0
        >>> signal_svm().fit(x, [0] * 4 + [1] * 4).predict(x)
        array([0, 0, 0, 0, 1, 1, 1, 1])
    """
    model = _kernel_machine(task, C, 1.0, most_samples, class_weight)
    return make_pipeline(WindowFeatures(num_channels), StandardScaler(), model)


def constant(task: _Task = "multiclass") -> Pipeline:
    r"""Returns the trivial baseline, which predicts the most frequent class or the mean target.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.

    Examples:
        >>> import numpy as np
        >>> constant().fit(np.zeros((3, 4, 1)), [1, 1, 0]).predict(np.zeros((1, 4, 1)))
        array([1])
    """
    model = (
        DummyClassifier(strategy="most_frequent") if _is_classification(task) else DummyRegressor()
    )
    return make_pipeline(FlatReadings(), model)


def _is_classification(task: str) -> bool:
    need(task in _TASKS, f"'task' must be one of {list(_TASKS)} (got '{task}')")
    return task == "multiclass"


def _random_forest(
    task: _Task, num_trees: int, min_samples_leaf: int, class_weight: _ClassWeight
) -> Any:
    size = {"n_estimators": num_trees, "min_samples_leaf": min_samples_leaf}
    if _is_classification(task):
        return RandomForestClassifier(**size, class_weight=class_weight)
    return RandomForestRegressor(**size, max_features=1 / 3)


def _with_scaled_targets(model: Any) -> TransformedTargetRegressor:
    return TransformedTargetRegressor(_MultiOutputRegressor(model), transformer=StandardScaler())


class _MultiOutputRegressor(MultiOutputRegressor):
    # TransformedTargetRegressor passes a single target as (S,), which scikit-learn's class rejects.
    def fit(self, x: np.ndarray, y: np.ndarray) -> Self:
        super().fit(x, np.asarray(y).reshape(len(y), -1))
        return self


def _kernel_machine(
    task: str,
    C: float,  # noqa: N803
    width: float,
    max_samples: int | None,
    class_weight: _ClassWeight,
) -> Any:
    if _is_classification(task):
        return _SubsampledSVC(C, width, max_samples, class_weight)
    return _with_scaled_targets(_SubsampledSVR(C, width, max_samples))


class _SubsampledFit:
    # Fits a support vector machine on at most `max_samples` random samples. The kernel width is
    # computed from all samples.
    width: float
    max_samples: int | None
    random_state: Any

    def fit(self, x: np.ndarray, y: np.ndarray) -> Self:
        variance = float(x.var())
        self.gamma = self.width / (x.shape[1] * variance) if variance > 0 else self.width
        y = np.asarray(y)
        if self.max_samples is not None and len(x) > self.max_samples:
            generator = np.random.default_rng(self.random_state or 0)
            indices = generator.permutation(len(x))[: self.max_samples]
            x, y = x[indices], y[indices]
        super().fit(x, y)  # type: ignore[misc]
        return self


class _SubsampledSVC(_SubsampledFit, SVC):
    def __init__(
        self,
        C: float = 1.0,  # noqa: N803
        width: float = 1.0,
        max_samples: int | None = None,
        class_weight: _ClassWeight = None,
        random_state: Any = None,
    ) -> None:
        super().__init__(C=C, class_weight=class_weight, random_state=random_state)
        self.width = width
        self.max_samples = max_samples


class _SubsampledSVR(_SubsampledFit, SVR):
    def __init__(
        self,
        C: float = 1.0,  # noqa: N803
        width: float = 1.0,
        max_samples: int | None = None,
        random_state: Any = None,
    ) -> None:
        super().__init__(C=C)
        self.width = width
        self.max_samples = max_samples
        self.random_state = random_state
