import pytest

from torch_geometric_tactile.io._csv_table import text_to_cell


@pytest.mark.parametrize(
    "text",
    [
        "=1+1",
        "+1",
        "-mug",
        "@SUM(A1)",
        "\t=1",
        "\r1",
        "\nmug",
        "  =cmd|' /C calc'!A0",
        "\uff1d1",
        "\uff201",
    ],
)
def test_safe_cell_marks_what_begins_like_a_formula(text):
    assert text_to_cell(text) == "'" + text


@pytest.mark.parametrize("text", ["", "mug", "a=1", "mug-2", "'quoted'", "1+1", "  mug", "é"])
def test_safe_cell_leaves_other_texts(text):
    assert text_to_cell(text) == text
