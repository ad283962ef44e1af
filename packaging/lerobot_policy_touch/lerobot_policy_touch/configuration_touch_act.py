"""The configuration of ACT with a token of touch."""

import json
from dataclasses import dataclass, field
from math import prod
from pathlib import Path

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig


@PreTrainedConfig.register_subclass("touch_act")
@dataclass
class TouchACTConfig(ACTConfig):
    """Configures ACT with a token of touch, which takes the place of the environment's state.

    Args:
        layout: The name of a stock layout, or the path of a layout file, whose content a saved
            configuration holds. Readings must be in the order of its taxels.
        touch_key: The feature with the readings: ``observation.tactile``, or
            ``observation.tactile_frames`` with all frames since the last step.
        touch_channels: Channels of each taxel, such as 3 axes. Defaults to those that one frame a
            step has.
        touch_steps: Steps of touch that the token depends on.
        touch_features: Size of the token.
        taxel_dropout: Probability of dropping a taxel in training.
    """

    layout: str = ""
    touch_key: str = "observation.tactile"
    touch_channels: int | None = None
    touch_steps: int = 8
    touch_features: int = 64
    taxel_dropout: float = 0.1
    # LeRobot does not normalise touch: the encoder has one scale for each channel, and a reading of
    # zero stays the rest of the sensor.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            **dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.MEAN_STD),
            "ENV": NormalizationMode.IDENTITY,
        }
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.touch_steps < 1:
            raise ValueError(f"'touch_steps' must be at least 1 (got {self.touch_steps})")
        if self.layout.endswith(".json"):  # the file may not exist where the policy is loaded
            self.layout = json.dumps(json.loads(Path(self.layout).read_text(encoding="utf-8")))

    @property
    def observation_delta_indices(self) -> list[int]:
        """The steps of all observations; of others than touch, the policy uses the last."""
        return list(range(1 - self.touch_steps, 1))

    @property
    def env_state_feature(self) -> PolicyFeature:
        """The token of touch."""
        return PolicyFeature(type=FeatureType.ENV, shape=(self.touch_features,))

    def validate_features(self) -> None:
        """Checks that the data set has the feature with the readings."""
        features = self.input_features or {}
        if self.touch_key not in features:
            raise ValueError(
                f"'touch_key' must be a feature of the data set (got '{self.touch_key}', which has "
                f"{sorted(features)}): write touch with torch_geometric_tactile.io.write_lerobot "
                "or add_to_lerobot"
            )
        features[self.touch_key] = PolicyFeature(FeatureType.ENV, features[self.touch_key].shape)

    def touch_shape(self, num_taxels: int) -> tuple[int, int]:
        """Returns the shape (N, C) of one frame of touch."""
        size = prod((self.input_features or {})[self.touch_key].shape)
        channels = self.touch_channels or size // num_taxels
        if channels < 1 or size % (num_taxels * channels):
            raise ValueError(
                f"'{self.touch_key}' must have a multiple of {num_taxels} taxels times {channels} "
                f"channels (got {size} values): choose another 'layout' or 'touch_channels'"
            )
        return num_taxels, channels
