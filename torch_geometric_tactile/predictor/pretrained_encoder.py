r"""The file of an encoder that was trained without labels."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from torch_geometric_tactile import __version__
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn.models import TaxelEncoder
from torch_geometric_tactile.predictor._plain_data import load_weights
from torch_geometric_tactile.predictor._tensor_file import explained, read_tensors, write_tensors
from torch_geometric_tactile.predictor.content import build_model, model_entry
from torch_geometric_tactile.sensors import TaxelLayout

_KEY = "torch_geometric_tactile.encoder"
_FORMAT = 1
_WEIGHT = "model."
_AT_ONCE = 1 << 18  # readings
# What a file says that it was trained on, each a number or a text.
_TOLD = (int, float, str, type(None))


class PretrainedEncoder:
    r"""A :class:`~torch_geometric_tactile.nn.models.TaxelEncoder` with the layout of its sensor and
    what it was trained on, in one file that runs no code. It takes raw readings, as the recordings
    had them that it was trained on.

    Args:
        model (TaxelEncoder): The encoder.
        layout (TaxelLayout): The layout that it was trained on.
        trained_on (Mapping): What it was trained on: numbers and texts by name, such as
            :obj:`num_trials`.

    Raises:
        ValueError: If the encoder has another number of taxels.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac_sp
        >>> encoder = PretrainedEncoder(TaxelEncoder("biotac_sp", 1, in_channels=1), biotac_sp())
        >>> encoder
        PretrainedEncoder('biotac_sp', num_taxels=24, num_channels=1, embedding_channels=128)
        >>> encoder.embed(torch.zeros(5, 24, 1)).shape
        torch.Size([5, 128])
    """

    def __init__(
        self,
        model: TaxelEncoder,
        layout: TaxelLayout,
        trained_on: Mapping[str, Any] | None = None,
    ) -> None:
        if model.num_nodes != layout.num_taxels:
            raise ValueError(
                f"'layout' must have the {model.num_nodes} taxels of the encoder (got "
                f"{layout.num_taxels})"
            )
        self.model = model.eval()
        self.layout = layout
        self.trained_on = dict(trained_on or {})

    @property
    def num_channels(self) -> int:
        r"""The number of channels of a taxel."""
        return self.model.in_channels

    def embed(self, x: Tensor) -> Tensor:
        r"""Returns the features of many samples, part by part, without gradients.

        Args:
            x (torch.Tensor): Readings :math:`(B, N, C)`; missing ones are NaN.
        """
        at_once = max(1, _AT_ONCE // max(1, x[:1].numel()))
        x = x.to(self.model.scale.dtype)
        with torch.no_grad():
            found = [self.model.embed(part) for part in x.split(at_once)]
        return torch.cat(found) if found else x.new_zeros(0, self.model.embedding_channels)

    def check(self, layout: TaxelLayout, num_channels: int) -> None:
        r"""Checks that samples are of the taxels and channels that it was trained on.

        Args:
            layout (TaxelLayout): The layout of the samples.
            num_channels (int): Their number of channels.

        Raises:
            ValueError: If they are not; it says what it was trained on.
        """
        if num_channels != self.num_channels or not self.layout.matches(layout):
            raise ValueError(
                f"'encoder' must be of the sensor of the data, layout '{layout.name}' with "
                f"{layout.num_taxels} taxels of {num_channels} channels (got one of "
                f"{self.describe()}): pretrain one on recordings of this sensor"
            )

    def describe(self) -> str:
        r"""Returns in words what it was trained on."""
        told = "; ".join(f"{key.replace('_', ' ')} {value}" for key, value in self._told().items())
        size = f"layout '{self.layout.name}', {self.layout.num_taxels} taxels of"
        return f"{size} {self.num_channels} channels{': ' if told else ''}{told}"

    def _told(self) -> dict[str, Any]:
        return {key: value for key, value in self.trained_on.items() if value is not None}

    def save(self, path: PathLike) -> None:
        r"""Writes it to a file, whole or not at all.

        Args:
            path (str or PathLike): The file.
        """
        entry = model_entry(self.model, self.layout)
        header = {
            "format": _FORMAT,
            "package": __version__,
            "layout": self.layout.to_dict(),
            "model": entry["description"],
            "trained_on": self.trained_on,
        }
        weights = {_WEIGHT + name: value for name, value in self.model.state_dict().items()}
        write_tensors({**entry["tensors"], **weights}, {_KEY: json.dumps(header)}, path)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads it from a file, of which nothing is run.

        Args:
            path (str or PathLike): The file.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged, or no encoder.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(
                f"there is no encoder '{path}'; write one with: tactile pretrain RECORDINGS --out "
                f"{path}"
            )
        with explained(f"'{path}' is no encoder that can be read here"):
            tensors, texts, has_checksum = read_tensors(path)
            need(_KEY in texts, "it is not a file of 'tactile pretrain'")
            need(has_checksum, "it must have a checksum (got none): it is damaged")
            header = json.loads(texts[_KEY])
            need(header.get("format") == _FORMAT, f"its format must be {_FORMAT}", header["format"])
            kind, told = header["model"].get("class"), header["trained_on"]
            need(kind == "TaxelEncoder", "its model must be a TaxelEncoder", str(kind)[:80])
            if not isinstance(told, dict) or not all(isinstance(v, _TOLD) for v in told.values()):
                raise ValueError("what it was trained on must be numbers and texts by name")
            layout = TaxelLayout.from_dict(header["layout"])
            own = {name: t for name, t in tensors.items() if not name.startswith(_WEIGHT)}
            weights = {n.removeprefix(_WEIGHT): t for n, t in tensors.items() if n not in own}
            entry = {"description": header["model"], "tensors": own}
            model: Any = build_model(entry, weights, layout)
            load_weights(model, weights)
            return cls(model, layout, told)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.layout.name}', num_taxels={self.layout.num_taxels}, "
            f"num_channels={self.num_channels}, "
            f"embedding_channels={self.model.embedding_channels})"
        )
