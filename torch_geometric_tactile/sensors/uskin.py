r"""Layouts of grippers with XELA uSkin."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def uskin_gripper() -> TaxelLayout:
    r"""Two planar XELA uSkin patches of 4 x 4 taxels, one on each finger of a parallel gripper, as
    in `tactile_prediction_flat_dataset
    <https://github.com/imanlab/tactile_prediction_flat_dataset>`_. Each patch has a pitch of
    4.667 mm and a separate frame, and its taxels are numbered row by row, as in the phalanges of
    :func:`allegro_uskin`. No edge joins the fingers.

    The files number the taxels 1 to 16 of a patch, but do not name their positions. The order row
    by row is an assumption of this package, up to a rotation or reflection of the patch, which does
    not change the edges. In the inspected file, taxels 1, 4, 13 and 16, the corners of such a
    patch, have the four highest counts of :math:`z` at rest.

    Shapes:
        - **pos, normal:** metres and unit vectors, in the frame of each finger :math:`(32, 3)`
        - **image_map:** the fingers side by side, on 4 x 8 cells

    Examples:
        >>> uskin_gripper()
        TaxelLayout('uskin_gripper', num_taxels=32, patches=2, digits=2)
    """
    return stock_layout("uskin_gripper")
