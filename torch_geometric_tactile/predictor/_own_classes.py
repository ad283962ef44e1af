r"""What a file says of a user's own classes."""

import inspect
from typing import Any


def describe_own(value: Any) -> dict[str, Any]:
    r"""Returns the name and the text of a user's own transform or model."""
    kind = type(value).__name__
    if inspect.isroutine(value):
        return {"own": kind, "text": value.__qualname__}
    is_told = type(value).__repr__ is not object.__repr__  # which tells an address
    return {"own": kind, "text": repr(value) if is_told else kind}
