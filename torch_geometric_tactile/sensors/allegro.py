r"""The Allegro hand with uSkin."""

from dataclasses import replace

import torch

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def allegro_uskin(symmetric: bool = False) -> TaxelLayout:
    r"""The 384 taxels of a right Allegro hand covered with XELA uSkin, the hand of the "Tactile
    Object Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph
    Convolutional Network" paper: 22 patches, four fingertips of 24 taxels, 11 phalanges and 7 palm
    patches of 4 x 4.

    Each digit is numbered from base to tip and each patch row by row, digits in the order index,
    middle, ring, thumb, palm. Adjacencies and their directed edges: :obj:`"sparse"` 1000,
    :obj:`"slanted"` 1184, :obj:`"original"` 1401, :obj:`"dense"` 2488. The figures that draw these
    edges are not public: they are our reconstruction, which has every published count. The
    published 1401 is odd; ours holds one edge without its reverse, from the thumb's base to its
    palm patch.

    Pitch and places of the phalanx patches are those of XELA's public model of a covered hand
    (mcsix/xela_models); the shape of the fingertip and the places of the palm patches are our
    model. The file behind it (:obj:`stock_path("layouts", "allegro_uskin")`) describes patches and
    joins, in millimetres, to copy, edit and :meth:`~TaxelLayout.load`.

    Args:
        symmetric (bool): Whether to leave the one-way edge out, so that :obj:`"original"` has 1400.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links that
          :meth:`HandKinematics.allegro` moves :math:`(384, 3)`
        - **image_map:** a hand seen from its palm side, fingertips up, on 32 x 16 cells

    Examples:
        >>> layout = allegro_uskin()
        >>> layout
        TaxelLayout('allegro_uskin', num_taxels=384, patches=22, digits=5)
        >>> layout.edge_index("original").shape
        torch.Size([2, 1401])
    """
    layout = stock_layout("allegro_uskin")
    if not symmetric:
        return layout
    adjacency = dict(layout.adjacency)
    source, target = adjacency["original"]
    code, reverse = source * len(layout) + target, target * len(layout) + source
    adjacency["original"] = adjacency["original"][:, torch.isin(code, reverse)]
    return replace(layout, adjacency=adjacency)


def allegro_uskin_240() -> TaxelLayout:
    r"""The 240 taxels of a right Allegro hand with XELA uSkin on its digits and none on its palm,
    the hand of the "Morphology-Specific Convolutional Neural Networks for Tactile Object
    Recognition with a Multi-Fingered Hand" paper: 11 phalanges of 4 x 4 and four fingertips of 16.

    Numbered as :func:`allegro_uskin`, with the same kinds of adjacencies; its four digits are not
    joined with each other. The paper lays a fingertip on 6 x 4 cells, of which 8 are empty; that
    these are beside the four outer rows is our choice.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links that
          :meth:`HandKinematics.allegro` moves :math:`(240, 3)`
        - **image_map:** the digits side by side, index, middle, ring, thumb, fingertips up, on
          18 x 16 cells; the 4 x 4 above the thumb are empty

    Examples:
        >>> allegro_uskin_240()
        TaxelLayout('allegro_uskin_240', num_taxels=240, patches=15, digits=4)
    """
    return stock_layout("allegro_uskin_240")


def allegro_uskin_368() -> TaxelLayout:
    r"""The 368 taxels of a right Allegro hand with XELA uSkin, as XELA's server sends them today
    (models XR23AHRCPP and, mirrored, XR23AHLCPP): 11 phalanges of 4 x 4 that stand where those of
    :func:`allegro_uskin` do, four curved fingertips of 30 taxels, in rows of 6, 6, 6, 6, 4, 2, and
    three palm patches of 4 x 6.

    Which patch has which taxels is XELA's; pitches, the places of the patches and the size of a
    fingertip are those of XELA's public model of a covered hand (mcsix/xela_models), of which a
    capsule and square cells are our model. No paper has edges for this hand: they are ours, with
    the kinds of :func:`allegro_uskin`. A message of the server has another order, which
    :class:`~torch_geometric_tactile.live.TaxelMap` :obj:`"xela_allegro_368"` brings into this one.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links that
          :meth:`HandKinematics.allegro` moves :math:`(368, 3)`
        - **image_map:** XELA's own picture of the hand, from its palm side with fingertips up, on
          31 x 26 cells

    Examples:
        >>> allegro_uskin_368()
        TaxelLayout('allegro_uskin_368', num_taxels=368, patches=18, digits=5)
    """
    return stock_layout("allegro_uskin_368")
