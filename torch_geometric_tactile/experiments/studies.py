r"""What else is looked at in a model of a table, while it trains and afterwards."""

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
    r"""A model after its training, and the samples as it sees them.

    Args:
        model (torch.nn.Module or sklearn.base.BaseEstimator): The model, in evaluation mode.
        train (StaticData): What it was trained on, scaled.
        test (StaticData): What was held out, scaled likewise.
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
        r"""Whether the model is a network, and no estimator of scikit-learn."""
        return isinstance(self.model, nn.Module)

    def logits(self, samples: StaticData, batch_size: int = 256) -> Tensor:
        r"""Returns what a network says of samples :math:`(S, C)`.

        Args:
            samples (StaticData): Some of :obj:`test`, or changed ones.
            batch_size (int): How many at a time.
        """
        names = input_names(self.model)
        out = []
        with torch.inference_mode():
            for rows in torch.arange(samples.num_samples).split(batch_size):
                batch = samples.index_select(rows)
                inputs = {name: getattr(batch, name) for name in names}
                out.append(call_model(self.model, batch, inputs))
        return torch.cat(out)


class Study:
    r"""The base class of what is looked at in a model beside its scores. It is built anew for each
    run, and its result is kept with the run.

    A subclass defines :meth:`measure`, and :meth:`callback` if it watches the training.
    """

    def callback(self, data: Any) -> "L.Callback | None":
        r"""Returns what watches the training of a network; nothing if there is no need.

        Args:
            data (TactileDataModule): The samples.
        """
        return None

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns what was found, as JSON values; nothing where the model has no such thing.

        Args:
            trained (Trained): The model and its samples.
        """
        raise NotImplementedError


class Confusion(Study):
    r"""Asks for the confusion of the classes, which the page draws from what the model said of the
    samples of all folds.
    """

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns the names of the classes."""
        return {"class_names": list(trained.class_names)}
