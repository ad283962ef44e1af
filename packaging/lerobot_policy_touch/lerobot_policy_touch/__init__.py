"""ACT with a token of touch: a policy of LeRobot, chosen by ``--policy.type=touch_act``."""

from lerobot_policy_touch.configuration_touch_act import TouchACTConfig
from lerobot_policy_touch.modeling_touch_act import TouchACTPolicy
from lerobot_policy_touch.processor_touch_act import make_touch_act_pre_post_processors

__all__ = ["TouchACTConfig", "TouchACTPolicy", "make_touch_act_pre_post_processors"]
