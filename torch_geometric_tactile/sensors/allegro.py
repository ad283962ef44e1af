r"""Layouts of the Allegro hand with uSkin."""

from dataclasses import replace

import torch

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def allegro_uskin(symmetric: bool = False) -> TaxelLayout:
    r"""Returns the layout of a right Allegro hand covered with XELA uSkin: 384 taxels in 22 patches
    (four fingertips of 24 taxels, 11 phalanges and 7 palm patches of 4 x 4). The hand is described
    in the "Tactile Object Property Recognition using Geometrical Graph Edge Features and
    Multi-Thread Graph Convolutional Network" paper.

    Taxels are numbered by digit (index, middle, ring, thumb, palm), from base to tip, and row by
    row within each patch. The adjacencies have these numbers of directed edges: :obj:`"sparse"`
    1000, :obj:`"slanted"` 1184, :obj:`"original"` 1401 and :obj:`"dense"` 2488.

    The figures that show the edges are not public. The edges are therefore a reconstruction that
    matches all published numbers. Since the published 1401 is odd, one edge has no reverse: the
    edge from the base of the thumb to its palm patch.

    The pitch and the positions of the phalanx patches are taken from XELA's public model of a
    covered hand (mcsix/xela_models). The shape of the fingertip and the positions of the palm
    patches are assumptions of this package. To change them, copy the layout file
    (:obj:`stock_path("layouts", "allegro_uskin")`), which describes patches and joins in
    millimetres. Edit the copy and :meth:`~TaxelLayout.load` it.

    Args:
        symmetric (bool): Whether to remove the edge without a reverse, so that :obj:`"original"`
            has 1400 edges.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links of
          :meth:`HandKinematics.allegro` :math:`(384, 3)`
        - **image_map:** the hand seen from its palm side, with fingertips up, on 32 x 16 cells

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
    # Keep the edges whose reverse is an edge as well.
    adjacency = dict(layout.adjacency)
    source, target = adjacency["original"]
    code, reverse = source * len(layout) + target, target * len(layout) + source
    adjacency["original"] = adjacency["original"][:, torch.isin(code, reverse)]
    return replace(layout, adjacency=adjacency)


def allegro_uskin_240() -> TaxelLayout:
    r"""Returns the layout of a right Allegro hand with XELA uSkin on its digits but not on its
    palm: 240 taxels on 11 phalanges of 4 x 4 and four fingertips of 16. The hand is described in
    the "Morphology-Specific Convolutional Neural Networks for Tactile Object Recognition with a
    Multi-Fingered Hand" paper.

    Taxels are numbered as in :func:`allegro_uskin`, with the same kinds of adjacencies. No edge
    joins two digits. The paper maps a fingertip to 6 x 4 cells, of which 8 are empty. The position
    of the empty cells beside the four outer rows is an assumption of this package.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links of
          :meth:`HandKinematics.allegro` :math:`(240, 3)`
        - **image_map:** the digits side by side (index, middle, ring, thumb) with fingertips up, on
          18 x 16 cells; the 4 x 4 cells above the thumb are empty

    Examples:
        >>> allegro_uskin_240()
        TaxelLayout('allegro_uskin_240', num_taxels=240, patches=15, digits=4)
    """
    return stock_layout("allegro_uskin_240")


def allegro_uskin_368() -> TaxelLayout:
    r"""Returns the layout of the current right Allegro hand with XELA uSkin, models XR23AHRCPP and
    (mirrored) XR23AHLCPP of XELA's server. Its 368 taxels are on 11 phalanges of 4 x 4 at the
    positions of :func:`allegro_uskin`, four curved fingertips of 30 taxels in rows of 6, 6, 6, 6,
    4, 2, and three palm patches of 4 x 6.

    The taxels of each patch and the image map are taken from XELA's taxel maps. The pitches, the
    positions of the patches and the size of a fingertip are taken from XELA's public model of a
    covered hand (mcsix/xela_models), simplified to capsules and square cells. No paper defines
    edges for this hand. This package chose them, with the same kinds as in :func:`allegro_uskin`.

    Messages of the server have another taxel order. The
    :class:`~torch_geometric_tactile.live.TaxelMap` :obj:`"xela_allegro_368"` converts them to the
    order of this layout.

    Shapes:
        - **pos, normal:** metres and unit vectors in the frames of the links of
          :meth:`HandKinematics.allegro` :math:`(368, 3)`
        - **image_map:** XELA's picture of the hand from its palm side, with fingertips up, on
          31 x 26 cells

    Examples:
        >>> allegro_uskin_368()
        TaxelLayout('allegro_uskin_368', num_taxels=368, patches=18, digits=5)
    """
    return stock_layout("allegro_uskin_368")
