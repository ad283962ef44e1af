"""Small chains of joints, joint angles and URDF texts."""

import math

import torch

from torch_geometric_tactile.sensors import Joint

# Two hinges: the forearm turns about z, the finger 1 m further out about y.
CHAIN = (
    Joint("elbow", "base", "arm", axis=(0, 0, 1), lower=-1.0, upper=1.0),
    Joint("knuckle", "arm", "finger", xyz=(1, 0, 0), axis=(0, 2, 0)),
    Joint("nail", "finger", "tip", xyz=(0.5, 0, 0), rpy=(0, 0, math.pi / 2)),
)


def angles(*shape, dtype=torch.double, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=dtype) * 1.5 - 0.2


def urdf(joints, name="hand"):
    """A URDF file's text."""

    def numbers(values):
        return " ".join(map(repr, values))

    links = dict.fromkeys(link for joint in joints for link in (joint.parent, joint.child))
    lines = [f'<link name="{link}"/>' for link in links]
    for joint in joints:
        kind = "fixed" if joint.axis is None else "revolute"
        lines += [
            f'<joint name="{joint.name}" type="{kind}">',
            f'<parent link="{joint.parent}"/><child link="{joint.child}"/>',
            f'<origin xyz="{numbers(joint.xyz)}" rpy="{numbers(joint.rpy)}"/>',
        ]
        if joint.axis is not None:
            lines.append(f'<axis xyz="{numbers(joint.axis)}"/>')
            lines.append(
                f'<limit lower="{joint.lower}" upper="{joint.upper}" effort="1" velocity="1"/>'
            )
        lines.append("</joint>")
    body = "\n".join(lines)
    return f'<?xml version="1.0" encoding="utf-8"?>\n<robot name="{name}">\n{body}\n</robot>\n'
