r"""Declaration of the attributes that a transform reads and adds."""

from collections.abc import Iterable
from typing import Any

from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._static_rule import StaticRule

_TOPOLOGY = ("pos", "normal", "edge_index", "edge_attr", "edge_weight")


class StaticTransform(BaseTransform):
    r"""A transform with declared attributes that it reads and adds, the output of
    :func:`static_transform`.
    """

    def __init__(self, transform: Transform, static_rule: StaticRule) -> None:
        self.transform = transform
        self.static_rule = static_rule

    def forward(self, data: Any) -> Any:
        r"""Applies the transform."""
        return self.transform(data)

    def __repr__(self) -> str:
        name = getattr(self.transform, "__name__", repr(self.transform))
        return f"{type(self).__name__}({name})"


def static_transform(
    transform: Transform,
    *,
    reads: Iterable[str] | None = _TOPOLOGY,
    node: Iterable[str] = (),
    edge: Iterable[str] = (),
    shared: Iterable[str] = (),
) -> StaticTransform:
    r"""Declares the attributes that a PyG transform reads and adds, so that it runs once for a
    batch instead of once for each sample.

    If all samples of a batch share the attributes that the transform reads, they share its output
    as well, and the transform is called for one sample. Otherwise, and always with
    :obj:`reads=None`, it is called for each sample. A transform class can make the same declaration
    by a class attribute :obj:`static_rule`, a :obj:`StaticRule`.

    Args:
        transform (callable): Maps a :class:`~torch_geometric.data.Data` to a
            :class:`~torch_geometric.data.Data`.
        reads (iterable of str, optional): The attributes on which the output depends; :obj:`None`
            for a random transform.
        node (iterable of str): The attributes with a row for each taxel that the transform adds.
        edge (iterable of str): The attributes with a row for each edge that the transform adds, in
            addition to :obj:`edge_index`, :obj:`edge_attr` and :obj:`edge_weight`.
        shared (iterable of str): The attributes with one value for all samples that the transform
            adds.

    Raises:
        ValueError: If a text is passed in place of a list of names.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData, apply_transform
        >>> from torch_geometric_tactile.sensors import grid
        >>> def add_height(data):
        ...     data.height = data.pos[:, 2:]
        ...     return data
        >>> data = StaticData(x=torch.zeros(5, 6, 1), pos=grid(2, 3, pitch=0.002).pos)
        >>> transform = static_transform(add_height, reads=["pos"], node=["height"])
        >>> apply_transform(transform, data).height.shape
        torch.Size([6, 1])
    """
    arguments = {"reads": reads, "node": node, "edge": edge, "shared": shared}
    names: dict[str, tuple[str, ...] | None] = {}
    for argument, value in arguments.items():
        if isinstance(value, str):
            raise ValueError(f"'{argument}' must be a list of names (got '{value}')")
        names[argument] = None if value is None else tuple(value)
    return StaticTransform(transform, StaticRule(**names))  # type: ignore[arg-type]
