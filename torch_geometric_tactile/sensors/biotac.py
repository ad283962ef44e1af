r"""Layouts of the BioTac fingertips."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def biotac() -> TaxelLayout:
    r"""Returns the layout of a SynTouch BioTac: 19 electrodes at the coordinates in Table I of the
    "Tactile Grasp Stability Classification Based on Graph Convolutional Networks" paper (converted
    from millimetres).

    The :math:`x` axis points along the finger towards its tip, and :math:`-z` points out of the
    pad. The normals are assumptions of this package: they are radial to the finger's axis behind
    the origin, and radial to the origin in front of it.

    Shapes:
        - **pos, normal:** metres and unit vectors in the fingertip frame :math:`(19, 3)`

    Examples:
        >>> biotac().num_taxels
        19
    """
    return stock_layout("biotac")


def biotac_sp() -> TaxelLayout:
    r"""Returns the layout of a SynTouch BioTac SP: 24 electrodes at the coordinates in the `BioTac
    SP stability set <https://github.com/3dperceptionlab/biotacsp-stability-set-v2>`_ (converted
    from inches).

    The :math:`x` axis points along the finger, and :math:`-y` points out of the pad. The normals
    are assumptions of this package: they are normal to the ellipsoid of revolution about :math:`x`
    that best fits the 24 positions (:obj:`source` gives the root mean square distance).

    Shapes:
        - **pos, normal:** metres and unit vectors in the fingertip frame :math:`(24, 3)`

    Examples:
        >>> biotac_sp().pos[0]
        tensor([ 0.0098, -0.0028,  0.0040])
    """
    return stock_layout("biotac_sp")
