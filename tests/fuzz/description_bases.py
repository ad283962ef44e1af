"""Small whole files that describe sensors and hands, as ``bases.py``."""

import json
from pathlib import Path

import torch

from torch_geometric_tactile.sensors import TaxelLayout, grid


def layout(folder: Path) -> None:
    small = grid(2, 2, pitch=0.01)
    small.save(folder / "a.json")
    TaxelLayout(
        name="two",
        pos=torch.tensor([[0.0, 0.0, 0.5], [0.25, 0.0, 0.5], [0.0, 0.125, 0.5]]),
        normal=torch.tensor([[0.0, 0.0, 1.0]] * 3),
        tangent=torch.tensor([[[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0]]] * 3, dtype=torch.double),
        patch=torch.tensor([0, 1, 1]),
        digit=torch.tensor([0, 1, 1]),
        patch_names=("left", "right"),
        digit_names=("thumb", "index"),
        adjacency={"original": torch.tensor([[0, 1], [1, 0]])},
        source="https://example.org",
    ).save(folder / "b.json")


def patches(folder: Path) -> None:
    planar = {"kind": "planar", "rows": [3, 3], "pitch": 4.0, "sparse_across": [[0, 1]]}
    capsule = {
        "kind": "capsule",
        "rows": [3, 1],
        "pitch": 4.0,
        "radius": 9.0,
        "straight": 4.0,
        "column_angle": 30,
    }
    content = {
        "name": "small",
        "unit": "mm",
        "shapes": {"planar": planar, "tip": capsule},
        "patches": [
            {
                "name": "p",
                "digit": "d",
                "link": "l",
                "column": [1, 0, 0],
                "row": [0, 1, 0],
                "shape": "planar",
                "origin": [0, 0, 0],
                "cell": [0, 0],
            },
            {
                "name": "q",
                "digit": "d",
                "link": "m",
                "shape": "tip",
                "origin": [0, 0, 9],
                "cell": [4, 0],
            },
        ],
        "joins": [
            {"kind": "seam", "from": ["p", "top"], "to": ["q", "bottom"], "reverse": True},
            {"kind": "fan", "from": ["p", "bottom"], "to": ["q", "bottom"], "straight": 1},
        ],
        "one_way": {"original": [{"from": ["p", 0, 0], "to": ["q", 0, 1]}]},
    }
    (folder / "a.json").write_text(json.dumps(content, indent=1) + "\n")


def calibration(folder: Path) -> None:
    from torch_geometric_tactile.transforms import Calibrate

    rows = torch.arange(24.0).view(2, 6, 2) / 7
    low = torch.tensor([[1.0, -2.5], [0.0, 3.0]])
    Calibrate(rows, low, low + 9, degree=2, per="sensor", source="two recordings").save(
        folder / "a.json"
    )
    content = {
        "coefficients": [[0, 1], [0.5, 0]],
        "reading_unit": "microtesla",
        "force_unit": "unit of the file",
    }
    (folder / "b.json").write_text(json.dumps(content) + "\n")


def taxel_map(folder: Path) -> None:
    content = {"layout": "pad", "source": "a drawing", "num_taxels": 5, "index": [3, -1, 0, 4]}
    (folder / "a.json").write_text(json.dumps(content) + "\n")
    (folder / "b.json").write_text(json.dumps({"index": [0, 2, 1], "num_taxels": 3}))


def chain(folder: Path) -> None:
    joints = [
        {
            "name": "elbow",
            "parent": "base",
            "child": "arm",
            "axis": [0, 0, 1],
            "lower": -1.0,
            "upper": 1.0,
        },
        {
            "name": "knuckle",
            "parent": "arm",
            "child": "finger",
            "xyz": [1, 0, 0],
            "axis": [0, 1, 0],
        },
        {
            "name": "nail",
            "parent": "finger",
            "child": "tip",
            "xyz": [0.5, 0, 0],
            "rpy": [0, 0, 1.5],
        },
    ]
    (folder / "a.json").write_text(json.dumps({"name": "hand", "joints": joints}, indent=1) + "\n")


def urdf(folder: Path) -> None:
    (folder / "a.urdf").write_text(
        """<?xml version="1.0" encoding="utf-8"?>
<robot name="hand">
<link name="base"/><link name="arm"/><link name="tip"/>
<joint name="elbow" type="revolute">
<parent link="base"/><child link="arm"/>
<origin xyz="0 0 0.5" rpy="0 0 0"/>
<axis xyz="0 0 1"/>
<limit lower="-1.0" upper="1.0" effort="1" velocity="1"/>
</joint>
<joint name="nail" type="fixed">
<parent link="arm"/><child link="tip"/>
<origin xyz="0.25 0 0" rpy="0 0 1.5"/>
</joint>
</robot>
"""
    )
