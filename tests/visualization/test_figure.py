import io

import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
pytest.importorskip("IPython", reason="needs the extra 'docs'")

from IPython.core.interactiveshell import InteractiveShell
from PIL import Image

from torch_geometric_tactile.visualization._style import new_figure


def test_figure_is_a_picture_in_a_notebook():
    formatter = InteractiveShell.instance().display_formatter
    shown, _ = formatter.format(new_figure(3, 2))
    assert shown["image/png"].startswith(b"\x89PNG")


def test_figure_is_shown_at_its_size():
    with Image.open(io.BytesIO(new_figure(3, 2)._repr_png_())) as image:
        assert image.size == (300, 200)
