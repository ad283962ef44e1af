import pytest

from torch_geometric_tactile._texts import (
    markdown_text,
    parse_json,
    printable,
    quoted,
    short_list,
    short_repr,
)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a cup, 5 % of $3 and größer 3", "a cup, 5 % of $3 and größer 3"),
        ("two\nlines\r\tand a tab", r"two\nlines\r\tand a tab"),
        ("\x1b[31mred\x07\x00", r"\x1b[31mred\x07\x00"),
        ("\x85\x9b", r"\x85\x9b"),
        ("gpj.\u202egnp\u2066\u2069", r"gpj.\u202egnp\u2066\u2069"),
        ("\u2028\u2029", r"\u2028\u2029"),
        ("\udcff", r"\udcff"),
        ("wide\u3000space", "wide\u3000space"),
        (3.5, "3.5"),
    ],
)
def test_printable_escapes_what_a_terminal_obeys(text, shown):
    assert printable(text) == shown


def test_markdown_text_is_one_cell_without_markup():
    assert markdown_text("a|b\n<img src=x> [x](y) `c` *d*") == (
        r"a\|b\\n\<img src=x\> \[x\](y) \`c\` *d*"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "Expecting property name"),
        ('{"a": {"b": 1, "c": 2, "b": 3}}', r"each key once \(got 'b' twice\)"),
        ("[NaN]", r"finite \(got NaN\)"),
        ("[-1e400]", r"finite \(got -1e400\)"),
        ("1" * 5000, "4300 digits"),
        ("[" * 100_000, "nested this deeply"),
    ],
)
def test_parse_json_refuses(text, message):
    with pytest.raises(ValueError, match=message):
        parse_json(text)


def test_parse_json_reads_what_json_has():
    assert parse_json('{"a": [1, -2.5e3, true, null, "x"]}') == {"a": [1, -2500.0, True, None, "x"]}


def test_texts_of_files_are_cut_and_harmless():
    assert quoted("cup") == "'cup'"
    assert quoted("x" * 61) == f"'{'x' * 60}...'"
    assert quoted("\x1b[2J") == r"'\x1b[2J'"


def test_values_of_files_are_cut():
    deep = []
    for _ in range(100_000):
        deep = [deep]
    assert short_repr("cup") == "'cup'"
    assert short_repr(list(range(99))) == f"{str(list(range(99)))[:57]}..."
    assert short_repr(deep) == "a list"
    assert short_repr(10**5000) == "a int"


def test_a_short_list_tells_how_many_others_there_are():
    names = ["a", "b", "c"]
    assert short_list(names, 3) == "a, b, c"
    assert short_list(names, 2) == "a, b and 1 more"
    assert short_list(names, 1, repr, ", ... and {} more") == "'a', ... and 2 more"
    assert short_list(names, 2, ending="; and {} more", separator="; ") == "a; b; and 1 more"
    assert short_list([], 2) == "none"
