r"""Seconds from joint angles to the 384 taxels of an Allegro hand: HandKinematics against a plain
loop of 4 x 4 matrices over the links, and against pytorch_kinematics where it is installed.

All work on the same frames; the taxels that come out of them are compared as well.

Examples:
    python benchmarks/kinematics.py
    python benchmarks/kinematics.py --frames 1000000 --threads 8 --device cuda
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from shared import parse, print_setting
from torch import Tensor

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin

_ALLOWED_DIFFERENCE = 1e-6  # metres, and parts of a unit normal; float32 holds a tenth of that
_PART = 4096  # frames that the other two work on at a time: all at once, they fill the memory


OPTIONS = {
    "--frames": (100_000, "frames of joint angles"),
    "--repeats": (3, "timed runs; the median counts"),
    "--seed": (0, "seed of the joint angles"),
    "--threads": (2, "threads that torch may use"),
    "--device": ("cpu", "where to compute, such as cuda"),
    "--at-most": (2.0, "how many seconds the positions of all frames may take for the exit code 0"),
}
EPILOG = (
    "The exit code is 0 if all yield the same numbers and positions take no longer than allowed, 1 "
    "if not, and 2 if an argument is wrong."
)
Links = Callable[[Tensor], dict[str, Tensor]]  # joint angles to a 4 x 4 matrix for each link
Taxels = Callable[[Tensor], list[Tensor]]


def plain_links(hand: HandKinematics, joint: Tensor) -> dict[str, Tensor]:
    """One 4 x 4 matrix after the other, from the root outwards."""
    pose = {hand.link_names[0]: torch.eye(4).to(joint).expand(len(joint), 4, 4)}
    waiting = list(hand.joints)
    while waiting:
        one = waiting.pop(0)
        if one.parent not in pose:
            waiting.append(one)
            continue
        matrix = torch.eye(4).to(joint).repeat(len(joint), 1, 1)
        roll, pitch, yaw = joint.new_tensor(one.rpy)
        x, y, z = torch.eye(3).to(joint)
        turn = rotation(z, yaw[None]) @ rotation(y, pitch[None]) @ rotation(x, roll[None])
        if one.axis is not None:
            angle = joint[:, hand.joint_names.index(one.name)]
            turn = turn @ rotation(joint.new_tensor(one.axis), angle)
        matrix[:, :3, :3] = turn
        matrix[:, :3, 3] = joint.new_tensor(one.xyz)
        pose[one.child] = pose[one.parent] @ matrix
    return pose


def rotation(axis: Tensor, angle: Tensor) -> Tensor:
    x, y, z = axis.tolist()
    cross = angle.new_tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = angle.sin().view(-1, 1, 1), angle.cos().view(-1, 1, 1)
    return torch.eye(3).to(angle) + sine * cross + (1 - cosine) * (cross @ cross)


def build_other_links(hand: HandKinematics, device: str) -> Links | None:
    try:
        import pytorch_kinematics
    except ImportError:
        return None
    chain = pytorch_kinematics.build_chain_from_urdf(urdf(hand).encode())
    chain = chain.to(dtype=torch.float, device=device)

    def other_links(joint: Tensor) -> dict[str, Tensor]:
        named = {name: joint[:, i] for i, name in enumerate(hand.joint_names)}
        pose = chain.forward_kinematics(named)
        return {name: link.get_matrix().expand(len(joint), 4, 4) for name, link in pose.items()}

    return other_links


def urdf(hand: HandKinematics) -> str:
    lines = [f'<link name="{name}"/>' for name in hand.link_names]
    for one in hand.joints:
        xyz, rpy, axis = (" ".join(map(str, value or ())) for value in (one.xyz, one.rpy, one.axis))
        lines.append(
            f'<joint name="{one.name}" type="{"continuous" if one.axis else "fixed"}">'
            f'<parent link="{one.parent}"/><child link="{one.child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/>'
            + (f'<axis xyz="{axis}"/></joint>' if one.axis else "</joint>")
        )
    return f'<robot name="{hand.name}">{"".join(lines)}</robot>'


def taxels_of_links(layout: TaxelLayout, links: Links, joint: Tensor) -> list[Tensor]:
    """Each link's taxels turned by its matrix, and its normals if the layout has any."""
    out = [
        torch.empty(len(joint), len(layout), 3, device=joint.device)
        for _ in range(1 if layout.normal is None else 2)
    ]
    used = [(name, layout.link == i) for i, name in enumerate(layout.link_names)]
    used = [(name, taxels) for name, taxels in used if taxels.any()]
    for start in range(0, len(joint), _PART):
        part = slice(start, start + _PART)
        pose = links(joint[part])
        for name, taxels in used:
            turn, shift = pose[name][:, :3, :3], pose[name][:, None, :3, 3]
            out[0][part, taxels] = layout.pos[taxels].to(joint) @ turn.mT + shift
            if layout.normal is not None:
                out[1][part, taxels] = layout.normal[taxels].to(joint) @ turn.mT
    return out


def our_taxels(hand: HandKinematics, layout: TaxelLayout, joint: Tensor) -> list[Tensor]:
    pos, normal = hand.taxel_pose(layout, joint)
    return [pos] if normal is None else [pos, normal]


def measure(call: Taxels, joint: Tensor, repeats: int) -> float:
    seconds = []
    for _ in range(repeats + 1):
        wait(joint)
        start = time.perf_counter()
        call(joint)
        wait(joint)
        seconds.append(time.perf_counter() - start)
    return sorted(seconds[1:])[repeats // 2]  # the first run warms up


def wait(joint: Tensor) -> None:
    if joint.is_cuda:
        torch.cuda.synchronize(joint.device)


def largest_difference(found: list[Tensor], expected: list[Tensor]) -> float:
    pairs = zip(found, expected, strict=True)
    return max(float((a - b).abs().max().nan_to_num(nan=torch.inf)) for a, b in pairs)


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    torch.set_num_threads(args.threads)
    hand, layout = HandKinematics.allegro(), allegro_uskin()
    generator = torch.Generator().manual_seed(args.seed)
    share = torch.rand(args.frames, hand.num_joints, generator=generator)
    joint = (hand.lower + share * (hand.upper - hand.lower)).to(args.device)

    links: dict[str, Links] = {"loop of 4 x 4 matrices": partial(plain_links, hand)}
    other = build_other_links(hand, args.device)
    if other is not None:
        links["pytorch_kinematics"] = other
    print_setting(
        *("torch", "torch_geometric_tactile"),
        threads=args.threads,
        data=f"{args.frames} frames of {hand.num_joints} joints, {len(layout)} taxels, float32",
        setting=f"median of {args.repeats} runs after a first one, seed {args.seed}",
    )
    if args.device != "cpu":
        print(f"device    {torch.cuda.get_device_name(args.device)}")
    if other is None:
        print("pytorch_kinematics is not installed and left out")

    status, few = 0, joint[:1000]
    for title, one in (("positions", replace(layout, normal=None)), ("with normals", layout)):
        calls: dict[str, Taxels] = {"HandKinematics": partial(our_taxels, hand, one)}
        for name, call in links.items():
            calls[name] = partial(taxels_of_links, one, call)
        print(f"\n{title:<26}{'seconds':>10}{'frames/s':>12}{'ratio':>8}{'difference':>12}")
        expected = calls["HandKinematics"](few)
        ours = 0.0
        for name, call in calls.items():
            difference = largest_difference(call(few), expected)
            seconds = measure(call, joint, args.repeats)
            ours = ours or seconds
            print(
                f"{name:<26}{seconds:>10.3f}{args.frames / seconds:>12.0f}"
                f"{seconds / ours:>8.1f}{difference:>12.2g}"
            )
            if not difference <= _ALLOWED_DIFFERENCE:
                print(f"FAILED: {name} differs by more than {_ALLOWED_DIFFERENCE}", file=sys.stderr)
                status = 1
        if one.normal is None and ours > args.at_most:
            print(f"FAILED: positions took more than {args.at_most:g} s", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
