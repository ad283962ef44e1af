"""Mutations of lines and cells."""

from random import Random

from fuzz.bytes_mutations import NUMBERS

NAMES = (
    *("time", "Time", "TIME", "t", "timestamp", "time_ms", "timestamp_ns", "time [s]", "seconds"),
    *("", "0", "1", "index", "Unnamed: 0", "label", "NA", "nan", "x", "joint_0", "joint_0_deg"),
    *("taxel_0_x", "taxel_0_z", "taxel_1_y", "taxel_00_x", "taxel_99999999_x", "joint_99999999"),
    *("action_0", "action_1", "action_99999999"),
    *("0X", "1X", "1Z", "2Y", "99999999X", "Force 1X", "Force 0Z", "Send time", "Message number"),
    *("object", "slipped", "ff_biotac_1", "th_biotac_25", "taxel_\u0661_x", "taxel_0_x ", '"time"'),
)
_BREAKS = ("\r\n", "\r", "\n\n", "\n \n", "\x0b", "\x0c", "\x85", "\u2028")


def change_cell(text: str, draw: Random) -> str:
    rows, line, column = _cell(text, draw)
    rows[line][column] = draw.choice(NUMBERS)
    return _joined(rows)


def copy_cell(text: str, draw: Random) -> str:
    rows, line, column = _cell(text, draw)
    rows[line][column] = draw.choice(draw.choice(rows))
    return _joined(rows)


def decorate_cell(text: str, draw: Random) -> str:
    rows, line, column = _cell(text, draw)
    cell = rows[line][column]
    forms = (f'"{cell}"', f" {cell}", f"{cell} ", f'"{cell}', f'{cell}"', f"'{cell}", f"{cell}N")
    rows[line][column] = draw.choice((*forms, f"{cell}e3", f"\t{cell}", f"{cell}\x00", cell * 2))
    return _joined(rows)


def rename_column(text: str, draw: Random) -> str:
    rows = _rows(text)
    head = rows[0]
    column = draw.randrange(len(head))
    name = head[column]
    forms = (name.upper(), name.title(), f" {name}", f"{name}_", name[:-1], f"{name}.1", name[::-1])
    head[column] = draw.choice((draw.choice(NAMES), draw.choice(head), *forms))
    return _joined(rows)


def swap_names(text: str, draw: Random) -> str:
    rows = _rows(text)
    a, b = (draw.randrange(len(rows[0])) for _ in range(2))
    rows[0][a], rows[0][b] = rows[0][b], rows[0][a]
    return _joined(rows)


def number_names(text: str, draw: Random) -> str:
    """The header that pandas writes for a table without one."""
    rows = _rows(text)
    start = draw.choice([0, 0, 1])
    rows[0] = [str(i + start) for i in range(len(rows[0]))]
    return _joined(rows)


def add_index(text: str, draw: Random) -> str:
    """The first column that pandas writes."""
    rows = _rows(text)
    name = draw.choice(["", "index", "Unnamed: 0", "0"])
    return _joined([[name if i == 0 else str(i - 1), *row] for i, row in enumerate(rows)])


def delete_cell(text: str, draw: Random) -> str:
    rows, line, column = _cell(text, draw)
    del rows[line][column]
    return _joined(rows)


def repeat_cell(text: str, draw: Random) -> str:
    rows, line, column = _cell(text, draw)
    rows[line].insert(column, draw.choice([rows[line][column], "", "0"]))
    return _joined(rows)


def delete_column(text: str, draw: Random) -> str:
    rows, _, column = _cell(text, draw)
    return _joined([row[:column] + row[column + 1 :] for row in rows])


def repeat_column(text: str, draw: Random) -> str:
    rows, _, column = _cell(text, draw)
    to = draw.randrange(column + 1)
    return _joined([row[:to] + row[column : column + 1] + row[to:] for row in rows])


def swap_columns(text: str, draw: Random) -> str:
    rows, _, a = _cell(text, draw)
    b = draw.randrange(len(rows[0]))
    for row in rows:
        if max(a, b) < len(row):
            row[a], row[b] = row[b], row[a]
    return _joined(rows)


def delete_line(text: str, draw: Random) -> str:
    lines = text.splitlines(keepends=True)
    del lines[draw.randrange(len(lines))]
    return "".join(lines)


def repeat_line(text: str, draw: Random) -> str:
    lines = text.splitlines(keepends=True)
    line = draw.choice(lines)
    lines.insert(draw.randrange(len(lines) + 1), line)
    return "".join(lines)


def swap_lines(text: str, draw: Random) -> str:
    lines = text.splitlines(keepends=True)
    a, b = (draw.randrange(len(lines)) for _ in range(2))
    lines[a], lines[b] = lines[b], lines[a]
    return "".join(lines)


def blank_line(text: str, draw: Random) -> str:
    """In place of a line, or between two."""
    lines = text.splitlines(keepends=True)
    width = lines[0].count(",")
    place = draw.randrange(len(lines))
    blanks = ["\n", "\n", " \n", "," * width + "\n", "NA\n", ",".join(["NA"] * (width + 1)) + "\n"]
    lines[place : place + draw.randrange(2)] = [draw.choice([*blanks, "# comment\n", ",\n"])]
    return "".join(lines)


def cut_line(text: str, draw: Random) -> str:
    lines = text.splitlines(keepends=True)
    place = draw.randrange(len(lines))
    line = lines[place]
    end = draw.choice(["\n", "\n", ""])
    lines[place] = line[: draw.randrange(len(line))] + end
    return "".join(lines)


def other_delimiter(text: str, draw: Random) -> str:
    return text.replace(",", draw.choice([";", "\t", " ", ", ", " ,", "|", ",,"]))


def decimal_comma(text: str, _: Random) -> str:
    return text.replace(",", ";").replace(".", ",")


def other_breaks(text: str, draw: Random) -> str:
    lines = text.splitlines()
    if draw.random() < 0.5:
        return draw.choice(_BREAKS).join([*lines, ""])
    place = draw.randrange(len(lines))
    return "".join(
        line + (draw.choice(_BREAKS) if i == place else "\n") for i, line in enumerate(lines)
    )


def no_last_break(text: str, _: Random) -> str:
    return text.rstrip("\r\n")


TEXT = (
    *(change_cell, change_cell, change_cell, copy_cell, decorate_cell, decorate_cell),
    *(rename_column, rename_column, swap_names, number_names, add_index),
    *(delete_cell, repeat_cell, delete_column, repeat_column, swap_columns),
    *(delete_line, repeat_line, swap_lines, blank_line, blank_line, cut_line),
    *(other_delimiter, decimal_comma, other_breaks, no_last_break),
)


def encoded(text: str, draw: Random) -> bytes:
    """As a file that is nearly always UTF-8."""
    if draw.random() < 0.95:
        return text.encode("utf-8", "surrogatepass")
    code = draw.choice(["utf-16", "utf-8-sig", "utf-16-le", "utf-32", "latin-1", "utf-7"])
    return text.encode(code, "replace")


def _rows(text: str) -> list[list[str]]:
    return [line.split(",") for line in text.splitlines()]


def _cell(text: str, draw: Random) -> tuple[list[list[str]], int, int]:
    rows = _rows(text)
    line = draw.randrange(len(rows))
    return rows, line, draw.randrange(len(rows[line]))


def _joined(rows: list[list[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in rows)
