"""Draws docs/images/pipeline.svg: from a recording to the robot.

Examples:
    python docs/images/draw_pipeline.py docs/images/pipeline.svg
"""

import itertools
import math
import sys
from pathlib import Path

WIDTH, HEIGHT, BOX, GAP = 880, 218, 156, 14
BLUE, ORANGE, GREEN, INK, PALE = "#0072B2", "#D55E00", "#009E73", "#1f2933", "#8a97a6"
STEPS = (
    ("Recording", ("CSV, HDF5, MCAP, npz,", "XELA, serial, LeRobot"), "read_recording"),
    ("Layout", ("where each taxel is:", "12 to 1,024 taxels"), "TaxelLayout"),
    ("Graph", ("ordinary PyG Data;", "one topology, fast"), "StaticDataset"),
    ("Model", ("ours, five papers', plain", "ones; honest splits"), "TaxelNet, compare"),
    ("Robot", ("one file, also ONNX;", "2 ms frame to label"), "tactile live"),
)


def wave(x: float, y: float) -> str:
    """Three signals over time."""
    lines = []
    for k, color in enumerate((BLUE, ORANGE, GREEN)):
        points = (
            f"{x + 2 * i:.1f},{y + 17 * k + 8 - 11 / (1 + math.exp(-(i - 18 - 5 * k) / 2)):.1f}"
            for i in range(53)
        )
        line = " ".join(points)
        lines.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="2"/>')
    return "".join(lines)


def dots(x: float, y: float, touched: bool, joined: bool) -> str:
    """Taxels of a fingertip, with or without edges."""
    places = [(24 * c + (12 if r % 2 else 0), 17 * r) for r in range(3) for c in range(4 - r % 2)]
    places = [(x + 16 + a, y + 4 + b) for a, b in places]
    lines = [
        f'<line x1="{a[0]}" y1="{a[1]}" x2="{b[0]}" y2="{b[1]}" stroke="{PALE}"/>'
        for i, a in enumerate(places)
        for b in places[:i]
        if joined and math.dist(a, b) < 26
    ]
    colors = {4: ORANGE, 5: ORANGE, 8: ORANGE} if touched else {}
    return "".join(lines) + "".join(
        f'<circle cx="{a}" cy="{b}" r="5" fill="{colors.get(i, BLUE)}"/>'
        for i, (a, b) in enumerate(places)
    )


def layers(x: float, y: float) -> str:
    """Layers of a network that narrow to two answers."""
    columns = ((4, 0), (4, 36), (3, 72), (2, 104))
    places = [[(x + dx, y + 21 + 14 * (k - (n - 1) / 2)) for k in range(n)] for n, dx in columns]
    lines = [
        f'<line x1="{a}" y1="{b}" x2="{c}" y2="{d}" stroke="{PALE}" stroke-width="0.7"/>'
        for left, right in itertools.pairwise(places)
        for a, b in left
        for c, d in right
    ]
    circles = [
        f'<circle cx="{a}" cy="{b}" r="4" fill="{GREEN if i == 3 else BLUE}"/>'
        for i, column in enumerate(places)
        for a, b in column
    ]
    return "".join(lines + circles)


def answer(x: float, y: float) -> str:
    """Bars of two probabilities."""
    rows = (("slip", 0.93, ORANGE), ("hold", 0.07, BLUE))
    return "".join(
        f'<text x="{x}" y="{y + 13 + 24 * i}" class="label">{name}</text>'
        f'<rect x="{x + 32}" y="{y + 3 + 24 * i}" width="{max(3, 74 * share):.0f}" height="12" '
        f'rx="2" fill="{color}"/>'
        for i, (name, share, color) in enumerate(rows)
    )


def main() -> None:
    """Writes the file that the command line names."""
    pictures = (
        wave,
        lambda x, y: dots(x, y, False, False),
        lambda x, y: dots(x, y, True, True),
        layers,
        answer,
    )
    parts = []
    for i, ((title, lines, code), picture) in enumerate(zip(STEPS, pictures, strict=True)):
        x = 22 + i * (BOX + GAP)
        middle = x + BOX / 2
        parts.append(
            f'<rect x="{x}" y="20" width="{BOX}" height="178" rx="10" fill="#f4f7fa" '
            'stroke="#d5dde5"/>'
            f'<text x="{middle}" y="48" class="title">{title}</text>'
            + picture(x + 26, 64)
            + "".join(
                f'<text x="{middle}" y="{140 + 15 * k}" class="line">{line}</text>'
                for k, line in enumerate(lines)
            )
            + f'<text x="{middle}" y="184" class="code">{code}</text>'
        )
        if i + 1 < len(STEPS):
            a = x + BOX + 1
            parts.append(f'<path d="M{a},104 l{GAP - 2},5 l-{GAP - 2},5 z" fill="{INK}"/>')
    style = (
        "text{font-family:system-ui,-apple-system,'Segoe UI',sans-serif;fill:" + INK + "}"
        ".title{font-size:17px;font-weight:600;text-anchor:middle}"
        ".line{font-size:11.5px;text-anchor:middle}.label{font-size:12px}"
        f".code{{font:11.5px ui-monospace,Menlo,monospace;fill:{BLUE};text-anchor:middle}}"
    )
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        f'height="{HEIGHT}" role="img" aria-label="Recording, layout, graph, model, robot">'
        f"<style>{style}</style>"
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="12" fill="#ffffff"/>{"".join(parts)}</svg>\n'
    )
    Path(sys.argv[1]).write_text(text)


if __name__ == "__main__":
    main()
