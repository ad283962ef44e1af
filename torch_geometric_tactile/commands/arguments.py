r"""Types of arguments that several verbs share."""

import argparse


def positive(text: str) -> int:
    r"""Returns an integer of at least one.

    Args:
        text (str): What the user wrote.

    Raises:
        argparse.ArgumentTypeError: If the number is below one.
    """
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1 (got {number})")
    return number


def not_negative(text: str) -> int:
    r"""Returns an integer of at least zero.

    Args:
        text (str): What the user wrote.

    Raises:
        argparse.ArgumentTypeError: If the number is negative.
    """
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must not be negative (got {number})")
    return number


def add_allow(parser: argparse.ArgumentParser) -> None:
    r"""Adds the option for classes of one's own in the configuration beside a checkpoint.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "--allow",
        metavar="PACKAGE",
        action="append",
        default=[],
        help="a package, module or class of your own that the config.yaml beside the checkpoint "
        "may name; may be given again",
    )
