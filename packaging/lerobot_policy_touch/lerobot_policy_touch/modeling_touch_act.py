"""ACT with a token of touch."""

import json
from collections import deque
from typing import Any

import torch
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from lerobot_policy_touch.configuration_touch_act import TouchACTConfig
from torch_geometric_tactile.nn import TouchEncoder
from torch_geometric_tactile.sensors import TaxelLayout, stock_layout

Batch = dict[str, Tensor]


class TouchACTPolicy(ACTPolicy):
    """ACT whose environment state is computed from the last steps of touch.

    On a robot, :meth:`select_action` holds the last steps itself. Before the first step, touch is
    that of the first, as at the start of an episode in LeRobot's data sets.
    """

    config_class = TouchACTConfig
    name = "touch_act"

    def __init__(self, config: TouchACTConfig, **kwargs: Any) -> None:
        super().__init__(config, **kwargs)
        layout = _read_layout(config.layout)
        self.touch_shape = config.touch_shape(layout.num_taxels)
        self.encoder = TouchEncoder(
            layout,
            config.touch_features,
            in_channels=self.touch_shape[1],
            taxel_dropout=config.taxel_dropout,
        )

    def reset(self) -> None:
        """Forgets actions and touch of the last episode."""
        super().reset()
        self._touch: deque[Tensor] = deque(maxlen=self.config.touch_steps)

    @torch.no_grad()
    def select_action(self, batch: Batch) -> Tensor:
        """Returns the action (B, A) for the observation of one step."""
        key = self.config.touch_key
        # LeRobot's pre-processor adds a batch dimension to states and images only.
        touch = batch[key].unsqueeze(0) if batch[key].dim() == 1 else batch[key]
        self._touch.extend([touch] * (1 if self._touch else self.config.touch_steps))
        return super().select_action({**batch, key: torch.stack([*self._touch], dim=1)})

    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch) -> Tensor:
        """Returns the next actions (B, S, A) for the last steps of touch (B, T, R * N * C)."""
        self.eval()
        return super().predict_action_chunk(self._encode(batch))

    def forward(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """Returns the loss of a batch, and its parts."""
        batch = self._encode(batch)
        if batch[ACTION].dim() == 2:  # LeRobot's data sets have one number a step as (B, S)
            batch[ACTION] = batch[ACTION].unsqueeze(-1)
        return super().forward(batch)

    def _encode(self, batch: Batch) -> Batch:
        # Returns the batch with the token of touch, and with the last step of all else.
        touch = batch[self.config.touch_key]
        touch = touch.reshape(len(touch), -1, *self.touch_shape)  # the frames of all steps
        batch = dict(batch)
        for name, feature in self.config.input_features.items():
            if name in batch and name != self.config.touch_key:
                batch[name] = batch[name].reshape(len(touch), -1, *feature.shape)[:, -1]
        batch[OBS_ENV_STATE] = self.encoder(touch)
        batch.setdefault(OBS_STATE, batch[OBS_ENV_STATE])  # ACT asks it for the device
        return batch


def _read_layout(layout: str) -> TaxelLayout:
    if layout.startswith("{"):
        return TaxelLayout.from_dict(json.loads(layout))
    if not layout:
        raise ValueError(
            "'layout' must be the name of a stock layout or a layout file, such as "
            "--policy.layout=allegro_uskin (got none)"
        )
    return stock_layout(layout)
