r"""Error of a model or transform of the user that a file needs and that was not passed."""


class MissingOwnError(ValueError):
    r"""Raised if a file needs a model or transform that the user wrote and that was not passed.

    Args:
        text (str): The message.
        argument (str): The missing argument: :obj:`"model"` or :obj:`"transforms"`.

    Examples:
        >>> error = MissingOwnError("pass the model that the predictor was saved with", "model")
        >>> error.argument
        'model'
    """

    def __init__(self, text: str, argument: str) -> None:
        super().__init__(text)
        self.argument = argument
