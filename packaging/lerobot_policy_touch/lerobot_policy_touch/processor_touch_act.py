"""The processors of ACT, which LeRobot looks up by the name of the policy."""

from lerobot.policies.act.processor_act import make_act_pre_post_processors

make_touch_act_pre_post_processors = make_act_pre_post_processors
