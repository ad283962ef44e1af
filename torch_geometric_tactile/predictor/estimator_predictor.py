r"""A fitted scikit-learn estimator as a predictor."""

from typing import Any

from torch_geometric.transforms import Compose

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data import StaticDataset, apply_transform
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.predictor._network import Network
from torch_geometric_tactile.predictor._preparation import Preparation, add_shared_attributes
from torch_geometric_tactile.predictor.estimator_model import EstimatorModel
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.transforms import TaxelDescriptors


def estimator_predictor(
    estimator: Any, dataset: StaticDataset, transform: Transform | None = None
) -> Predictor:
    r"""Returns the predictor of a scikit-learn pipeline of
    :mod:`torch_geometric_tactile.baselines` that was fitted on a data set. Nothing is pickled: the
    fitted numbers are copied to an :class:`EstimatorModel`.

    Args:
        estimator (estimator): The fitted pipeline. A support vector machine or a ridge classifier
            must be wrapped in :class:`~torch_geometric_tactile.baselines.TemperatureScaling`.
        dataset (StaticDataset): The data set.
        transform (callable, optional): Fitted transform that is applied after the transform of the
            data set.

    Raises:
        ValueError: If the estimator is not supported, not fitted, or has no probabilities.

    Examples:
        >>> from torch_geometric_tactile.baselines import flat_forest
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> dataset = FakeTactileDataset(num_samples=60)
        >>> forest = flat_forest(num_trees=10).fit(dataset.data, dataset.data.y.numpy())
        >>> predictor = estimator_predictor(forest, dataset)
        >>> predictor
        Predictor(EstimatorModel, 'biotac_sp', classes=['stable', 'slip'], task='multiclass')
        >>> predictor(dataset[0].x).shape
        torch.Size([2])
    """
    y = dataset.column("y")
    is_regression = y is None or y.dim() > 1 or y.is_floating_point()
    sample = dataset.batch([0])
    sample = sample if transform is None else apply_transform(transform, sample)
    layout = dataset.layout
    has_normal = sample.get("normal") is not None or layout.normal is not None
    model = EstimatorModel.of(
        estimator,
        None if is_regression else dataset.num_classes,
        normal=has_normal,
        tangent=sample.get("tangent") is not None,
    )
    # The pipeline computes descriptors in its first step; a predictor computes them in a transform.
    if "descriptors" in model.modalities:
        pos = sample.get("pos")
        descriptors = TaxelDescriptors(layout, posed=pos is not None and pos.dim() == 3)
        transform = Compose([*flat(transform), descriptors])
    shared = {"pos": layout.pos}
    if layout.normal is not None:
        shared["normal"] = layout.normal
    preparation = add_shared_attributes(Preparation.from_dataset(dataset, transform), **shared)
    task = "regression" if is_regression else "multiclass"
    return Predictor._from_parts(preparation, Network(model, dataset.class_names, task))
