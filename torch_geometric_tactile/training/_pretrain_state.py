r"""The file from which an interrupted pretraining goes on."""

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch.nn import Module
from torch.optim import Optimizer

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.predictor._tensor_file import read_tensors, write_tensors

_KEY = "torch_geometric_tactile.pretraining"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of AdamW


class PretrainState:
    r"""Weights, moments of the optimizer and state of the draws, in one file that runs no code."""

    def __init__(self, path: PathLike | None, identity: str) -> None:
        self.path = None if path is None else Path(path)
        self.identity = identity

    def restored(
        self, modules: Mapping[str, Module], optimizer: Optimizer, draw: torch.Generator
    ) -> tuple[int, int | None, float]:
        r"""Takes over what the file has, if there is one, and returns how many steps were made and
        planned, and the seconds that they took.
        """
        if self.path is None or not self.path.is_file():
            return 0, None, 0.0
        try:
            tensors, texts, _ = read_tensors(self.path)
            told = json.loads(texts[_KEY])
        except (KeyError, ValueError) as error:
            raise ValueError(
                f"'{self.path}' is no checkpoint of a pretraining that can be read ({error}): "
                "delete it to begin anew"
            ) from error
        if told["identity"] != self.identity:
            raise ValueError(
                f"'{self.path}' is the checkpoint of a pretraining with other data or settings: "
                "give those to go on, or delete it to begin anew"
            )
        for name, module in modules.items():
            state = {key: tensors[f"{name}.{key}"] for key in module.state_dict()}
            module.load_state_dict(state)
        for i, weight in enumerate(_weights(optimizer)):
            optimizer.state[weight] = {key: tensors[f"moments.{i}.{key}"] for key in _MOMENTS}
        draw.set_state(tensors["draw"])
        return told["step"], told["steps"], told["seconds"]

    def write(
        self,
        modules: Mapping[str, Module],
        optimizer: Optimizer,
        draw: torch.Generator,
        step: int,
        steps: int,
        seconds: float,
    ) -> None:
        r"""Writes the file, whole or not at all."""
        if self.path is None:
            return
        tensors = {
            f"{name}.{key}": value
            for name, module in modules.items()
            for key, value in module.state_dict().items()
        }
        for i, weight in enumerate(_weights(optimizer)):
            tensors |= {f"moments.{i}.{key}": optimizer.state[weight][key] for key in _MOMENTS}
        tensors["draw"] = draw.get_state()
        told = {"identity": self.identity, "step": step, "steps": steps, "seconds": seconds}
        write_tensors(tensors, {_KEY: json.dumps(told)}, self.path)

    def remove(self) -> None:
        r"""Removes the file."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def _weights(optimizer: Optimizer) -> list[torch.Tensor]:
    return [weight for group in optimizer.param_groups for weight in group["params"]]
