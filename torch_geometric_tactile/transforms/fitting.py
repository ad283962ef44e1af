r"""Fitting transforms that come one after the other."""

from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.transforms._samples import AnySamples, as_static_data
from torch_geometric_tactile.transforms.base import FittedTransform


def fitted_parts(transform: BaseTransform | None) -> list[FittedTransform]:
    r"""Returns the parts of a transform that have to be fitted, in their order.

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
    r"""Fits every part of a transform on the output of the parts before it, a few samples at a
    time: at no time are all samples transformed in memory, or those of a memory-mapped data set
    copied.

    The parts before a fitted part are applied to all samples once more for each of them.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.
        data (Dataset or StaticData or list of Data): The samples, before the :obj:`transform` of
            their data set.
        adapt (bool): Whether to call :meth:`FittedTransform.adapt` instead of :obj:`fit`.
        before (BaseTransform, optional): Applied to the samples first, and not fitted, such as the
            :obj:`transform` of the data set.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.transforms import CommonMode, ZScore
        >>> transform = Compose([CommonMode(), ZScore()])
        >>> fit_parts(transform, FakeTactileDataset(num_samples=8))
        >>> len(fitted_parts(transform))
        1
    """
    earlier = flat(before)
    for part in flat(transform):
        if isinstance(part, FittedTransform):
            of_earlier = Compose(earlier) if earlier else None
            part.adapt(data, of_earlier) if adapt else part.fit(data, of_earlier)
        earlier = [*earlier, part]


def fit_transform(
    transform: BaseTransform | None, data: AnySamples, adapt: bool = False
) -> StaticData:
    r"""Fits every part of a transform on the output of the parts before it, and applies the
    transform.

    All samples are transformed in memory, since they are returned; :func:`fit_parts` fits only.

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
