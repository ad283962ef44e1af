r"""Grippers with XELA uSkin."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def uskin_gripper() -> TaxelLayout:
    r"""Two planar XELA uSkin patches of 4 x 4 taxels, one on each finger of a parallel gripper, as
    in `tactile_prediction_flat_dataset
    <https://github.com/imanlab/tactile_prediction_flat_dataset>`_. Each has a pitch of 4.667 mm and
    a frame of its own, and is numbered row by row as the phalanges of :func:`allegro_uskin` are; no
    edge joins the fingers.

    The files name the taxels 1 to 16 of a patch, and not their places. That these follow one
    another row by row is our reading, up to a turn or a mirror of the patch, which leave the edges
    as they are: in the file that was opened, taxels 1, 4, 13 and 16, the corners of such a patch,
    have the four highest counts of :math:`z` at rest.

    Shapes:
        - **pos, normal:** metres and unit vectors, in the frame of each finger :math:`(32, 3)`
        - **image_map:** the fingers side by side, on 4 x 8 cells

    Examples:
        >>> uskin_gripper()
        TaxelLayout('uskin_gripper', num_taxels=32, patches=2, digits=2)
    """
    return stock_layout("uskin_gripper")
