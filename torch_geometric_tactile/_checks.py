r"""Argument checks whose errors name the argument."""

from collections.abc import Mapping, Sequence


class Argument(str):
    r"""The name of an argument in the text of an :class:`ArgumentError`."""


class ArgumentError(ValueError):
    r"""A :class:`ValueError` that marks the names of arguments in its text, so that a command can
    replace them by the names of its options.

    Args:
        *parts (str): The parts of the text, in order. An :class:`Argument` is shown in quotes.

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
        r"""The first argument in the text, or :obj:`None` if there is none."""
        return next((str(part) for part in self.parts if isinstance(part, Argument)), None)

    def renamed(self, options: Mapping[str, str]) -> str:
        r"""Returns the text with the names of arguments replaced.

        Args:
            options (Mapping): Maps the name of an argument to the name that replaces it.
        """
        return "".join(
            f"'{options.get(part, part)}'" if isinstance(part, Argument) else part
            for part in self.parts
        )


class GroupedError(ValueError):
    r"""Several errors in one, such as the errors of all files in a folder.

    Args:
        summary (str): A summary of the errors.
        errors (sequence of Exception): The errors.

    Examples:
        >>> str(GroupedError("2 of 9 files are invalid", [ValueError("a"), ValueError("b")]))
        '2 of 9 files are invalid: 1. a; 2. b'
    """

    def __init__(self, summary: str, errors: Sequence[Exception]) -> None:
        super().__init__(summary, errors)
        self.summary = summary
        self.errors = errors

    def __str__(self) -> str:
        texts = [f"{i}. {error}" for i, error in enumerate(self.errors, 1)]
        return f"{self.summary}: {'; '.join(texts)}"

    def renamed(self, options: Mapping[str, str]) -> "GroupedError":
        r"""Returns the errors with the names of arguments replaced."""
        return GroupedError(
            self.summary,
            [
                ValueError(error.renamed(options)) if isinstance(error, ArgumentError) else error
                for error in self.errors
            ],
        )


def with_context(prefix: str, error: ValueError) -> ValueError:
    r"""Returns an error with a prefix before its text, such as the name of a file.

    Examples:
        >>> with_context("'a.npz': ", ValueError("it is empty"))
        ValueError("'a.npz': it is empty")
    """
    if isinstance(error, ArgumentError):
        return ArgumentError(prefix, *error.parts)
    return ValueError(f"{prefix}{error}")


# `value` is variadic, because None is a valid value to show.
def need(condition: object, message: str, *value: object) -> None:
    r"""Raises a :class:`ValueError` with a message and the actual value unless a condition holds.

    Examples:
        >>> k = 0
        >>> need(k > 0, "'k' must be positive", k)
        Traceback (most recent call last):
        ValueError: 'k' must be positive (got 0)
    """
    if not condition:
        raise ValueError(f"{message} (got {value[0]})" if value else message)


def need_argument(condition: object, argument: str, message: str, *value: object) -> None:
    r"""Raises an :class:`ArgumentError` with the argument, a message and the actual value unless a
    condition holds.

    Examples:
        >>> need_argument(False, "k", "must be positive", 0)
        Traceback (most recent call last):
        torch_geometric_tactile._checks.ArgumentError: 'k' must be positive (got 0)
    """
    if not condition:
        text = f" {message} (got {value[0]})" if value else f" {message}"
        raise ArgumentError(Argument(argument), text)
