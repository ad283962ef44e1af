r"""One colour for each digit and patch, the same in all pictures."""

from typing import Literal

from torch_geometric_tactile.sensors import TaxelLayout

# Of Okabe and Ito: told apart with any colour vision.
DIGIT_COLORS = ("#0072b2", "#009e73", "#cc79a7", "#d55e00", "#8a8a8a", "#56b4e9", "#f0e442")


def segment_colors(
    layout: TaxelLayout, by: Literal["patch", "digit"]
) -> list[tuple[float, float, float]]:
    r"""Returns the colour of each taxel: that of its digit, or its patch's tint of it.

    Args:
        layout (TaxelLayout): The layout.
        by (str): Which taxels share a colour, those of a :obj:`"patch"` or of a :obj:`"digit"`.
    """
    from matplotlib.colors import to_rgb

    digits = layout.segments("digit").tolist()
    patches = layout.segments("patch").tolist()
    base = [to_rgb(DIGIT_COLORS[digit % len(DIGIT_COLORS)]) for digit in digits]
    if by == "digit":
        return base
    first: dict[int, list[int]] = {}
    for digit, patch in dict.fromkeys(zip(digits, patches, strict=True)):
        first.setdefault(digit, []).append(patch)
    colors = []
    for (red, green, blue), digit, patch in zip(base, digits, patches, strict=True):
        # Towards white, with every second patch far ahead, so that neighbours differ.
        number = first[digit].index(patch)
        tint = 0.55 * (number % 2) + 0.3 * number / len(first[digit])
        colors.append(
            (red + (1 - red) * tint, green + (1 - green) * tint, blue + (1 - blue) * tint)
        )
    return colors
