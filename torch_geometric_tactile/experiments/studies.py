r"""Studies: measurements on a trained model of a table beyond its scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn.models._calls import call_model, input_names
from torch_geometric_tactile.sensors import TaxelLayout

if TYPE_CHECKING:
    import lightning as L


@dataclass(frozen=True, eq=False)
class Trained:
    r"""A trained model and its transformed samples.

    Args:
        model (torch.nn.Module or sklearn.base.BaseEstimator): The model, in evaluation mode.
        train (StaticData): The training samples, after all transforms.
        test (StaticData): The test samples, after the same transforms.
        class_names (list of str): Names of the classes.
        layout (TaxelLayout): The taxels.
        seed (int): Seed of the run.
    """

    model: Any
    train: StaticData
    test: StaticData
    class_names: Sequence[str]
    layout: TaxelLayout
    seed: int = 0

    @property
    def is_network(self) -> bool:
        r"""Whether the model is a network, not an estimator of scikit-learn."""
        return isinstance(self.model, nn.Module)

    def logits(self, samples: StaticData, batch_size: int = 256) -> Tensor:
        r"""Returns the logits of a network for samples :math:`(S, C)`.

        Args:
            samples (StaticData): Transformed samples, such as :obj:`test`.
            batch_size (int): Number of samples in a batch.
        """
        names = input_names(self.model)
        logits = []
        with torch.inference_mode():
            for rows in torch.arange(samples.num_samples).split(batch_size):
                batch = samples.index_select(rows)
                inputs = {name: getattr(batch, name) for name in names}
                logits.append(call_model(self.model, batch, inputs))
        return torch.cat(logits)


class Study:
    r"""The base class of studies, which measure more than the scores of a model. Each run creates a
    new study object, and the result of the study is stored with the run.

    A subclass defines :meth:`measure`. If it observes the training, it also defines
    :meth:`callback`.
    """

    def callback(self, data: Any) -> "L.Callback | None":
        r"""Returns a callback that observes the training of a network, or :obj:`None`.

        Args:
            data (TactileDataModule): The samples.
        """
        return None

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns the result as JSON values, or :obj:`None` if the study does not apply to the
        model.

        Args:
            trained (Trained): The model and its samples.
        """
        raise NotImplementedError


class Confusion(Study):
    r"""A study that adds a confusion matrix to the report. The matrix is computed from the
    predictions for all folds.
    """

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns the class names."""
        return {"class_names": list(trained.class_names)}
