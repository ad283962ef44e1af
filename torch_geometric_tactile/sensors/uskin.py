r"""Layouts of flat XELA uSkin patches, and of a gripper with them."""

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_layout


def uskin_gripper() -> TaxelLayout:
    r"""Returns the layout of two planar XELA uSkin patches of 4 x 4 taxels, one on each finger of a
    parallel gripper, as in `tactile_prediction_flat_dataset
    <https://github.com/imanlab/tactile_prediction_flat_dataset>`_. Each patch has a pitch of
    4.667 mm and a separate frame. Its taxels are numbered row by row, as in the phalanges of
    :func:`allegro_uskin`. No edge joins the fingers.

    The files number the taxels of a patch from 1 to 16, but do not document their positions. The
    order row by row is an assumption of this package. A rotation or reflection of the patch would
    not change the edges. In the inspected file, taxels 1, 4, 13 and 16 (the corners in this order)
    have the four highest counts of :math:`z` at rest.

    Shapes:
        - **pos, normal:** metres and unit vectors, in the frame of each finger :math:`(32, 3)`
        - **image_map:** the fingers side by side, on 4 x 8 cells

    Examples:
        >>> uskin_gripper()
        TaxelLayout('uskin_gripper', num_taxels=32, patches=2, digits=2)
    """
    return stock_layout("uskin_gripper")


def uspa44() -> TaxelLayout:
    r"""Returns the layout of XELA's uSPa44 patch of 4 x 4 taxels (earlier XR1844 and XR1944), with
    positions, numbers and measuring axes from `XELA's public model
    <https://github.com/mcsix/xela_models>`_.

    The origin is the origin of the model's base. Taxels are numbered row by row: :math:`+x` points
    to the next taxel of a row, and :math:`-y` to the next row. XELA's maps of the Allegro hand use
    the same numbers for these patches. It is an assumption that messages of a single patch have
    this order as well.

    Shapes:
        - **pos, normal:** metres and unit vectors :math:`(16, 3)`
        - **image_map:** the first row at the top, on 4 x 4 cells

    Examples:
        >>> uspa44().edge_index("original").shape
        torch.Size([2, 48])
    """
    return stock_layout("uspa44")


def uspa46() -> TaxelLayout:
    r"""Returns the layout of XELA's uSPa46 patch of 4 rows of 6 taxels (earlier XR1946). Source,
    frame and order are as in :func:`uspa44`.

    Shapes:
        - **pos, normal:** metres and unit vectors :math:`(24, 3)`
        - **image_map:** the first row at the top, on 4 x 6 cells

    Examples:
        >>> uspa46().edge_index("original").shape
        torch.Size([2, 76])
    """
    return stock_layout("uspa46")
