r"""The one guard of values that somebody gives."""

from collections.abc import Mapping


class Argument(str):
    r"""The name of an argument in the text of an :class:`ArgumentError`."""


class ArgumentError(ValueError):
    r"""A :class:`ValueError` that knows which words of its text are names of arguments, so that a
    command can put the names of its options in their place.

    Args:
        *parts (str): The parts of the text in their order. Each :class:`Argument` among them is
            shown in quotes.

    Examples:
        >>> error = ArgumentError(Argument("folds"), " must be at least 2 (got 1 in 'folds')")
        >>> str(error)
        "'folds' must be at least 2 (got 1 in 'folds')"
        >>> error.renamed({"folds": "--folds"})
        "'--folds' must be at least 2 (got 1 in 'folds')"
    """

    def __init__(self, *parts: str) -> None:
        super().__init__(*parts)
        self.parts = parts

    def __str__(self) -> str:
        return self.renamed({})

    @property
    def argument(self) -> str | None:
        r"""The first argument that the text names."""
        return next((str(part) for part in self.parts if isinstance(part, Argument)), None)

    def renamed(self, options: Mapping[str, str]) -> str:
        r"""Returns the text with other names of arguments.

        Args:
            options (Mapping): The other names, by the names of the arguments.
        """
        return "".join(
            f"'{options.get(part, part)}'" if isinstance(part, Argument) else part
            for part in self.parts
        )


def with_context(text: str, error: ValueError) -> ValueError:
    r"""Returns an error with more text before its own, such as the name of a file.

    Examples:
        >>> with_context("'a.npz': ", ValueError("it is empty"))
        ValueError("'a.npz': it is empty")
    """
    if isinstance(error, ArgumentError):
        return ArgumentError(text, *error.parts)
    return ValueError(f"{text}{error}")


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


def need_argument(condition: object, argument: str, message: str, *value: object) -> None:
    r"""Raises an :class:`ArgumentError` unless a condition holds: which argument must be what, and
    the value it is.

    Examples:
        >>> need_argument(False, "k", "must be positive", 0)
        Traceback (most recent call last):
        torch_geometric_tactile._checks.ArgumentError: 'k' must be positive (got 0)
    """
    if not condition:
        text = f" {message} (got {value[0]})" if value else f" {message}"
        raise ArgumentError(Argument(argument), text)
