import pytest

from torch_geometric_tactile.io._csv_table import safe_cell, shown


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
    assert safe_cell(text) == "'" + text


@pytest.mark.parametrize("text", ["", "mug", "a=1", "mug-2", "'quoted'", "1+1", "  mug", "é"])
def test_safe_cell_leaves_other_texts(text):
    assert safe_cell(text) == text


def test_shown_cuts_what_is_longer_than_60_characters():
    assert shown("a" * 60) == f"'{'a' * 60}'"
    assert shown("a" * 61) == f"'{'a' * 60}...'"
    assert shown("a\nb") == r"'a\nb'"
