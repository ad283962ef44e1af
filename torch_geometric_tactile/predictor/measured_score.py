r"""The score that a model was chosen for."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

_LONGEST = 200  # characters


@dataclass(frozen=True)
class MeasuredScore:
    r"""What models of one kind scored on held-out samples, as ``tactile compare`` measures it,
    before one was trained on all samples. It goes into the file of a predictor.

    Args:
        model (str): Name of the model in the comparison.
        metric (str): Name of the score.
        mean (float): Mean over the splits.
        sd (float, optional): Standard deviation over the splits; :obj:`None` of one.
        num_splits (int): Number of splits.
        protocol (str): What was held out.
        trained_on (str): What the model in the file was trained on.

    Raises:
        ValueError: If a value is of another type, or a text is longer than 200 characters.

    Examples:
        >>> print(MeasuredScore("svm_rbf", "accuracy", 0.9583, 0.02, 5, "5 folds by trial", "all"))
        svm_rbf: accuracy 0.958 ± 0.02 over 5 splits (5 folds by trial); trained on all
    """

    model: str
    metric: str
    mean: float
    sd: float | None
    num_splits: int
    protocol: str
    trained_on: str

    def __post_init__(self) -> None:
        for name in ("model", "metric", "protocol", "trained_on"):
            text = getattr(self, name)
            if not isinstance(text, str) or len(text) > _LONGEST:
                raise ValueError(
                    f"'{name}' must be a text of up to {_LONGEST} characters (got {text!r:.80})"
                )
        for name, number in (("mean", self.mean), ("sd", 0.0 if self.sd is None else self.sd)):
            if not isinstance(number, float) or not math.isfinite(number):
                raise ValueError(f"'{name}' must be a number (got {number!r:.80})")
        if type(self.num_splits) is not int or self.num_splits < 1:
            raise ValueError(f"'num_splits' must be at least 1 (got {self.num_splits!r:.80})")

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Builds it from what :meth:`to_dict` returns.

        Args:
            content (Mapping): The arguments.
        """
        names = [field.name for field in fields(cls)]
        if not isinstance(content, Mapping) or sorted(content) != sorted(names):
            raise ValueError(f"a score must have {', '.join(names)} (got {str(content)[:80]})")
        return cls(**content)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values."""
        return asdict(self)

    def __str__(self) -> str:
        spread = "" if self.sd is None else f" ± {self.sd:.2g}"
        splits = "1 split" if self.num_splits == 1 else f"{self.num_splits} splits"
        return (
            f"{self.model}: {self.metric} {self.mean:.3g}{spread} over {splits} ({self.protocol}); "
            f"trained on {self.trained_on}"
        )
