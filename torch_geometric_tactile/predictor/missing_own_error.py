r"""The error for a missing user's model or transform that a file needs."""


class MissingOwnError(ValueError):
    r"""An error that is raised if a file needs the user's own model or transform and it was not
    passed.

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
