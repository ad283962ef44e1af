r"""A figure that notebooks show. Imports matplotlib."""

from io import BytesIO

from matplotlib.figure import Figure


class ShownFigure(Figure):
    r"""A figure that is shown as a picture where it is the last line of a notebook's cell or is
    given to :obj:`display`, without pyplot.
    """

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
