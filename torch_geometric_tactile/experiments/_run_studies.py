r"""Building and running studies."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch_geometric_tactile.experiments._building import build
from torch_geometric_tactile.experiments.studies import Study, Trained


def build_studies(contents: Sequence[Mapping[str, Any]]) -> list[Study]:
    r"""Returns studies.

    Args:
        contents (sequence of Mapping): Each as :obj:`{"class_path", "init_args"}`.

    Raises:
        ValueError: If a class cannot be imported, has no such argument or is no study.
    """
    studies = [build(content) for content in contents]
    for content, study in zip(contents, studies, strict=True):
        if not isinstance(study, Study):
            raise ValueError(f"'studies' must hold studies (got '{content.get('class_path')}')")
    return studies


def run_studies(studies: Sequence[Study], trained: Trained) -> dict[str, Any]:
    r"""Returns what each study finds, by the name of its class.

    Args:
        studies (sequence of Study): The studies.
        trained (Trained): The model and its samples.
    """
    found = {type(study).__name__: study.measure(trained) for study in studies}
    return {name: result for name, result in found.items() if result is not None}
