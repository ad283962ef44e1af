r"""One colour for each digit and patch, the same in all pictures."""

from typing import Literal

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.visualization._style import current_theme

_ORDER = (0, 2, 3, 1, None, 4, 5)  # of the palette; palms are grey


def digit_color(digit: int) -> str:
    r"""Returns the colour of a digit, the same in all pictures."""
    look = current_theme()
    place = _ORDER[digit % len(_ORDER)]
    return "#8a8f96" if place is None else look.palette[place]


def segment_colors(
    layout: TaxelLayout, by: Literal["patch", "digit"]
) -> list[tuple[float, float, float]]:
    r"""Returns the colour of each taxel: that of its digit, or its patch's tint of it."""
    from matplotlib.colors import to_rgb

    digits = layout.segments("digit").tolist()
    patches = layout.segments("patch").tolist()
    base = [to_rgb(digit_color(digit)) for digit in digits]
    if by == "digit":
        return base
    first: dict[int, list[int]] = {}
    for digit, patch in dict.fromkeys(zip(digits, patches, strict=True)):
        first.setdefault(digit, []).append(patch)
    colors = []
    ground = to_rgb(current_theme().ground)
    for color, digit, patch in zip(base, digits, patches, strict=True):
        # Towards the page, with every second patch far ahead, so that neighbours differ.
        number = first[digit].index(patch)
        tint = 0.55 * (number % 2) + 0.3 * number / len(first[digit])
        red, green, blue = (c + (g - c) * tint for c, g in zip(color, ground, strict=True))
        colors.append((red, green, blue))
    return colors
