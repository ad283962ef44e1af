r"""How numbers and metrics are written."""

import math

NAMES = {
    "accuracy": "accuracy",
    "balanced_accuracy": "balanced accuracy",
    "f1": "macro F1",
    "mae": "MAE",
    "rmse": "RMSE",
    "r2": "R2",
}


_PERCENT = ("accuracy", "balanced_accuracy", "f1")


def shown_number(metric: str, value: float) -> str:
    r"""Returns a score as text, in percent where that is usual.

    Examples:
        >>> shown_number("accuracy", 0.918), shown_number("mae", 0.00435)
        ('91.8', '0.00435')
    """
    if math.isnan(value):
        return "?"
    text = f"{100 * value:.1f}" if metric in _PERCENT else f"{value:.3g}"
    return text.removeprefix("-") if not float(text) else text  # not "-0.0"
