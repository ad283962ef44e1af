r"""Layout of a FlexiTac pad."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def flexitac() -> TaxelLayout:
    r"""Returns the layout of a `FlexiTac <https://flexitac.github.io>`_ pad of 12 x 32 taxels,
    numbered row by row. The pitch of 2 mm is taken from the maker's `simulation
    <https://github.com/binghao-huang/FlexiTac-IsaacSim-Simulation>`_. For pads of other sizes, use
    :func:`grid`.

    The origin is the centre of the pad, :math:`x` points to the next column and :math:`y` to the
    next row.

    Shapes:
        - **pos, normal:** metres and unit vectors :math:`(384, 3)`
        - **image_map:** the first row at the bottom, on 12 x 32 cells

    Examples:
        >>> flexitac()
        TaxelLayout('flexitac', num_taxels=384, patches=1, digits=1)
    """
    return stock_layout("flexitac")
