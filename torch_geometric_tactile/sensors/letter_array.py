r"""Layout of the pressure array of the letter data set."""

from dataclasses import replace

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.planar_arrays import grid


def letter_array() -> TaxelLayout:
    r"""Returns the layout of the flexible pressure array in the "A Novel Bilinear Feature and
    Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822): a :func:`grid` of 32 x 32 pixels. It has 64 pixels per square centimetre,
    1.25 mm apart.

    The first row is the top row of an image. As in a grid, the adjacency :obj:`"original"` joins
    four neighbours, and :obj:`"dense"` eight.

    Shapes:
        - **pos, normal:** metres and unit vectors in the plane :math:`z = 0` :math:`(1024, 3)`
        - **image_map:** row by row, on 32 x 32 cells

    Examples:
        >>> letter_array()
        TaxelLayout('letter_array', num_taxels=1024, patches=1, digits=1)
    """
    source = "32 x 32 pixels, 64 per square centimetre, as the paper says; flat"
    return replace(grid(32, 32, pitch=1.25e-3), name="letter_array", source=source)
