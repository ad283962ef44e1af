r"""A rule of the attributes that a transform reads and adds."""

from typing import Literal, NamedTuple


class StaticRule(NamedTuple):
    r"""Describes which attributes a transform reads and adds.

    Args:
        reads (tuple of str, optional): The attributes on which the output depends. If all samples
            share them, they share the output, and the transform runs once for all samples. With
            :obj:`None` it runs for each sample, as a random transform must.
        node (tuple of str): The attributes that it adds with a row for each taxel.
        edge (tuple of str): The attributes that it adds with a row for each edge.
        shared (tuple of str): The attributes that it adds with one value for all samples.
        x (str, optional): Whether it appends columns that depend on :obj:`reads` to :obj:`x`
            (:obj:`"append"`), or replaces :obj:`x` by them (:obj:`"replace"`).
        writes (tuple of str, optional): The existing positions, normals and edge attributes that it
            replaces. If left out, all attributes in :obj:`reads` and all edge attributes.

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
