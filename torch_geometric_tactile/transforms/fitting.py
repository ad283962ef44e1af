r"""Fits compositions of transforms."""

from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.transforms._samples import AnySamples, as_static_data
from torch_geometric_tactile.transforms.base import FittedTransform


def fitted_parts(transform: BaseTransform | None) -> list[FittedTransform]:
    r"""Returns the parts of a transform that must be fitted, in their order.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.

    Examples:
        >>> from torch_geometric_tactile.transforms import CommonMode, ZScore
        >>> fitted_parts(Compose([CommonMode(), ZScore()]))
        [ZScore()]
    """
    return [part for part in flat(transform) if isinstance(part, FittedTransform)]


def fit_parts(
    transform: BaseTransform | None,
    data: AnySamples,
    adapt: bool = False,
    before: BaseTransform | None = None,
) -> None:
    r"""Fits each part of a transform on the output of the parts before it.

    Samples are processed in chunks, so that neither a memory-mapped data set nor the transformed
    samples need to fit into memory. For each fitted part, the parts before it are applied to all
    samples again.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.
        data (Dataset or StaticData or list of Data): The samples, before the :obj:`transform` of
            their data set.
        adapt (bool): Whether to call :meth:`FittedTransform.adapt` instead of :obj:`fit`.
        before (BaseTransform, optional): A transform, such as the :obj:`transform` of the data set,
            that is applied to the samples first and is not fitted.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.transforms import CommonMode, ZScore
        >>> transform = Compose([CommonMode(), ZScore()])
        >>> fit_parts(transform, FakeTactileDataset(num_samples=8))
        >>> len(fitted_parts(transform))
        1
    """
    earlier_parts = flat(before)
    for part in flat(transform):
        if isinstance(part, FittedTransform):
            earlier = Compose(earlier_parts) if earlier_parts else None
            part.adapt(data, earlier) if adapt else part.fit(data, earlier)
        earlier_parts = [*earlier_parts, part]


def fit_transform(
    transform: BaseTransform | None, data: AnySamples, adapt: bool = False
) -> StaticData:
    r"""Fits each part of a transform on the output of the parts before it, and returns the
    transformed samples.

    All transformed samples are held in memory. :func:`fit_parts` fits without returning samples.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.
        data (Dataset or StaticData or list of Data): The samples, before the :obj:`transform` of
            their data set.
        adapt (bool): Whether to call :meth:`FittedTransform.adapt` instead of :obj:`fit`.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.transforms import ZScore
        >>> data = fit_transform(ZScore(), FakeTactileDataset(num_samples=8))
        >>> bool(data.x.mean().abs() < 1e-5)
        True
    """
    out = as_static_data(data)
    for part in flat(transform):
        fit_parts(part, out, adapt)
        out = apply_transform(part, out)
    return out
