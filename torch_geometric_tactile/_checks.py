r"""The one guard of values that somebody gives."""


def need(condition: object, message: str, *value: object) -> None:
    r"""Raises a :class:`ValueError` unless a condition holds: what must be, and the value it is.

    Examples:
        >>> k = 0
        >>> need(k > 0, "'k' must be positive", k)
        Traceback (most recent call last):
        ValueError: 'k' must be positive (got 0)
    """
    if not condition:
        raise ValueError(f"{message} (got {value[0]})" if value else message)
