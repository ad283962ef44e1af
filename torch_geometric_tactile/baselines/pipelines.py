r"""Plain models to compare with, as scikit-learn pipelines that one call makes."""

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
_Weight = Literal["balanced"] | None
_TASKS = get_args(_Task)


def flat_forest(
    task: _Task = "multiclass",
    *,
    num_trees: int = 300,
    min_samples_leaf: int = 1,
    class_weight: _Weight = None,
) -> Pipeline:
    r"""Returns a random forest on all readings side by side.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): The fewest samples of a leaf.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.

    Examples:
        >>> x = np.array([0.0, 1.0, 2.0, 3.0, 20.0, 21.0, 22.0, 23.0]).reshape(8, 1, 1)
        >>> y = [0, 0, 0, 0, 1, 1, 1, 1]
        >>> flat_forest(num_trees=10).fit(x, y).predict(x).tolist()
        [0, 0, 0, 0, 1, 1, 1, 1]
    """
    forest = _forest(task, num_trees, min_samples_leaf, class_weight)
    return make_pipeline(FlatReadings(), forest)


def descriptor_forest(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    num_trees: int = 300,
    min_samples_leaf: int = 1,
    balanced: bool = True,
    class_weight: _Weight = None,
) -> Pipeline:
    r"""Returns extremely randomised trees (Geurts et al. 2006) on the features of
    :class:`DescriptorFeatures` and on the readings, of which they take what helps. A split of
    classes looks at a tenth of the features, and one of numbers at a third.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): The fewest samples of a leaf.
        balanced (bool): Whether a split looks at descriptors as often as at readings, of which a
            large layout has more.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> forest = descriptor_forest(grid(1, 2, pitch=0.01), num_trees=10).fit(x, [0, 0, 1, 1])
        >>> forest.predict(x).shape
        (4,)
    """
    forest: Any = ExtraTreesRegressor(max_features=1 / 3)
    if _is_classes(task):
        # A tenth of the features, where their root is usual: of a large layout most are of no use.
        # 64 of 2,074 features took half the time, and lost 8 points on simulated letters.
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
    class_weight: _Weight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on the features of
    :class:`DescriptorFeatures`, which are scaled here. With few labels,
    :func:`descriptor_forest` is better on average.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty of an error.
        width (float): As of :func:`rbf_svm`.
        with_readings (bool): Whether it is given the readings as well.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.
        most_samples (int, optional): As of :func:`rbf_svm`.

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
    class_weight: _Weight = None,
) -> Pipeline:
    r"""Returns a random forest on the features of :class:`PosedSummary`.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_trees (int): Number of trees.
        min_samples_leaf (int): The fewest samples of a leaf.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> forest = posed_forest(grid(1, 2, pitch=0.01), num_trees=10).fit(x, [0, 0, 1, 1])
        >>> forest.predict(x).shape
        (4,)
    """
    forest = _forest(task, num_trees, min_samples_leaf, class_weight)
    return make_pipeline(PosedSummary(layout), forest)


def posed_ridge(
    layout: TaxelLayout | PathLike,
    task: _Task = "multiclass",
    *,
    alpha: float = 1.0,
    class_weight: _Weight = None,
) -> Pipeline:
    r"""Returns a ridge classifier or regression on the features of :class:`PosedSummary`.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels.
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        alpha (float): Penalty of large weights.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 0.0], [6.0, 0.0]])[:, :, None]
        >>> posed_ridge(grid(1, 2, pitch=0.01)).fit(x, [0, 0, 1, 1]).predict(x)
        array([0, 0, 1, 1])
    """
    model = RidgeClassifier(alpha=alpha, class_weight=class_weight)
    last = model if _is_classes(task) else Ridge(alpha=alpha)
    return make_pipeline(PosedSummary(layout), StandardScaler(), last)


def linear_svm(
    task: _Task = "multiclass",
    *,
    C: float = 1.0,  # noqa: N803 - scikit-learn's name
    class_weight: _Weight = None,
) -> Pipeline:
    r"""Returns a linear support vector machine on all readings side by side, which should be scaled
    before (see :class:`~torch_geometric_tactile.transforms.ZScore`); regression targets are scaled
    here. It is solved in the primal, which converges also where there are more readings than
    samples, with :program:`liblinear`'s own tolerance.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty of an error.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.

    Examples:
        >>> import numpy as np
        >>> x = np.array([-1.0, -2.0, 1.0, 2.0]).reshape(4, 1, 1)  # samples, taxels, channels
        >>> linear_svm().fit(x, [0, 0, 1, 1]).predict(x[3:])
        array([1])
    """
    if _is_classes(task):
        model: Any = LinearSVC(C=C, class_weight=class_weight, dual=False, tol=1e-2)
    else:
        loss = "squared_epsilon_insensitive"
        model = _scaled(LinearSVR(C=C, loss=loss, dual=False, tol=1e-3))
    return make_pipeline(FlatReadings(), model)


def rbf_svm(
    task: _Task = "multiclass",
    *,
    C: float = 1.0,  # noqa: N803 - scikit-learn's name
    width: float = 1.0,
    class_weight: _Weight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on all readings side by side, which
    should be scaled before; regression targets are scaled here.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        C (float): Penalty of an error.
        width (float): What scikit-learn's :obj:`gamma="scale"`, one over the number and the
            variance of the readings, is multiplied by.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.
        most_samples (int, optional): Fit on a random part of so many samples if there are more,
            since the time grows with the square of their number.

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
    class_weight: _Weight = None,
    most_samples: int | None = None,
) -> Pipeline:
    r"""Returns a support vector machine with a radial kernel on the 12 statistical features of each
    signal in windows of frames, as :class:`~torch_geometric_tactile.baselines.GraspSVM`. It also
    predicts numbers, which are scaled here.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_channels (int): Number of channels of a taxel, whose frames stand side by side.
        C (float): Penalty of an error.
        class_weight (str, optional): :obj:`"balanced"` to make rare classes count as much.
        most_samples (int, optional): As of :func:`rbf_svm`.

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
    r"""Returns the baseline that every model must beat: the most frequent class, or the mean.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.

    Examples:
        >>> import numpy as np
        >>> constant().fit(np.zeros((3, 4, 1)), [1, 1, 0]).predict(np.zeros((1, 4, 1)))
        array([1])
    """
    model = DummyClassifier(strategy="most_frequent") if _is_classes(task) else DummyRegressor()
    return make_pipeline(FlatReadings(), model)


def _is_classes(task: str) -> bool:
    need(task in _TASKS, f"'task' must be one of {list(_TASKS)} (got '{task}')")
    return task == "multiclass"


def _forest(task: _Task, num_trees: int, min_samples_leaf: int, class_weight: _Weight) -> Any:
    size = {"n_estimators": num_trees, "min_samples_leaf": min_samples_leaf}
    if _is_classes(task):
        return RandomForestClassifier(**size, class_weight=class_weight)
    return RandomForestRegressor(**size, max_features=1 / 3)


def _scaled(model: Any) -> TransformedTargetRegressor:
    return TransformedTargetRegressor(_EachNumber(model), transformer=StandardScaler())


class _EachNumber(MultiOutputRegressor):
    def fit(self, x: np.ndarray, y: np.ndarray) -> Self:
        super().fit(x, np.asarray(y).reshape(len(y), -1))  # one number comes without a column
        return self


def _kernel_machine(
    task: str,
    C: float,  # noqa: N803
    width: float,
    most: int | None,
    class_weight: _Weight,
) -> Any:
    if _is_classes(task):
        return _FewerSVC(C, width, most, class_weight)
    return _scaled(_FewerSVR(C, width, most))


class _Fewer:
    # A support vector machine on a part of many samples, whose kernel is as wide as these ask for.
    width: float
    most: int | None
    random_state: Any

    def fit(self, x: np.ndarray, y: np.ndarray) -> Self:
        variance = float(x.var())
        self.gamma = self.width / (x.shape[1] * variance) if variance > 0 else self.width
        y = np.asarray(y)
        if self.most is not None and len(x) > self.most:
            chosen = np.random.default_rng(self.random_state or 0).permutation(len(x))[: self.most]
            x, y = x[chosen], y[chosen]
        super().fit(x, y)  # type: ignore[misc]
        return self


class _FewerSVC(_Fewer, SVC):
    def __init__(
        self,
        C: float = 1.0,  # noqa: N803
        width: float = 1.0,
        most: int | None = None,
        class_weight: _Weight = None,
        random_state: Any = None,
    ) -> None:
        super().__init__(C=C, class_weight=class_weight, random_state=random_state)
        self.width = width
        self.most = most


class _FewerSVR(_Fewer, SVR):
    def __init__(
        self,
        C: float = 1.0,  # noqa: N803
        width: float = 1.0,
        most: int | None = None,
        random_state: Any = None,
    ) -> None:
        super().__init__(C=C)
        self.width = width
        self.most = most
        self.random_state = random_state
