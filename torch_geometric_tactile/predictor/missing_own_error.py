r"""The error of a class of the user's own that must be given."""


class MissingOwnError(ValueError):
    r"""Raised when a model or transform that the user wrote must be passed and was not.

    Args:
        text (str): The message.
        argument (str): What must be given: :obj:`"model"` or :obj:`"transforms"`.

    Examples:
        >>> error = MissingOwnError("pass the model that the predictor was saved with", "model")
        >>> error.argument
        'model'
    """

    def __init__(self, text: str, argument: str) -> None:
        super().__init__(text)
        self.argument = argument
