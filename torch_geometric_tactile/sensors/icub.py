r"""Layouts of the hand of the iCub robot."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def icub_fingertip() -> TaxelLayout:
    r"""Returns the layout of a fingertip of the iCub robot: 12 taxels at the coordinates (precise
    to about 0.5 mm) and with the normals of its board `ftx2
    <https://github.com/icub-tech-iit/electronics-boards-public>`_.

    The origin is the rotation centre of the fingertip's support. :math:`-x` points to the tip, and
    :math:`+y` points out of the pad. The edges of :obj:`"original"` join taxels less than 4.9 mm
    apart, and the image map shows the unrolled pad. Both are choices of this package.

    Shapes:
        - **pos, normal:** metres and unit vectors in the fingertip frame :math:`(12, 3)`
        - **image_map:** the tip in the last row, on 5 x 5 cells

    Examples:
        >>> icub_fingertip().edge_index("original").shape
        torch.Size([2, 38])
    """
    return stock_layout("icub_fingertip")


def icub_hand() -> TaxelLayout:
    r"""Returns the layout of the five fingertips of an iCub hand: 60 taxels on thumb, index,
    middle, ring and little finger, each as in :func:`icub_fingertip`. Each finger is a digit with a
    separate frame.

    Shapes:
        - **pos, normal:** metres and unit vectors, in the frame of each fingertip :math:`(60, 3)`
        - **image_map:** the fingertips side by side, on 5 x 25 cells

    Examples:
        >>> icub_hand().digit_names
        ('thumb', 'index', 'middle', 'ring', 'little')
    """
    return stock_layout("icub_hand")
