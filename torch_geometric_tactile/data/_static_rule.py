r"""The declaration of the attributes that a transform reads and adds."""

from typing import Literal, NamedTuple


class StaticRule(NamedTuple):
    r"""The attributes that a transform reads and adds.

    Args:
        reads (tuple of str, optional): The attributes on which the output depends. If all samples
            share them, they share the output, and the transform is called once for all samples.
            With :obj:`None`, the transform is called for each sample, as a random transform
            requires.
        node (tuple of str): The attributes with a row for each taxel that the transform adds.
        edge (tuple of str): The attributes with a row for each edge that the transform adds.
        shared (tuple of str): The attributes with one value for all samples that the transform
            adds.
        x (str, optional): :obj:`"append"` if the transform appends columns that depend on
            :obj:`reads` to :obj:`x`, or :obj:`"replace"` if it replaces :obj:`x` by them.
        writes (tuple of str, optional): The existing positions, normals and edge attributes that
            the transform replaces. The default is all attributes in :obj:`reads` and all edge
            attributes.

    Examples:
        >>> StaticRule(reads=("pos", "edge_index"), edge=("edge_attr",)).edge
        ('edge_attr',)
    """

    reads: tuple[str, ...] | None = None
    node: tuple[str, ...] = ()
    edge: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    x: Literal["append", "replace"] | None = None
    writes: tuple[str, ...] | None = None
