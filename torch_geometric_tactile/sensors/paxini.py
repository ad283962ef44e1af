r"""Layouts of PaXini tactile modules, and of a LEAP hand with them."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def paxini_15_tip() -> TaxelLayout:
    r"""Returns the layout of a PaXini fingertip of the generation before GEN3: 15 points at the
    positions in the code of `3DTacDex <https://github.com/tianhaowuhz/3dtacdex>`_ (MIT licence).

    The origin and the axes are PaXini's: :math:`+y` points to the tip, and :math:`+z` out of the
    pad. The edges of :obj:`"original"` join neighbours in 5 rows along the finger and 3 columns.
    The edges and the image map are choices of this package.

    Shapes:
        - **pos:** metres in the frame of the module :math:`(15, 3)`
        - **image_map:** the tip in the last row, on 5 x 3 cells

    Examples:
        >>> paxini_15_tip()
        TaxelLayout('paxini_15_tip', num_taxels=15, patches=1, digits=1)
    """
    return stock_layout("paxini_15_tip")


def paxini_15_pulp() -> TaxelLayout:
    r"""Returns the layout of a flat PaXini pad of the generation before GEN3: 15 points at the
    positions in the code of `3DTacDex <https://github.com/tianhaowuhz/3dtacdex>`_ (MIT licence).
    Frame, edges and image map are as in :func:`paxini_15_tip`.

    Shapes:
        - **pos:** metres in the frame of the module :math:`(15, 3)`
        - **image_map:** the end of the finger in the last row, on 5 x 3 cells

    Examples:
        >>> paxini_15_pulp().edge_index("original").shape
        torch.Size([2, 44])
    """
    return stock_layout("paxini_15_pulp")


def paxini_31() -> TaxelLayout:
    r"""Returns the layout of a PaXini fingertip PX-6AX GEN3 DP-S1813-Elite (13 mm): 31 points at
    the positions that the package `paxini-sdk <https://github.com/Jingyi-Z/paxini-sdk>`_ (MIT
    licence) copies from PaXini's product documents.

    The origin and the axes are PaXini's: :math:`+y` points to the tip, and :math:`+z` out of the
    pad. The documents give neither normals nor the axes of the forces at a point. The edges of
    :obj:`"original"` join points less than 4.2 mm apart, a choice of this package.

    Shapes:
        - **pos:** metres in the frame of the module :math:`(31, 3)`

    Examples:
        >>> paxini_31().edge_index("original").shape
        torch.Size([2, 100])
    """
    return stock_layout("paxini_31")


def paxini_52() -> TaxelLayout:
    r"""Returns the layout of a PaXini fingertip PX-6AX GEN3 DP-S2015-Elite (15 mm): 52 points at
    the positions that the package `paxini-sdk <https://github.com/Jingyi-Z/paxini-sdk>`_ (MIT
    licence) copies from PaXini's product documents. The frame is as in :func:`paxini_31`. The edges
    of :obj:`"original"` join points less than 4 mm apart, a choice of this package.

    Shapes:
        - **pos:** metres in the frame of the module :math:`(52, 3)`

    Examples:
        >>> paxini_52().edge_index("original").shape
        torch.Size([2, 238])
    """
    return stock_layout("paxini_52")


def leap_paxini() -> TaxelLayout:
    r"""Returns the layout of a LEAP hand with eight PaXini modules: 120 points in
    :func:`paxini_15_tip` and :func:`paxini_15_pulp` modules on thumb, index, middle and ring
    finger, mounted as in `3DTacDex <https://github.com/tianhaowuhz/3dtacdex>`_ (MIT licence).

    The links have the names in the URDF of the LEAP hand. Load the URDF with
    :meth:`HandKinematics.from_urdf` to pose the points. Edges and image map are choices of this
    package. No edge joins two modules.

    Shapes:
        - **pos:** metres in the frames of the links :math:`(120, 3)`
        - **image_map:** the fingers side by side with their tips in row 0, on 10 x 12 cells

    Examples:
        >>> leap_paxini()
        TaxelLayout('leap_paxini', num_taxels=120, patches=8, digits=4)
    """
    return stock_layout("leap_paxini")
