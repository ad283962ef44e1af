r"""The score that led to the selection of a model."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

_MAX_CHARACTERS = 200  # characters


@dataclass(frozen=True)
class MeasuredScore:
    r"""The score of a model on held-out samples. ``tactile compare`` measures it before the final
    model is trained on all samples. It is saved with a predictor.

    Args:
        model (str): Name of the model in the comparison.
        metric (str): Name of the score.
        mean (float): Mean over the splits.
        sd (float, optional): Standard deviation over the splits; :obj:`None` for a single split.
        num_splits (int): Number of splits.
        protocol (str): Description of the splits, such as :obj:`"5 folds by trial"`.
        trained_on (str): Description of the samples on which the saved model was trained.

    Raises:
        ValueError: If a value has the wrong type, or a text is longer than 200 characters.

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
            if not isinstance(text, str) or len(text) > _MAX_CHARACTERS:
                raise ValueError(
                    f"'{name}' must be a text with up to {_MAX_CHARACTERS} characters (got "
                    f"{text!r:.80})"
                )
        for name, number in (("mean", self.mean), ("sd", 0.0 if self.sd is None else self.sd)):
            if not isinstance(number, float) or not math.isfinite(number):
                raise ValueError(f"'{name}' must be a number (got {number!r:.80})")
        if type(self.num_splits) is not int or self.num_splits < 1:
            raise ValueError(f"'num_splits' must be at least 1 (got {self.num_splits!r:.80})")

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Returns a score from the mapping that :meth:`to_dict` returned.

        Args:
            content (Mapping): The arguments by name.
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
